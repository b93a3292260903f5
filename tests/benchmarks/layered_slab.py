"""A quarter of a layered slab on a rigid base under the probe.

It is the simplest geometry with a finite thickness, layers and a probe of finite size. Two planes of symmetry
(x = 0, y = 0) pass through the centre of the probe. The base is fixed like bone, the far sides are free like
a limb's flanks. Cells conform to the layer interfaces, so that each interface is a row of nodes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from limbcli.errors import MeshError
from limbcli.meshing.probe import ProbeShape, probe_mesh
from limbcli.meshing.regions import facets, quadratic
from limbcli.model import Array, Block, Domain, IntArray, LimbModel, Material, Mesh, Step, Support, Surface
from limbcli.model.bodies import Contact, Drive, RigidBody

QUARTER = 4.0  # ratio of the whole probe's force to that on the quarter
LAYERS = ("skin", "fat", "tissue")  # from the outside in; muscle is the tissue
_HEX_TO_TETS = ((0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6))
_CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
_NEAR = 1e-6
_CLOSER = 1.6


@dataclass(frozen=True)
class Slab:
    """Thicknesses of skin, fat and muscle (mm), the probe, and the width of tissue beside it (mm)."""

    skin: float
    fat: float
    muscle: float
    probe: ProbeShape
    margin: float

    @property
    def thickness(self) -> float:
        return self.skin + self.fat + self.muscle


@dataclass(frozen=True)
class CellCounts:
    """Numbers of cells along the probe's half sides (x, y), beside it (x, y), and through the layers."""

    along: int = 3
    across: int = 2
    beside_x: int = 2
    beside_y: int = 4
    skin: int = 1
    fat: int = 2
    muscle: int = 2


def slab_model(
    slab: Slab, laws: Mapping[str, Material], *, counts: CellCounts = CellCounts(), start: float = 0.0
) -> LimbModel:
    """The quarter slab as a tet10 model, the probe's face `start` mm inside; `laws` by the names in LAYERS.

    Its node set `axis` holds the interface nodes under the probe's centre, from the outside in: surface, skin
    to fat, fat to muscle.

    Raises
    ------
    MeshError
        If a thickness or the margin is not positive.
    """
    if min(slab.skin, slab.fat, slab.muscle, slab.margin) <= 0:
        raise MeshError(f"a slab with {slab}", where="layered slab", fix="give thicknesses above 0 mm")
    half_x, half_y = slab.probe.length / 2, slab.probe.width / 2
    x = _side(half_x, slab.margin, counts.along, counts.beside_x)
    y = _side(half_y, slab.margin, counts.across, counts.beside_y)
    z, layer = _heights(slab, counts)
    points, hexes, level = _grid(x, y, z)
    cells = np.concatenate([hexes[:, each] for each in _HEX_TO_TETS])
    of_layer = np.tile(layer[level], len(_HEX_TO_TETS))
    top = hexes[level == len(z) - 2][:, 4:]
    near = (points[top].mean(axis=1)[:, 0] < half_x + 0.7 * slab.margin) & (
        points[top].mean(axis=1)[:, 1] < half_y + 0.7 * slab.margin
    )
    skin = np.concatenate([top[near][:, [0, 1, 2]], top[near][:, [0, 2, 3]]])
    points, cells, middle = quadratic(points, cells)
    return _assembled(slab, laws, points, cells, of_layer, facets(skin, middle), start)


def _side(half: float, margin: float, under: int, beside: int) -> Array:
    """Node positions from the centre outwards: denser towards the face's edge, coarser beyond it."""
    inside = half * (1.0 - (1.0 - np.linspace(0.0, 1.0, under + 1)) ** _CLOSER)
    first = inside[-1] - inside[-2]
    sizes = first * _growth(first, margin, beside) ** np.arange(1, beside + 1)
    return np.concatenate([inside, half + np.cumsum(sizes) * margin / sizes.sum()])


def _growth(step: float, margin: float, n: int) -> float:
    """The growth ratio with which n cells, starting from `step`, fill the margin; 1 if equal cells do."""
    if step * n >= margin:
        return 1.0
    return float(
        brentq(lambda ratio: step * np.sum(ratio ** np.arange(1, n + 1)) - margin, 1.0, 1.0 + margin / step)
    )


def _heights(slab: Slab, counts: CellCounts) -> tuple[Array, IntArray]:
    """Heights (n + 1,) from the base to z = 0, and the index in LAYERS of every row of cells (n,)."""
    borders = -np.cumsum([0.0, slab.skin, slab.fat, slab.muscle])
    rows, layer = [np.zeros(1)], []
    for k, n in enumerate((counts.skin, counts.fat, counts.muscle)):
        rows.append(np.linspace(borders[k], borders[k + 1], n + 1)[1:])
        layer += [k] * n
    return np.concatenate(rows)[::-1].copy(), np.array(layer[::-1])


def _grid(x: Array, y: Array, z: Array) -> tuple[Array, IntArray, IntArray]:
    """Points, hexahedra, and the row of each hexahedron through the thickness."""
    shape = (len(x), len(y), len(z))
    points = np.stack([axis.ravel() for axis in np.meshgrid(x, y, z, indexing="ij")], axis=1)
    number = np.arange(len(points)).reshape(shape)
    i, j, k = (each.ravel() for each in np.meshgrid(*(np.arange(n - 1) for n in shape), indexing="ij"))
    hexes = np.stack([number[i + a, j + b, k + c] for a, b, c in _CORNERS], axis=1)
    return points, hexes, k


def _assembled(
    slab: Slab,
    laws: Mapping[str, Material],
    points: Array,
    cells: IntArray,
    of_layer: IntArray,
    skin: dict[str, IntArray],
    start: float,
) -> LimbModel:
    rigid = probe_mesh(slab.probe, size=min(3.0, slab.probe.width / 4))
    first = len(points)
    quads, tips = rigid.quads + first, rigid.tips + first
    blocks = [Block(name, "tet10", cells[of_layer == k]) for k, name in enumerate(LAYERS)]
    on_axis = (np.abs(points[:, :2]) < _NEAR).all(axis=1)
    depths = [0.0, slab.skin, slab.skin + slab.fat]
    axis = [int(np.flatnonzero(on_axis & (np.abs(points[:, 2] + depth) < _NEAR))[0]) for depth in depths]
    sets = {
        "base": np.flatnonzero(points[:, 2] < -slab.thickness + _NEAR),
        "plane_x": np.flatnonzero(np.abs(points[:, 0]) < _NEAR),
        "plane_y": np.flatnonzero(np.abs(points[:, 1]) < _NEAR),
        "axis": np.array(axis),
    }
    surfaces = {
        "contact": Surface("contact", skin),
        "probe_face": Surface("probe_face", {"quad4": quads, "tri3": tips}),
    }
    mesh = Mesh(
        np.vstack([points, rigid.points - [0.0, 0.0, start]]),
        (*blocks, Block("probe", "quad4", quads), Block("probe_tips", "tri3", tips)),
        sets,
        surfaces,
    )
    return LimbModel(
        mesh=mesh,
        materials=dict(laws),
        domains=tuple(Domain(name, name) for name in LAYERS),
        bodies=(RigidBody("probe", (0.0, 0.0, -start), ("probe", "probe_tips")),),
        supports=(
            Support("base", ("x", "y", "z")),
            Support("plane_x", ("x",)),
            Support("plane_y", ("y",)),
        ),
        drives=tuple(Drive("probe", dof, "fixed") for dof in ("x", "y", "u", "v", "w")),
        contacts=(Contact("contact", "probe_face"),),
        steps=(Step(),),
    )
