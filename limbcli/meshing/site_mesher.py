"""Tetrahedral mesh of a domain: several methods, tried in turn until one is good enough."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import MeshError, ToolError
from limbcli.meshing.domain import TissueDomain
from limbcli.meshing.improve import NodeConstraints, put_back, smooth, worst_sines
from limbcli.meshing.mesher_process import in_process
from limbcli.meshing.probe import PlacedProbe
from limbcli.meshing.quality import dihedral_angles_deg
from limbcli.meshing.remesh import (
    Boundary,
    SizeField,
    Sizes,
    bad_places,
    face_labels,
    finer_near,
    lost_bone,
    remesh,
    size_field,
    unfold,
)
from limbcli.meshing.surfaces import Triangles
from limbcli.meshing.tetrahedra import Tetrahedra, checked, interior_points, tetgen_mesh
from limbcli.model import Array, IntArray

MIN_ANGLE_UNDER_PROBE_DEG, MIN_ANGLE_DEG = 8.0, 4.0
_LOCAL_REPAIRS = 5
# mm by which fTetWild may deviate from the surface; its number of optimisation passes
_ENVELOPE, _WILD_ROUNDS = 0.15, 25
_POOR, _ROUNDS = 0.25, 20  # sine of a dihedral angle below which a cell is poor; rounds of moving nodes back
# Attempts of TetGen on one boundary: radius-edge ratio, smallest requested dihedral angle (deg), seed.
_TETGEN = ((1.4, 12.0, 7), (1.8, 8.0, 11), (1.2, 14.0, 13))


@dataclass(frozen=True, eq=False)
class VolumeMesh:
    """Tetrahedra (positive volume), labelled boundary faces, the mesher's name, notes on failed attempts."""

    points: Array
    cells: IntArray
    faces: IntArray
    labels: IntArray
    maker: str
    notes: tuple[str, ...]


def under_probe(
    points: Array,
    cells: IntArray,
    probes: tuple[PlacedProbe, ...],
    *,
    beside: float = 2.0,
    depth: float = 15.0,
) -> NDArray[np.bool_]:
    """Which cells (n_cells,) lie under a probe's face: their centroid at most `depth` mm below it."""
    middle = points[cells[:, :4]].mean(axis=1)
    found = np.zeros(len(cells), bool)
    for each in probes:
        distance, height = each.beside_and_height(middle)
        found |= (distance <= beside) & (height > -depth)
    return found


def mesh_volume(domain: TissueDomain, probes: tuple[PlacedProbe, ...], sizes: Sizes) -> VolumeMesh:
    """Graded tetrahedra in a domain, good enough for the solver; probes: those that press on it.

    Tried in turn: TetGen on the boundary remeshed as requested (finer where facets intersect or have lost
    bone), TetGen on a finer boundary, TetGen with smoothed bones, fTetWild.

    Raises MeshError if no method yields cells of positive volume with dihedral angles of at least 4 degrees
    (8 under a probe); it reports the outcome of each.
    """
    tale: list[str] = []
    ways: list[Callable[[], VolumeMesh]] = [
        lambda: _with_tetgen(domain, probes, sizes, tale),
        lambda: _with_tetgen(domain, probes, sizes.finer(0.75), tale),
        lambda: _with_tetgen(domain.smoothed(1.0), probes, sizes.finer(0.85), tale),
        lambda: _with_ftetwild(domain.smoothed(1.0), probes, sizes, tale),
    ]
    names = ("as asked", "remeshed finer", "bones smoothed", "fTetWild")
    best: tuple[float, VolumeMesh] | None = None
    for name, way in zip(names, ways, strict=True):
        try:
            found = way()
        except (MeshError, ToolError) as error:
            tale.append(f"{name}: {error.what}")
            continue
        score = _score(found, probes)
        if score >= 1.0:
            return replace(found, notes=tuple(tale))
        tale.append(f"{name}: smallest dihedral angle only {score:.2f} of the required one")
        if best is None or score > best[0]:
            best = score, found
    raise MeshError(
        "no volume mesh of sufficient quality could be generated: " + "; ".join(tale),
        where="volume mesh",
        fix="use another size (--size-mm), move the site slightly, or smooth the segmentation there",
        best_score=best[0] if best else 0.0,
    )


def _score(mesh: VolumeMesh, probes: tuple[PlacedProbe, ...]) -> float:
    """Smallest ratio of a cell's dihedral angle to the required one; 1 or more is sufficient."""
    lowest = dihedral_angles_deg(mesh.points, mesh.cells).min(axis=1)
    near = under_probe(mesh.points, mesh.cells, probes)
    return float((lowest / np.where(near, MIN_ANGLE_UNDER_PROBE_DEG, MIN_ANGLE_DEG)).min())


