"""Variations of a limb's assumed geometry by one standard deviation each, and the model morphed accordingly.

bone's radius    times 0.7 and 1.4: the tibia of OpenLimb's limbs has 9 to 20 mm (`case.schema`)
bone's depth     by the case's stated noise of a depth reading, else 0.3 mm; if one straight bone lies
                 under several sites, combined with its deviation from this site's reading
bone's slope     7.4 degrees along the limb relative to the skin
bone's side      the beam meets the bone 22 degrees off its line nearest to the skin
second bone      of 0.3 times the radius, separated from the first by 16 mm of tissue; only if the first is
                 the only bone
roundness        only for a limb given by numbers: the skin's radius of curvature times 0.7 and 1.7 at
                 constant circumference. Around residual limbs it is 0.68 to 1.8 times that of a circle of the
                 same circumference
taper            only for a limb given by numbers: sections grow by 24 % over 100 mm
scale            only for a scanned skin: by the value stated by the case (`skin_scale_fraction`), else 1 %

All but the last were determined from sections 3 to 15 cm above the end of the mean and four virtual limbs of
OpenLimb (Sunderland et al. 2024, doi 10.1101/2024.11.27.24317622): slope, side and taper are their 68 %
quantiles (for beams along the skin's normal, up to 60 degrees around the limb from where tibia and skin are
nearest); the fibula's size and distance are medians. Limits of agreement (two standard deviations) of
perimeters of scanned limb models are below 3.5 % (Cutti et al. 2024, Sensors 24:2350); 1 % is chosen. Slope,
side and taper are varied in one direction only: for a site with similar tissue on both sides, the opposite
variation is equivalent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from limbcli.case import Imaging
from limbcli.errors import LimbError, MeshError
from limbcli.meshing.morph import aside, deeper, flatter, larger, morphed, sloping, tapered, wider
from limbcli.meshing.rods import Rod
from limbcli.model import Array, IntArray, LimbModel, Mesh

RADIUS, ROUNDNESS, USUAL_DEPTH = (0.7, 1.4), (0.7, 1.7), 0.3
SLOPE, SIDE_DEG, TAPER = 0.13, 22.0, 0.0024  # mm/mm; degrees; 1/mm, change of ln of a section's size
SECOND_RADIUS, SECOND_BESIDE = 0.3, 16.0  # fraction of the first bone's radius; mm of tissue between them
_FACTORS = ("radius", "roundness", "scale")
_PARTS = (1.0, 0.5, 0.25, 0.1)  # fractions tried if cells would be crushed; the effect is then scaled up
_FEWEST = 6  # least number of nodes within a second bone
_FIXED = "fixed"


@dataclass(frozen=True)
class Variation:
    """One variation: a factor, mm, a slope, radians or 1/mm (1 for a second bone), and its description."""

    kind: str
    value: float
    words: str

    def part(self, share: float) -> float:
        """The value of a fraction of this variation.

        >>> Variation("depth", 0.3, "").part(0.5), Variation("radius", 4.0, "").part(0.5)
        (0.15, 2.0)
        """
        return self.value**share if self.kind in _FACTORS else share * self.value


def variations(imaging: Imaging, *, depth: float, bones: int) -> tuple[Variation, ...]:
    """The variations of a limb's assumptions, one standard deviation each; depth : that of the bone's, mm"""
    slope, taper = np.degrees(np.arctan(SLOPE)), 100 * TAPER
    found = [Variation("radius", each, f"bone's radius times {each:g}") for each in RADIUS]
    found += [
        Variation("depth", depth, f"bone {depth:.2g} mm deeper"),
        Variation("slope", SLOPE, f"bone sloping by {slope:.1f} degrees along the limb"),
        Variation("side", float(np.radians(SIDE_DEG)), f"bone met {SIDE_DEG:g} degrees off its nearest line"),
    ]
    if bones < 2:
        found.append(Variation("second bone", 1.0, f"a second bone {SECOND_BESIDE:g} mm beside"))
    if imaging.shape is not None:
        found += [
            Variation("roundness", each, f"skin's radius of curvature times {each:g}") for each in ROUNDNESS
        ]
        found.append(Variation("taper", TAPER, f"sections growing by {taper:.2f} % each mm along the limb"))
    else:
        scale = imaging.skin_scale
        found.append(Variation("scale", 1.0 + scale, f"scan {100 * scale:.2g} % larger"))
    return tuple(found)


def depth_deviation(stated: float, seen: Mapping[str, Any]) -> float:
    """Standard deviation (mm) of the bone's depth: a reading's combined with the modelled bone's misfit.

    seen : a site of `geometry` in segment.json

    >>> round(depth_deviation(0.0, {"skin_bone_mm": 15.0, "made_mm": 15.4}), 6)
    0.5
    """
    made = seen["made_mm"]
    missed = 0.0 if made is None else float(made) - float(seen["skin_bone_mm"])
    return float(np.hypot(stated if stated > 0 else USUAL_DEPTH, missed))


def shaped(model: LimbModel, rod: Rod, variation: Variation) -> tuple[LimbModel, float]:
    """The model in its varied shape, and the fraction of it that was applied; MeshError if none could be."""
    if variation.kind == "second bone":
        return model.with_mesh(with_second_bone(model.mesh, rod)), 1.0
    for part in _PARTS[:-1]:
        try:
            return model.with_mesh(varied_mesh(model.mesh, rod, variation, part)), part
        except LimbError:
            continue
    return model.with_mesh(varied_mesh(model.mesh, rod, variation, _PARTS[-1])), _PARTS[-1]


def varied_mesh(mesh: Mesh, rod: Rod, variation: Variation, part: float = 1.0) -> Mesh:
    """The mesh morphed to another shape, first touch at the origin; MeshError if a cell would be crushed."""
    value, touched = variation.part(part), np.zeros(3)
    moves = {
        name: np.zeros((len(mesh.node_sets[name]), 3)) for name in ("bone", "skin") if name in mesh.node_sets
    }
    bone, skin = (mesh.points[mesh.node_sets.get(name, np.zeros(0, np.int64))] for name in ("bone", "skin"))
    match variation.kind:
        case "roundness":
            moves["skin"] = flatter(skin, rod, touched, value)
        case "taper":
            moves["skin"] = tapered(skin, rod, touched, value)
        case "scale":
            moves["skin"] = larger(skin, touched, value)
        case "slope":
            moves["bone"] = _of_rod(bone, rod, sloping(bone, rod, touched, value))
        case "side":
            moves["bone"] = _of_rod(bone, rod, aside(bone, rod, value))
        case "radius":
            moves["bone"] = _of_rod(bone, rod, wider(bone, rod, value))
        case _:
            moves["bone"] = _of_rod(bone, rod, deeper(bone, rod, value))
    return morphed(mesh, moves)


def _of_rod(points: Array, rod: Rod, moved: Array) -> Array:
    """Displacements of the points on a rod; zero for other bones."""
    return np.where((np.abs(_radial(points, rod) - rod.radius) < 0.5 * rod.radius)[:, None], moved, 0.0)


def _radial(points: Array, rod: Rod) -> Array:
    away = points - rod.centre
    return np.asarray(np.linalg.norm(away - np.outer(away @ rod.axis, rod.axis), axis=1))


def with_second_bone(mesh: Mesh, rod: Rod) -> Mesh:
    """The mesh with the nodes of a second, thinner rod at equal depth fixed, on the side with more nodes;
    half-way where the tissue does not extend far enough.

    Raises MeshError if there is no room for the rod, or the mesh is too coarse to resolve it.
    """
    radius, side = SECOND_RADIUS * rod.radius, np.cross(rod.axis, rod.towards)
    tissue = mesh.solid_nodes
    points = mesh.points[tissue]
    level = np.abs((points - rod.centre) @ rod.towards) <= rod.radius
    both: list[IntArray] = []
    for sign in (1.0, -1.0):
        reach = float((sign * (points[level] - rod.centre) @ side).max(initial=0.0))
        beside = min(SECOND_BESIDE, 0.5 * (reach - rod.radius - 2.0 * radius))
        centre = rod.centre + sign * side * (rod.radius + beside + radius)
        inside = _radial(points, replace(rod, centre=centre)) <= radius
        both.append(tissue[inside] if beside > 0 else tissue[:0])
    held = max(both, key=len)
    if len(held) < _FEWEST:
        raise MeshError(
            f"a second bone next to the first would contain {len(held)} nodes of the mesh",
            where="a varied geometry of the limb",
            fix="use a finer mesh (--size-mm, --far-size-mm), or keep more tissue (margin_mm of [model])",
        )
    return replace(mesh, node_sets={**mesh.node_sets, _FIXED: np.union1d(mesh.node_sets[_FIXED], held)})
