"""A liner: one layer of elements on the outside of the skin, bonded to it or sliding on it.

Each facet of the skin is extruded along the normals of its corners, as a prism that is split into three
tetrahedra; neighbours split a common side alike, by the numbers of its corners. A liner that slides has nodes
of its own where the skin is, drawn `TIGHT_MM` inside the skin so that all of its inner face touches from the
beginning.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from limbcli.errors import MeshError
from limbcli.feb.law_tags import lame
from limbcli.meshing.quality import volumes
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array, Block, Domain, IntArray, LimbModel, Material, Surface

LINER, LINER_INSIDE = "liner", "liner_inside"
TIGHT_MM = 0.02  # presses 3 mm of 300 kPa onto a limb of 50 mm radius with 0.01 kPa
_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))  # of a tet10, in the order of its middle nodes


@dataclass(frozen=True, kw_only=True)
class Liner:
    """thickness : mm; youngs_modulus : MPa, of a neo-Hookean solid; poisson : its ratio at rest
    bonded : to the skin; else it slides on it
    """

    thickness: float
    youngs_modulus: float
    poisson: float
    bonded: bool = True

    @property
    def material(self) -> Material:
        mu, lam = lame(self.youngs_modulus, self.poisson)
        return Material("neo_hooke", {"mu": mu, "lambda": lam})


def with_liner(limb: LimbModel, liner: Liner, *, skin: str = "skin") -> LimbModel:
    """The limb with its liner: block and surface `liner`; the surface's facets are in the skin's order. Of a
    liner that slides also the surface `liner_inside`, whose normals point to the skin.

    Raises MeshError if the layer would fold: the skin is too hollow for its thickness.
    """
    (kind, facets), *_ = limb.mesh.surfaces[skin].facets.items()
    corners = facets[:, :3]
    inner = np.unique(corners)
    surface = Triangles(limb.mesh.points[inner], np.searchsorted(inner, corners).astype(np.int64))
    outer = len(limb.mesh.points) + np.searchsorted(inner, corners)
    points = np.concatenate([limb.mesh.points, grown(surface, liner.thickness).points])
    cells = _split(corners, outer)
    skins = outer
    if kind == "tri6":
        points, cells, skins = _curved(points, cells, facets, outer)
    surfaces = {**limb.mesh.surfaces, LINER: Surface(LINER, {kind: skins})}
    if not liner.bonded:
        inward = np.zeros_like(limb.mesh.points)
        inward[inner] = -TIGHT_MM * surface.point_normals
        if kind == "tri6":  # a middle node moves as its ends do on average
            inward[facets[:, 3:]] = 0.5 * (inward[corners] + inward[np.roll(corners, -1, axis=1)])
        # points with the liner's own nodes in place of the skin's, its cells, and the facets of its inner
        # face
        own = np.unique(facets)
        numbers = np.arange(len(points) + len(own))
        numbers[own] = len(points) + np.arange(len(own))
        turned = facets[:, [0, 2, 1]] if facets.shape[1] == 3 else facets[:, [0, 2, 1, 5, 4, 3]]
        points, cells, inside = (
            np.concatenate([points, points[own] + inward[own]]),
            numbers[cells],
            numbers[turned],
        )
        surfaces[LINER_INSIDE] = Surface(LINER_INSIDE, {kind: inside})
    _refuse_folds(points, cells, liner.thickness)
    mesh = replace(
        limb.mesh,
        points=points,
        blocks=(*limb.mesh.blocks, Block(LINER, "tet4" if kind == "tri3" else "tet10", cells)),
        surfaces=surfaces,
    )
    return replace(
        limb,
        mesh=mesh,
        materials={**limb.materials, LINER: liner.material},
        domains=(*limb.domains, Domain(LINER, LINER)),
    )


def grown(surface: Triangles, thickness: float) -> Triangles:
    """A surface moved outward along the normals of its points, mm."""
    return Triangles(surface.points + thickness * surface.point_normals, surface.faces)


def _split(corners: IntArray, outer: IntArray) -> IntArray:
    """Three tetrahedra (3 n_facets, 4) per prism between facets (n_facets, 3)."""
    order = np.argsort(corners, axis=1)
    a = np.take_along_axis(corners, order, axis=1)
    b = np.take_along_axis(outer, order, axis=1)
    cells = np.concatenate([
        np.stack([a[:, 0], a[:, 1], a[:, 2], b[:, 2]], axis=1),
        np.stack([a[:, 0], a[:, 1], b[:, 1], b[:, 2]], axis=1),
        np.stack([a[:, 0], b[:, 0], b[:, 1], b[:, 2]], axis=1),
    ])  # fmt: skip
    # sorting may have mirrored the facet, and the middle tetrahedron is the mirror image of the others
    mirrored = np.linalg.det(np.eye(3)[order]) < 0
    swap = np.tile(mirrored, 3) ^ np.repeat([False, True, False], len(corners))
    cells[swap] = cells[swap][:, [1, 0, 2, 3]]
    return cells


def _curved(
    points: Array, cells: IntArray, facets: IntArray, outer: IntArray
) -> tuple[Array, IntArray, IntArray]:
    """Points with middle nodes, tet10 cells (n, 10) and the outer tri6 facets (n_facets, 6).

    The skin keeps its own middle nodes; those of all edges above an edge of the skin, also of those through
    the layer, are curved as it is: straight ones would turn cells over where the skin is strongly curved.
    """
    n = len(points)
    ends = np.concatenate([np.sort(cells[:, list(pair)], axis=1) for pair in _EDGES])
    on_skin = np.concatenate([np.sort(facets[:, list(pair)], axis=1) for pair in _EDGES[:3]])
    above = np.concatenate([np.sort(outer[:, list(pair)], axis=1) for pair in _EDGES[:3]])
    every, which = np.unique(np.concatenate([ends, on_skin, above]), axis=0, return_inverse=True)
    which = which.ravel()
    of_skin = which[len(ends) : len(ends) + len(on_skin)]
    of_outer = which[len(ends) + len(on_skin) :]
    middle = 0.5 * (points[every[:, 0]] + points[every[:, 1]])
    skin_middles = facets[:, 3:].T.ravel()
    below = np.arange(n)
    below[outer] = facets[:, :3]
    foot = np.sort(below[every], axis=1)
    leaning = foot[:, 0] != foot[:, 1]  # the others stand on a corner
    first, second = every.T  # in ascending order
    on = np.searchsorted(first * n + second, foot[leaning] @ np.array([n, 1]))
    bulge = np.zeros_like(middle)
    bulge[of_skin] = points[skin_middles] - middle[of_skin]
    middle[leaning] += bulge[on]
    numbers = np.full(len(every), -1, dtype=np.int64)
    numbers[of_skin] = skin_middles
    new = numbers < 0
    numbers[new] = n + np.arange(int(new.sum()))
    of_cells = numbers[which[: len(ends)]].reshape(len(_EDGES), -1).T
    outside = numbers[of_outer].reshape(3, -1).T
    return (
        np.concatenate([points, middle[new]]),
        np.concatenate([cells, of_cells], axis=1),
        np.concatenate([outer, outside], axis=1),
    )


def _refuse_folds(points: Array, cells: IntArray, thickness: float) -> None:
    if (folded := np.flatnonzero(volumes(points, cells) <= 0)).size:
        place = points[cells[folded[0], :4]].mean(axis=0)
        raise MeshError(
            f"the liner of {thickness:g} mm would fold at ({', '.join(f'{each:.0f}' for each in place)}) "
            f"of the limb's upright frame: {len(folded)} elements turn over",
            where="[socket.liner]",
            fix="give a thinner liner, or a smoother skin",
            n_folded=len(folded),
        )