def _with_tetgen(
    domain: TissueDomain, probes: tuple[PlacedProbe, ...], sizes: Sizes, tale: list[str]
) -> VolumeMesh:
    fine = domain.boundary
    field = asked = size_field(domain, probes, sizes)
    graded = unfold(remesh(fine, domain, field), domain)
    for _ in range(_LOCAL_REPAIRS):
        what, bad = "facets crossed", bad_places(graded)
        if not len(bad):
            what, bad = "places of bone were lost", lost_bone(graded, fine, asked)
        if not len(bad):
            break
        x, y, z = bad.mean(axis=0)
        tale.append(f"{len(bad)} {what} near ({x:.0f}, {y:.0f}, {z:.0f}) mm: finer there")
        field = finer_near(field, bad)
        graded = unfold(remesh(fine, domain, field), domain)
    best: tuple[float, VolumeMesh] | None = None
    for ratio, dihedral, seed in _TETGEN:
        inner = interior_points(graded, field, seed=seed)
        try:
            raw = tetgen_mesh(graded, inner, min_ratio=ratio, min_dihedral_deg=dihedral)
        except MeshError as error:
            tale.append(error.what)
            continue
        found = _improved(raw, *labelled_boundary(raw, graded, domain), domain)
        score = _score(found, probes)
        if best is None or score > best[0]:
            best = score, found
        if score >= 1.15:
            break
    if best is None:
        raise MeshError(tale.pop(), where="volume mesh", fix="use a finer mesh (--size-mm)")
    return best[1]


def labelled_boundary(raw: Tetrahedra, graded: Boundary, domain: TissueDomain) -> tuple[IntArray, IntArray]:
    """The boundary faces of the cells and their labels.

    TetGen may flip edges between facets in one plane; such faces are labelled by their position.
    """
    faces = boundary_faces(raw.cells)
    base = len(raw.points)
    ours, theirs = (_face_keys(each, base) for each in (graded.surface.faces, faces))
    order = np.argsort(ours)
    at = np.minimum(np.searchsorted(ours[order], theirs), len(ours) - 1)
    same = ours[order][at] == theirs
    labels = np.where(same, graded.labels[order[at]], 0)
    if not same.all():
        labels[~same] = face_labels(Triangles(raw.points, faces[~same]), domain)
    return faces, labels


def _face_keys(faces: IntArray, base: int) -> IntArray:
    """One integer key for each face, the same for the same three nodes in any order."""
    a, b, c = np.sort(faces, axis=1).T
    return (a * base + b) * base + c


def _improved(raw: Tetrahedra, faces: IntArray, labels: IntArray, domain: TissueDomain) -> VolumeMesh:
    """Smooth the nodes twice; the second time only where the worst angles remain."""
    constraints = NodeConstraints.of_faces(len(raw.points), faces, labels)
    points = smooth(raw.points, raw.cells, constraints, domain)
    points = smooth(points, raw.cells, constraints, domain, goal_deg=14.0, passes=30)
    return VolumeMesh(points, raw.cells, faces, labels, raw.maker, ())


def _with_ftetwild(
    domain: TissueDomain, probes: tuple[PlacedProbe, ...], sizes: Sizes, tale: list[str]
) -> VolumeMesh:
    """Mesh with fTetWild: slower, its surface within a tolerance of ours, but it accepts any input."""
    field = size_field(domain, probes, sizes)
    surface = _remeshed_or_not(domain, field, tale)
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    axes = [np.arange(a - 4.0, b + 8.0, 4.0) for a, b in zip(low, high, strict=True)]
    samples = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    options = {
        "edge_length_abs": sizes.far,
        "epsilon": _ENVELOPE / float(np.linalg.norm(high - low)),
        "num_opt_iter": _WILD_ROUNDS,
        "num_threads": 2,
        "sizes": np.column_stack([samples, field.at(samples)]).tolist(),
    }
    nodes, cells = in_process("pytetwild", surface.points, surface.faces, options, time_limit_s=120.0)
    raw = checked(nodes, cells, surface.volume, "fTetWild", tolerance=0.02)
    faces = boundary_faces(raw.cells)
    labels = face_labels(Triangles(raw.points, faces), domain, tolerance=3 * _ENVELOPE)
    constraints = NodeConstraints.of_faces(len(raw.points), faces, labels)
    points = settled(raw.points, put_back(raw.points, constraints, domain), raw.cells)
    return _improved(Tetrahedra(points, raw.cells, raw.maker), faces, labels, domain)


def _remeshed_or_not(domain: TissueDomain, field: SizeField, tale: list[str]) -> Triangles:
    """The boundary, remeshed if possible (it may intersect itself; fTetWild is faster with fewer facets)."""
    fine = domain.boundary
    try:
        return remesh(fine, domain, field).surface
    except MeshError as error:
        tale.append(f"fTetWild from the boundary as it is: {error.what}")
        return fine


def settled(points: Array, wanted: Array, cells: IntArray) -> Array:
    """Nodes at their target positions, except those whose cells would thereby become worse than poor."""
    before, x = worst_sines(points, cells), wanted.copy()
    for _ in range(_ROUNDS):
        after = worst_sines(x, cells)
        bad = after < np.minimum(before, _POOR)
        if not bad.any():
            return x
        nodes = np.unique(cells[bad, :4])
        x[nodes] = points[nodes]
    return points


def boundary_faces(cells: IntArray) -> IntArray:
    """Outward faces (m, 3) that belong to only one tetrahedron."""
    corners = cells[:, :4]
    faces = corners[:, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]].reshape(-1, 3)
    _, first, counts = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[counts == 1])]
