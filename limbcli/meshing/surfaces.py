"""Triangle surfaces: reading, splitting into bodies, and basic geometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from limbcli.errors import CaseError, MeshError
from limbcli.model import Array, IntArray
from limbcli.numbers.distinct_rows import distinct_rows
from limbcli.surface_formats.triangle_files import SUFFIXES, read_triangles

_SAME_POINT = 1e-7  # of a surface's size: points that are closer are one
# Points per triangle, half of which a closed surface has; and of these, the share closer to another than this
# fraction of an edge, above which triangles do not meet
_MANY_POINTS, _APART, _CLOSE = 0.6, 0.2, 0.01


@dataclass(frozen=True, eq=False)
class Triangles:
    """A triangle surface: points (n, 3) mm, faces (m, 3) from 0, outward normals by the right-hand rule.

    Points and faces never change, so that what is computed from all of them is kept.
    """

    points: Array
    faces: IntArray

    @property
    def corners(self) -> Array:
        """(m, 3, 3) coordinates of every face's corners."""
        return self.points[self.faces]

    @cached_property
    def area_vectors(self) -> Array:
        """Face normals (m, 3) whose length is the area (mm2)."""
        a, b, c = self.points[self.faces.T]
        (x, y, z), (u, v, w) = (b - a).T, (c - a).T
        return _fixed(0.5 * np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1))

    @cached_property
    def areas(self) -> Array:
        return _fixed(np.linalg.norm(self.area_vectors, axis=1))

    @property
    def point_normals(self) -> Array:
        """Unit normals (n, 3), weighted by the areas of the faces at a point; 0 at points without faces."""
        found, normals = np.zeros_like(self.points, dtype=float), self.area_vectors
        for column in self.faces.T:
            np.add.at(found, column, normals)
        return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-300)

    @cached_property
    def centroids(self) -> Array:
        a, b, c = self.points[self.faces.T]
        return _fixed((a + b + c) / 3)

    @cached_property
    def volume(self) -> float:
        """Enclosed volume (mm3), positive where normals point outward (divergence theorem).

        >>> round(tetrahedron().volume, 6)
        0.166667
        """
        return float(np.einsum("ij,ij->", self.centroids - self.points.mean(0), self.area_vectors) / 3)

    @cached_property
    def is_closed(self) -> bool:
        """Whether every edge belongs to exactly two triangles that traverse it in opposite directions."""
        start, end = self.faces.astype(np.int64).ravel(), np.roll(self.faces, -1, axis=1).ravel()
        n = len(self.points)
        forward = np.sort(start * n + end)  # a key for each directed edge
        return bool((np.diff(forward) > 0).all()) and np.array_equal(forward, np.sort(end * n + start))

    @cached_property
    def longest_edge(self) -> float:
        a, b, c = self.points[self.faces.T]
        return float(
            np.sqrt(max(((u - v) ** 2).sum(axis=1).max(initial=0.0) for u, v in ((a, b), (b, c), (c, a))))
        )

    @cached_property
    def piece_of_point(self) -> tuple[int, IntArray]:
        """The number of connected pieces, also points without faces, and the piece (n,) of every point."""
        a, b, c = self.faces.T
        n = len(self.points)
        links = coo_array((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, c])), shape=(n, n))
        count, label = connected_components(links, directed=False)
        return int(count), label

    def moved(self, transform: Array) -> Triangles:
        """The surface after a rigid 4 x 4 transform."""
        return Triangles(self.points @ transform[:3, :3].T + transform[:3, 3], self.faces)

    def flipped(self) -> Triangles:
        return Triangles(self.points, self.faces[:, ::-1].copy())

    def part(self, keep: NDArray[Any]) -> Triangles:
        """The faces selected by `keep` (mask or indices), without unused points."""
        faces = self.faces[keep]
        used, inverse = np.unique(faces, return_inverse=True)
        return Triangles(self.points[used], inverse.reshape(-1, 3).astype(np.int64))


def _fixed(values: Array) -> Array:
    values.flags.writeable = False
    return values


