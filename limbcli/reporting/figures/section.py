"""Geometry for pictures only: plane cuts of tetrahedra and facets, and splitting of quadratic cells into
linear ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from limbcli.model import Array, IntArray

# Node order is VTK's: middle nodes 4 (0-1), 5 (1-2), 6 (0-2), 7 (0-3), 8 (1-3), 9 (2-3).
_TET10_PARTS = np.array(
    [
        [0, 4, 6, 7], [4, 1, 5, 8], [6, 5, 2, 9], [7, 8, 9, 3],
        [6, 8, 4, 5], [6, 8, 5, 9], [6, 8, 9, 7], [6, 8, 7, 4],
    ]
)  # fmt: skip
_TRI6_PARTS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
_QUAD4_PARTS = np.array([[0, 1, 2], [0, 2, 3]])
_EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])


@dataclass(frozen=True, eq=False)
class Section:
    """A cut through tetrahedra: vertices on their edges, connected to triangles.

    ends : (n, 2) node numbers of the edge that each vertex lies on
    weight : (n,) interpolation weight of the second node
    triangles : (n_triangles, 3) vertex indices
    cells : (n_triangles,) the tetrahedron of each triangle
    """

    ends: IntArray
    weight: Array
    triangles: IntArray
    cells: IntArray

    def at(self, values: Array) -> Array:
        """Nodal values (n_points, ...) interpolated linearly along the edges to the vertices."""
        return on_edges(self.ends, self.weight, values)


def linear_tetrahedra(kind: str, cells: IntArray) -> tuple[IntArray, IntArray]:
    """Four-node cells that subdivide tet4 or tet10 cells, and the cell that each came from.

    >>> linear_tetrahedra("tet10", np.arange(10)[None])[0].shape
    (8, 4)
    """
    if kind == "tet4":
        return cells, np.arange(len(cells))
    if kind == "tet10":
        parts = cells[:, _TET10_PARTS].reshape(-1, 4)
        return parts, np.repeat(np.arange(len(cells)), len(_TET10_PARTS))
    raise ValueError(f"no picture of cells of kind {kind}")


def linear_triangles(kind: str, facets: IntArray) -> IntArray:
    """Three-node facets that subdivide tri3, tri6 or quad4 facets."""
    parts = {"tri3": np.array([[0, 1, 2]]), "tri6": _TRI6_PARTS, "quad4": _QUAD4_PARTS}[kind]
    return np.asarray(facets[:, parts].reshape(-1, 3))


def cut_tetrahedra(points: Array, tetrahedra: IntArray) -> Section:
    """Intersection of the tetrahedra with the plane y = 0.

    >>> corners = np.array([[0.0, -1, 0], [0, 1, 0], [1, 1, 0], [0, 1, 1]])
    >>> cut_tetrahedra(corners, np.arange(4)[None]).triangles.shape
    (1, 3)
    """
    side = _side(points)
    above = side[tetrahedra] > 0
    hit = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
    crossed = above[hit][:, _EDGES[:, 0]] != above[hit][:, _EDGES[:, 1]]
    ends = tetrahedra[hit][:, _EDGES][crossed]
    weight = side[ends[:, 0]] / (side[ends[:, 0]] - side[ends[:, 1]])
    count = crossed.sum(axis=1)
    first = np.concatenate([[0], np.cumsum(count)[:-1]]).astype(int)
    three, four = first[count == 3], first[count == 4]
    # Crossed edges of a 2-2 split come as ac, ad, bc, bd (or alike): their ring is 0, 1, 3, 2.
    triangles = np.concatenate(
        [three[:, None] + [0, 1, 2], four[:, None] + [0, 1, 3], four[:, None] + [0, 3, 2]]
    )
    cells = np.concatenate([hit[count == 3], hit[count == 4], hit[count == 4]])
    return Section(ends, weight, triangles.astype(np.int64), cells)


def cut_triangles(points: Array, triangles: IntArray) -> tuple[IntArray, Array]:
    """Intersection of facets with the plane: edge nodes (n, 2, 2) and weights (n, 2) of each segment."""
    side = _side(points)
    above = side[triangles] > 0
    hit = triangles[above.any(axis=1) & ~above.all(axis=1)]
    edges = hit[:, [[0, 1], [1, 2], [2, 0]]]
    crossed = (side[edges[..., 0]] > 0) != (side[edges[..., 1]] > 0)
    ends = edges[crossed].reshape(-1, 2, 2)
    a, b = side[ends[..., 0]], side[ends[..., 1]]
    return ends, a / (a - b)


def _side(points: Array) -> Array:
    """Distance (n,) from the plane; no point lies on it."""
    return np.where(points[:, 1] == 0.0, 1e-9, points[:, 1])


def outline(points: Array, facets: Mapping[str, IntArray], values: Array) -> Array:
    """Where facets, by kind, meet the plane: segments (n, 2, 2) in x and z of nodal positions `values`."""
    lines = [np.zeros((0, 2, 2))]
    for kind, each in facets.items():
        ends, weight = cut_triangles(points, linear_triangles(kind, each))
        lines.append(on_edges(ends, weight, values)[:, :, [0, 2]])
    return np.concatenate(lines)


def on_edges(ends: IntArray, weight: Array, values: Array) -> Array:
    """Nodal values (n_points, ...) interpolated linearly to places on edges, each of two nodes (..., 2)."""
    weight = weight.reshape(*weight.shape, *([1] * (values.ndim - 1)))
    return (1.0 - weight) * values[ends[..., 0]] + weight * values[ends[..., 1]]
