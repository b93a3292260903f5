"""Layers under the skin that conform to its surface: skin and fat over the rest of the tissue.

The core (everything except the layers) is meshed first, bounded by the skin moved inward. Then its outer
facets are extruded to the skin, as prisms that are each split into three tetrahedra. Over bone the layers are
thinned so that some core is left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.errors import CaseError, MeshError
from limbcli.meshing.distance import Field, distance_again
from limbcli.meshing.domain import CUT, SKIN, TissueDomain
from limbcli.meshing.improve import NodeConstraints, smooth, worst_sines
from limbcli.meshing.mending import ENDS
from limbcli.meshing.quality import volumes
from limbcli.meshing.site_mesher import VolumeMesh, boundary_faces
from limbcli.model import Array, IntArray

_SHARE = 0.6  # largest fraction of the tissue over bone that layers may take
_THICKEST = 40.0  # mm
_LEAST_ANGLE_DEG = 4.0
_BEFORE_END = 3.0  # mm below the layers of the lid, where the straight extension of the skin begins
# Thinning of layers at a cut: distance from the cut over which it fades (mm), sine of the angle between skin
# and cut below which it begins, smallest fraction of the thickness kept.
_NEAR_CUT, _STEEP, _LEAST_KEPT = 12.0, 0.85, 0.2
# projection to the skin: number of steps, largest step (mm), smallest slope within a cut
_PROJECTIONS, _LONGEST, _GRAZING = 12, 4.0, 0.3
_UNTANGLING = (
    (6.0, 12),
    (6.0, 30),
    (8.0, 30),
)  # goal (degrees), passes; goals are low, to preserve the thickness


@dataclass(frozen=True)
class Layer:
    """A layer: its name ("skin", "fat"), thickness (mm) and number of cells through the thickness."""

    name: str
    thickness: float
    n_cells: int = 1


def layers_of(*, skin: float = 0.0, fat: float = 0.0, size: float = 2.5) -> tuple[Layer, ...]:
    """The requested layers, outermost first; thickness in mm (0: none), `size` is the edge length.

    Skin, much stiffer than the tissue below, stretches as a membrane: one cell usually suffices. Fat takes
    most of an indentation: at least two.

    >>> [(each.name, each.n_cells) for each in layers_of(skin=1.5, fat=8.0)]
    [('skin', 1), ('fat', 3)]
    """
    for name, value in (("--skin-mm", skin), ("--fat-mm", fat)):
        if not 0 <= value <= _THICKEST:
            raise CaseError(f"{name} is {value:g}", where="layers", fix=f"give 0 to {_THICKEST:g} mm")
    cells = {"skin": max(1, round(skin / (1.5 * size))), "fat": max(2, round(fat / size))}
    wanted = (("skin", skin), ("fat", fat))
    return tuple(Layer(name, t, cells[name]) for name, t in wanted if t > 0)


def open_ended(domain: TissueDomain, layers: tuple[Layer, ...]) -> TissueDomain:
    """The domain with its skin extended straight on where the limb was cut: a cut has no skin on it.

    The closed skin has a lid just beyond such an end, and layers measured from the lid would cross the cut.
    """
    grid = domain.skin.grid
    points = grid.points().reshape(-1, 3)
    reach = sum(each.thickness for each in layers) + _BEFORE_END
    moved = points
    for plane in domain.planes:
        if plane.name in ENDS:
            beyond = np.maximum(plane.height(moved) + reach, 0.0)
            moved = moved - beyond[:, None] * plane.normal
    if moved is points:
        return domain
    return replace(domain, skin=domain.skin.with_values(domain.skin.at(moved).reshape(grid.shape)))


def core_of(domain: TissueDomain, layers: tuple[Layer, ...]) -> TissueDomain:
    """The domain without its layers: its `skin` is the inner surface of the layers."""
    total = sum(each.thickness for each in layers)
    depth = np.full(domain.skin.grid.shape, total)
    if domain.bone is not None:
        gap = np.abs(domain.bone.values) + np.abs(domain.skin.values)
        depth = np.minimum(depth, _SHARE * gap)
    depth = depth * _tapered(domain)
    inner = distance_again(domain.skin.with_values(domain.skin.values + depth))
    if not (inner.values < 0).any():
        raise CaseError(
            f"layers of {total:g} mm leave no tissue below", where="layers", fix="give thinner layers"
        )
    return replace(domain, skin=inner)


def _tapered(domain: TissueDomain) -> Array:
    """Fraction of the layers' thickness kept at each sample.

    It is reduced where a cut meets the skin at a grazing angle: there a layer would extend far along the cut.
    Such places are far from the probe.
    """
    slope = np.stack(list(np.gradient(domain.skin.values, domain.skin.grid.spacing)), axis=-1)
    slope /= np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-6)
    points = domain.skin.grid.points()
    keep = np.ones(domain.skin.values.shape)
    for plane in domain.planes:
        across = np.sqrt(np.clip(1 - (slope @ plane.normal) ** 2, 0, 1))
        near = np.exp(-(((points @ plane.normal - plane.offset) / _NEAR_CUT) ** 2))
        keep = np.minimum(keep, 1 - near * (1 - np.clip(across / _STEEP, _LEAST_KEPT, 1)))
    return np.asarray(ndimage.gaussian_filter(keep, 2.0 / domain.skin.grid.spacing))


def with_layers(
    core: VolumeMesh, inner: TissueDomain, skin: Field, layers: tuple[Layer, ...]
) -> tuple[VolumeMesh, IntArray]:
    """The core with its layers, and a number for each cell: 0 core, 1 and above the layers from inside out.

    Raises MeshError if a cell of a layer is inverted (the layer is too thick for the curvature of the skin).
    """
    faces = core.faces[core.labels == SKIN]
    base = np.unique(faces)
    # project each inner node to the skin along the distance field, staying in its cut or edge of cuts
    normals = _cut_normals(core, inner, base)
    start, x = core.points[base], core.points[base].copy()
    for _ in range(_PROJECTIONS):
        slope = skin.gradient(x)
        slope -= np.einsum("nij,nj->ni", normals, slope)
        size = np.einsum("ni,ni->n", slope, slope)
        step = -skin.at(x) / np.maximum(size, _GRAZING**2)
        x += np.clip(step, -_LONGEST, _LONGEST)[:, None] * slope
    outer = np.where((skin.at(start) < 0)[:, None], x, start)
    heights, kinds = _levels(layers)
    n = len(core.points)
    added = [core.points[base] + h * (outer - core.points[base]) for h in heights]
    number = np.full(n, -1)
    number[base] = np.arange(len(base))
    rows = [base, *(n + k * len(base) + np.arange(len(base)) for k in range(len(heights)))]
    points = np.vstack([core.points, *added])
    cells, parts = [core.cells], [np.zeros(len(core.cells), np.int64)]
    order = np.argsort(number[faces], axis=1)
    local, turned = np.take_along_axis(number[faces], order, axis=1), _odd(order)
    for k, kind in enumerate(kinds):
        cells.append(_prisms(rows[k][local], rows[k + 1][local], turned))
        parts.append(np.full(3 * len(faces), kind))
    every = np.vstack(cells)
    shell = boundary_faces(every)
    labels = _labels(shell, points, core, rows[-1], inner)
    points = _untangled(points, every, shell, labels, replace(inner, skin=skin))
    return VolumeMesh(points, every, shell, labels, core.maker, core.notes), np.concatenate(parts)


def _untangled(
    points: Array, cells: IntArray, shell: IntArray, labels: IntArray, domain: TissueDomain
) -> Array:
    """Move nodes where cells of the layers are flat or inverted (at folds of the skin or edges of the cuts).

    Raises MeshError if some remain inverted.
    """
    constraints = NodeConstraints.of_faces(len(points), shell, labels)
    for goal_deg, passes in _UNTANGLING:
        if np.degrees(np.arcsin(np.clip(worst_sines(points, cells), -1, 1))).min() >= _LEAST_ANGLE_DEG:
            break
        points = smooth(points, cells, constraints, domain, goal_deg=goal_deg, passes=passes)
    inverted = volumes(points, cells) <= 1e-9
    if inverted.any():
        x, y, z = points[cells[inverted]].mean(axis=(0, 1))
        raise MeshError(
            f"{int(inverted.sum())} cells of the layers are inverted, near ({x:.0f}, {y:.0f}, {z:.0f}) mm",
            where="layers",
            fix="give thinner layers (--fat-mm, --skin-mm) or a finer mesh (--size-mm)",
        )
    return points


def _odd(order: IntArray) -> NDArray[np.bool_]:
    """Which orders (n, 3) of three corners reverse the orientation of a triangle.

    >>> _odd(np.array([[0, 1, 2], [1, 0, 2], [1, 2, 0]]))
    array([False,  True, False])
    """
    return np.asarray((order[:, 1] - order[:, 0]) % 3 == 2)


def _cut_normals(core: VolumeMesh, inner: TissueDomain, base: IntArray) -> Array:
    """For each node (n, 3, 3), the projector onto the normals of the cuts in which it lies."""
    out = np.zeros((len(base), 3, 3))
    for k, plane in enumerate(inner.planes):
        at = np.isin(base, core.faces[core.labels == CUT + k])
        rest = plane.normal - np.einsum("nij,j->ni", out[at], plane.normal)
        size = np.linalg.norm(rest, axis=1, keepdims=True)
        unit = np.where(size > 1e-6, rest / np.maximum(size, 1e-12), 0.0)
        out[at] += unit[:, :, None] * unit[:, None, :]
    return out


def _levels(layers: tuple[Layer, ...]) -> tuple[list[float], list[int]]:
    """Relative heights (0 to 1) of the node rows from inside out, and the number of the layer below each."""
    total = sum(each.thickness for each in layers)
    heights, kinds, below = [], [], 0.0
    for number, each in enumerate(reversed(layers), start=1):
        for k in range(1, each.n_cells + 1):
            heights.append((below + each.thickness * k / each.n_cells) / total)
            kinds.append(number)
        below += each.thickness
    return heights, kinds


def _prisms(low: IntArray, high: IntArray, turned: NDArray[np.bool_]) -> IntArray:
    """Three tetrahedra per prism; corners are in the same order everywhere, so neighbours share diagonals.

    turned (n,) : whether this order is the facet's orientation seen from inside
    """
    (a, b, c), (d, e, f) = low.T, high.T
    cells = np.vstack([np.c_[a, b, c, f], np.c_[a, b, f, e], np.c_[a, e, f, d]])
    inside = np.tile(turned, 3)
    cells[inside] = cells[inside][:, [0, 2, 1, 3]]
    return cells


def _labels(
    shell: IntArray, points: Array, core: VolumeMesh, outer: IntArray, domain: TissueDomain
) -> IntArray:
    """Labels of the whole boundary: those of the core, SKIN on the outside, cuts on the sides."""
    known = {
        tuple(face): label
        for face, label in zip(np.sort(core.faces, axis=1).tolist(), core.labels, strict=True)
    }
    is_outer = np.asarray(np.isin(shell, outer).all(axis=1))
    out = np.empty(len(shell), np.int64)
    for k, face in enumerate(np.sort(shell, axis=1).tolist()):
        out[k] = SKIN if is_outer[k] else known.get(tuple(face), -1)
    between = out < 0
    if between.any():
        middle = points[shell[between]].mean(axis=1)
        height = np.stack([np.abs(each.height(middle)) for each in domain.planes])
        out[between] = CUT + np.argmin(height, axis=0)
    return out
