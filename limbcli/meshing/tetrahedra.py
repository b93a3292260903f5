"""Fill the volume between the facets of the boundary with tetrahedra of the same grading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from limbcli.errors import MeshError
from limbcli.meshing.mesher_process import in_process
from limbcli.meshing.quality import volumes
from limbcli.meshing.remesh import Boundary, SizeField
from limbcli.meshing.surfaces import bodies
from limbcli.model import Array, IntArray

_BEYOND = 0.02  # mm: distance of a point in a void from its facet
_SPACING = 1.0  # smallest distance between interior points, as a multiple of the target edge length
_TIME_LIMIT_S = 30.0  # of TetGen


@dataclass(frozen=True, eq=False)
class Tetrahedra:
    """points (n, 3), the boundary's first, in its order; cells (m, 4), positive volume; the mesher's name."""

    points: Array
    cells: IntArray
    maker: str


def interior_points(boundary: Boundary, field: SizeField, *, seed: int) -> Array:
    """Interior points (n, 3), about one target edge length apart (Poisson discs), off the boundary."""
    rng = np.random.default_rng(seed)
    grid = field.domain.skin.grid
    inside = field.domain.skin.values < 0
    if field.domain.bone is not None:
        inside &= field.domain.bone.values > 0
    voxels = grid.points()[inside]
    keep = np.ones(len(voxels), bool)
    for plane in field.domain.planes:
        keep &= plane.height(voxels) < 0
    voxels = voxels[keep]
    size = field.at(voxels)
    chance = 12 * (grid.spacing / size) ** 3
    chosen = rng.random(len(voxels)) < chance
    points = voxels[chosen] + grid.spacing * (rng.random((int(chosen.sum()), 3)) - 0.5)
    size = size[chosen]
    clear = _clearance(points, field)
    points, size = points[clear > 0.55 * size], size[clear > 0.55 * size]
    near, _ = cKDTree(boundary.surface.points).query(points)
    points, size = points[near > 0.7 * size], size[near > 0.7 * size]
    order = np.argsort(size + 1e-3 * rng.random(len(size)), kind="stable")
    return _discs(points[order], _SPACING * size[order])


def _clearance(points: Array, field: SizeField) -> Array:
    """Distance (n,) to the nearest boundary."""
    d = -field.domain.skin.at(points)
    if field.domain.bone is not None:
        d = np.minimum(d, field.domain.bone.at(points))
    for plane in field.domain.planes:
        d = np.minimum(d, -plane.height(points))
    return d


def _discs(points: Array, radius: Array) -> Array:
    """A subset in which no point lies within the radius of an earlier one."""
    if not len(points):
        return points
    tree = cKDTree(points)
    removed = np.zeros(len(points), bool)
    keep = []
    for k in range(len(points)):
        if not removed[k]:
            keep.append(k)
            removed[tree.query_ball_point(points[k], radius[k])] = True
    return points[keep]


def tetgen_mesh(boundary: Boundary, inner: Array, *, min_ratio: float, min_dihedral_deg: float) -> Tetrahedra:
    """Run TetGen in a separate process (it may crash or not terminate); boundary facets are preserved.

    Raises MeshError if TetGen refuses the surface, crashes, or runs out of time.
    """
    points = np.ascontiguousarray(np.vstack([boundary.surface.points, inner]))
    faces = np.ascontiguousarray(boundary.surface.faces)
    # a point in each void of the closed surface: just beyond its largest facet
    found = []
    for each in bodies(boundary.surface):
        if each.volume < 0:
            k = int(each.areas.argmax())
            found.append((each.centroids[k] + _BEYOND * each.area_vectors[k] / each.areas[k]).tolist())
    options = {"minratio": min_ratio, "mindihedral": min_dihedral_deg, "holes": found}
    nodes, cells = in_process("tetgen", points, faces, options, time_limit_s=_TIME_LIMIT_S)
    return checked(nodes, cells, boundary.surface.volume, "TetGen")


def checked(
    nodes: Array, cells: IntArray, expected: float, maker: str, *, tolerance: float = 1e-3
) -> Tetrahedra:
    """Orient the cells to positive volume and check that they fill the whole `expected` volume (mm3)."""
    cells = np.asarray(cells, np.int64)[:, :4].copy()
    negative = volumes(nodes, cells) < 0
    cells[negative] = cells[negative][:, [0, 2, 1, 3]]
    inside = float(volumes(nodes, cells).sum())
    if abs(inside - expected) > tolerance * abs(expected):
        raise MeshError(
            f"{maker} filled {inside / 1e3:.1f} cm3 of {expected / 1e3:.1f} cm3",
            where="volume mesh",
            fix="use a finer mesh (--size-mm)",
            filled_mm3=inside,
            expected_mm3=expected,
        )
    return Tetrahedra(nodes, cells, maker)
