"""A socket made from the limb itself: the skin, moved in or out patch by patch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from limbcli.errors import CaseError, MeshError
from limbcli.meshing.surfaces import Triangles, merge_points
from limbcli.model import Array, IntArray

# No published table of rectifications has been read in full: the skin's own shape is what is chosen.
CHOSEN = "no rectification was given: the socket has the shape of the skin (0 mm everywhere, chosen)"
# The wall above a flared brim: how far it goes on, and the radius with which it rolls outward, as a trim line
# is rounded. Chosen. Skin that bulges over the brim leaves it by and by: off the end of a wall it loses its
# traction at once, and no equilibrium may be left.
LIP_MM, _LIP_RADIUS_MM = 10.0, 6.0
_PARTS = 4  # of a curved edge: leaves a sixteenth of what it bulges


@dataclass(frozen=True, kw_only=True)
class Rectification:
    """How the skin becomes a socket.

    patches_mm : by patch, mm; positive: into the limb
    all_mm : of the whole skin, mm; positive: into the limb
    transition_mm : width of the transition around a patch
    brim_mm : height, along the direction towards the tip, at which the socket begins; None: whole skin
    flare_mm : outward, at the brim, as a trim line is flared; falls to 0 over `flare_width_mm` below it. If
        it is not 0, the wall goes on above the brim and rolls outward (`LIP_MM`)
    """

    patches_mm: Mapping[str, float]
    all_mm: float = 0.0
    transition_mm: float = 15.0
    brim_mm: float | None = None
    flare_mm: float = 0.0
    flare_width_mm: float = 20.0

    @property
    def sentence(self) -> str:
        changed = {name: mm for name, mm in self.patches_mm.items() if mm}
        if not changed and not self.all_mm:
            return CHOSEN
        parts = [f"{name} {mm:+g} mm" for name, mm in changed.items()]
        return f"the skin moved inward by {self.all_mm:g} mm" + (f"; {', '.join(parts)}" if parts else "")


def along_curves(points: Array, facets: IntArray) -> Triangles:
    """Facets of a mesh as flat triangles: a tri3 (n, 3) as it is, a tri6 (n, 6) as `_PARTS`**2 triangles
    whose corners lie on it. The parts of a facet follow each other, in the facets' order.

    A wall through a facet's corners alone would press on what bulges between them: 1 mm where edges of 20 mm
    bend around 50 mm, as much as sockets are tight.
    """
    if facets.shape[1] == 3:
        used, faces = np.unique(facets, return_inverse=True)
        return Triangles(points[used], faces.reshape(-1, 3).astype(np.int64))
    n = _PARTS
    places = [(i, j) for i in range(n + 1) for j in range(n + 1 - i)]
    number = {place: k for k, place in enumerate(places)}
    up = [((i, j), (i + 1, j), (i, j + 1)) for i, j in places if i + j < n]
    down = [((i + 1, j), (i + 1, j + 1), (i, j + 1)) for i, j in places if i + j < n - 1]
    parts = np.array([[number[place] for place in each] for each in up + down])
    r, s = np.array(places).T / n
    t = 1.0 - r - s
    shapes = np.stack([t * (2 * t - 1), r * (2 * r - 1), s * (2 * s - 1), 4 * t * r, 4 * r * s, 4 * s * t])
    on = np.einsum("ap,fai->fpi", shapes, points[facets])
    faces = parts + len(places) * np.arange(len(facets))[:, None, None]
    return merge_points(Triangles(on.reshape(-1, 3), faces.reshape(-1, 3)))


def rectified(
    skin: Triangles,
    patches: Mapping[str, IntArray],
    table: Rectification,
    toward_tip: Array,
    *,
    where: str = "rectifications",
) -> Triangles:
    """The inner face, with its normals towards the limb.

    Within a patch the skin moves by the full amount; around it the amount falls to 0 over `transition_mm`
    along a smooth curve (3 t^2 - 2 t^3). Where transitions overlap the amounts are averaged by their weights,
    if these exceed 1 in sum.

    skin : closed or open skin with outward normals, mm
    patches : by name, the numbers of the skin's points in it
    toward_tip (3,) : direction along the limb

    Raises CaseError if a patch is not known or has no points, or if the transition is not positive; MeshError
    if a facet would turn over: the amounts change too fast.
    """
    if table.transition_mm <= 0:
        raise CaseError(
            f"the transition is {table.transition_mm:g} mm wide", where=where, fix="give a positive width"
        )
    amount = np.full(len(skin.points), float(table.all_mm))
    weights, sums = np.zeros(len(skin.points)), np.zeros(len(skin.points))
    for name, mm in table.patches_mm.items():
        if not len(patches.get(name, ())):
            raise CaseError(
                f"there is no patch {name!r} on this limb",
                where=where,
                fix=f"use some of {', '.join(sorted(patches))}",
            )
        away = cKDTree(skin.points[patches[name]]).query(skin.points)[0]
        t = np.clip(1.0 - away / table.transition_mm, 0.0, 1.0)
        weight = t * t * (3.0 - 2.0 * t)
        weights += weight
        sums += weight * mm
    amount += sums / np.maximum(weights, 1.0)
    if table.brim_mm is not None and table.flare_mm:
        t = np.clip((skin.points @ toward_tip - table.brim_mm) / table.flare_width_mm, 0.0, 1.0)
        inside = t * t * (3.0 - 2.0 * t)
        amount = inside * amount - (1.0 - inside) * table.flare_mm
        above = np.clip(table.brim_mm - skin.points @ toward_tip, 0.0, None)
        amount -= above**2 / (2.0 * _LIP_RADIUS_MM)
    moved = Triangles(skin.points - amount[:, None] * skin.point_normals, skin.faces)
    kept = np.ones(len(skin.faces), dtype=bool)
    if table.brim_mm is not None:
        end = table.brim_mm - (LIP_MM if table.flare_mm else 0.0)
        kept = (skin.points @ toward_tip)[skin.faces].min(axis=1) >= end
        if not kept.any():
            raise CaseError(
                f"no skin lies beyond the brim at {table.brim_mm:g} mm",
                where=where,
                fix="give a height between the limb's ends",
            )
    turned = (moved.area_vectors * skin.area_vectors).sum(axis=1) <= 0
    if (turned & kept).any():
        place = skin.centroids[np.flatnonzero(turned & kept)[0]]
        raise MeshError(
            f"the socket would fold at ({', '.join(f'{each:.0f}' for each in place)}) of the "
            f"limb's upright frame: {int((turned & kept).sum())} facets turn over",
            where=where,
            fix="make the rectification there smaller, or the transition wider",
        )
    return moved.part(kept).flipped()