def tetrahedron() -> Triangles:
    """The unit right-angled tetrahedron, for examples."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    return Triangles(points, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))


def join(surfaces: list[Triangles]) -> Triangles:
    """Several surfaces as one, without merging points."""
    offsets = np.cumsum([0, *(len(each.points) for each in surfaces)])
    return Triangles(
        np.concatenate([each.points for each in surfaces]),
        np.concatenate([each.faces + o for each, o in zip(surfaces, offsets, strict=False)]),
    )


def read_surface(
    path: Path,
    *,
    merge: Callable[[Triangles], Triangles] | None = None,
    error_type: type[CaseError | MeshError] = MeshError,
) -> Triangles:
    """Read a triangle surface (PLY, STL, OBJ, ...); in patient LPS and mm, as it states them.

    Coincident points are merged by `merge` (None: `merge_points`).

    Raises error_type if the file is absent, holds no triangles, a coordinate is not a number, or triangles do
    not meet.
    """
    fix = f"give a triangle surface in one of the formats {', '.join(SUFFIXES)}"
    if not path.is_file():
        raise error_type("the surface file does not exist", where=str(path), fix=fix)
    try:
        points, faces = read_triangles(path)
    except OSError as error:
        raise error_type(f"the surface cannot be read ({error})", where=str(path), fix=fix) from error
    if not len(faces):
        cloud = "it holds points alone: make a surface of them (MeshLab: Screened Poisson), and save that"
        what = "the surface contains no triangles"
        raise error_type(what, where=str(path), fix=cloud if len(points) else fix)
    if not np.isfinite(points).all():
        bad = int(np.argwhere(~np.isfinite(points))[0, 0])
        raise error_type(f"point {bad} of the surface is not a number", where=str(path), fix=fix)
    surface = (merge or merge_points)(Triangles(points, faces))
    if not len(surface.faces):
        raise error_type("the surface's triangles have no area", where=str(path), fix=fix)
    share = _corners_apart(surface)
    if share > _APART:
        raise error_type(
            f"triangles of the surface do not meet: {100 * share:.0f} % of the corners lie close to another",
            where=str(path),
            fix="join them and save the surface again (MeshLab: Merge Close Vertices)",
            share_apart=share,
        )
    return surface


def _corners_apart(surface: Triangles) -> float:
    """The share of points that lie within `_CLOSE` edges of another, of a surface with too many points."""
    if len(surface.points) < _MANY_POINTS * len(surface.faces):
        return 0.0
    edge = float(np.sqrt(np.median(((surface.corners[:, 1] - surface.corners[:, 0]) ** 2).sum(axis=1))))
    nearest = cKDTree(surface.points).query(surface.points, k=2, distance_upper_bound=_CLOSE * edge)[0]
    return float(np.isfinite(nearest[:, 1]).mean())


def merge_points(surface: Triangles) -> Triangles:
    """Merge coincident points (within `_SAME_POINT` times the surface's size); drop degenerate faces."""
    size = float(np.ptp(surface.points, axis=0).max()) or 1.0
    keys = np.round((surface.points - surface.points.min(0)) / (_SAME_POINT * size)).astype(np.int64)
    first, inverse = distinct_rows(keys)
    faces = inverse[surface.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    return Triangles(surface.points[first], faces.astype(np.int64)).part(np.arange(len(faces)))


def bodies(surface: Triangles) -> list[Triangles]:
    """The connected pieces of a surface, the largest (by extent) first.

    >>> [len(each.faces) for each in bodies(join([tetrahedron(), tetrahedron()]))]
    [4, 4]
    """
    count, label = surface.piece_of_point
    if count == 1:
        return [surface]
    of_face = label[surface.faces[:, 0]]
    order = np.argsort(of_face, kind="stable")
    pieces = [surface.part(each) for each in np.split(order, np.flatnonzero(np.diff(of_face[order])) + 1)]
    return sorted(pieces, key=lambda each: -float(np.prod(np.ptp(each.points, axis=0) + 1e-9)))


def undirected(edges: IntArray) -> IntArray:
    """One integer key per edge (n, 2), independent of direction; keys sort like (smaller end, larger end).

    >>> undirected(np.array([[0, 3], [3, 0], [1, 2]])).tolist()
    [3, 3, 6]
    """
    a, b = edges.astype(np.int64).T
    low, high = np.minimum(a, b), np.maximum(a, b)
    return np.asarray(low * (high.max(initial=0) + 1) + high)


def boundary_loops(surface: Triangles) -> list[IntArray]:
    """Closed chains of point indices along the edges that belong to only one face."""
    if surface.is_closed:
        return []
    edges = surface.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, inverse, counts = np.unique(undirected(edges), return_inverse=True, return_counts=True)
    following: dict[int, list[int]] = {}
    for a, b in edges[counts[inverse] == 1]:
        following.setdefault(int(a), []).append(int(b))
    loops = []
    while following:
        start = next(iter(following))
        loop, here = [start], start
        while here in following:
            here, nexts = following[here].pop(), following[here]
            if not nexts:
                following.pop(loop[-1])
            if here == start:
                break
            loop.append(here)
        if len(loop) > 2:
            loops.append(np.array(loop))
    return loops
