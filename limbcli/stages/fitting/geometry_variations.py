"""What is assumed of a limb that nobody imaged, varied by one deviation each, and the model in that shape.

bone's radius    times 0.7 and 1.4: the tibia of OpenLimb's limbs has 9 to 20 mm (`case.schema`)
bone's depth     by the noise of a depth reading that the case states, else 0.3 mm; where one straight bone
                 lies under several sites, also by what it misses this site's reading by
bone's slope     7.4 degrees along the limb against the skin
bone's side      the beam meets it 22 degrees off its nearest line
second bone      of 0.3 times the radius, 16 mm of tissue beside the first, where the first is alone
roundness        of a limb in numbers only: the skin's radius of curvature times 0.7 and 1.7 at the same
                 circumference. Round residual limbs it is 0.68 to 1.8 times that of a circle of the same
                 circumference
taper            of a limb in numbers only: sections grow by 24 % over 100 mm
scale            of a scanned skin only: by what the case states (`skin_scale_fraction`), else 1 %

All but the last are of sections 3 to 15 cm above the end, the mean and four virtual limbs of OpenLimb
(Sunderland et al. 2024, doi 10.1101/2024.11.27.24317622): slope, side and taper are what 68 % of them stay
below (beams along the skin's normal, up to 60 degrees round from where tibia and skin are nearest), the
fibula's size and distance are medians. Limits of agreement (two deviations) of perimeters of scanned
limb models are below 3.5 % (Cutti et al. 2024, Sensors 24:2350); 1 % is chosen. Slope, side and taper are
varied one way only: to a site whose tissue is alike on both sides the other way is the same.
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
SLOPE, SIDE_DEG, TAPER = 0.13, 22.0, 0.0024  # mm per mm; degrees; ln of a section's size per mm
SECOND_RADIUS, SECOND_BESIDE = 0.3, 16.0  # of the first bone's; mm of tissue between them
_FACTORS = ("radius", "roundness", "scale")
_PARTS = (1.0, 0.5, 0.25, 0.1)  # of a variation, where cells would be crushed: what it does is then scaled up
_FEWEST = 6  # nodes that a second bone must hold
_FIXED = "fixed"


@dataclass(frozen=True)
class Variation:
    """What is varied, in words; `value`: a factor, mm, a slope, radians, or the share of a second bone."""

    kind: str
    value: float
    words: str

    def part(self, share: float) -> float:
        """The value of a smaller step of the same kind.

        >>> Variation("depth", 0.3, "").part(0.5), Variation("radius", 4.0, "").part(0.5)
        (0.15, 2.0)
        """
        return self.value**share if self.kind in _FACTORS else share * self.value


def variations(imaging: Imaging, *, depth: float, bones: int) -> tuple[Variation, ...]:
    """What is assumed of a limb, varied by one deviation; `depth`: mm, the bone's; `bones`: how many."""
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
    """mm of the bone's depth: of a reading, and by which the bone made misses it.

    seen : a site of `geometry` in segment.json

    >>> round(depth_deviation(0.0, {"skin_bone_mm": 15.0, "made_mm": 15.4}), 6)
    0.5
    """
    made = seen["made_mm"]
    missed = 0.0 if made is None else float(made) - float(seen["skin_bone_mm"])
    return float(np.hypot(stated if stated > 0 else USUAL_DEPTH, missed))


def shaped(model: LimbModel, rod: Rod, variation: Variation) -> tuple[LimbModel, float]:
    """The model in its varied shape, and how much of the variation its cells could take.

    Raises
    ------
    MeshError
        If they cannot take any of it.
    """
    if variation.kind == "second bone":
        return model.with_mesh(with_second_bone(model.mesh, rod)), 1.0
    for part in _PARTS[:-1]:
        try:
            return model.with_mesh(varied_mesh(model.mesh, rod, variation, part)), part
        except LimbError:
            continue
    return model.with_mesh(varied_mesh(model.mesh, rod, variation, _PARTS[-1])), _PARTS[-1]


def varied_mesh(mesh: Mesh, rod: Rod, variation: Variation, part: float = 1.0) -> Mesh:
    """A site's mesh in another shape; it is touched at the origin.

    Raises
    ------
    MeshError
        If a cell would lose nearly all of its volume.
    """
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
    """Of a rod's points only: other bones stay."""
    return np.where((np.abs(_radial(points, rod) - rod.radius) < 0.5 * rod.radius)[:, None], moved, 0.0)


def _radial(points: Array, rod: Rod) -> Array:
    away = points - rod.centre
    return np.asarray(np.linalg.norm(away - np.outer(away @ rod.axis, rod.axis), axis=1))


def with_second_bone(mesh: Mesh, rod: Rod) -> Mesh:
    """The mesh with the nodes of a thinner rod held, beside the first and as deep as its middle.

    Where tissue reaches less far it lies half-way; on the side where it holds more nodes of the tissue.

    Raises
    ------
    MeshError
        If the tissue does not reach that far, or the mesh is too coarse to hold it.
    """
    radius, side = SECOND_RADIUS * rod.radius, np.cross(rod.axis, rod.towards)
    tissue = np.unique(np.concatenate([block.cells.ravel() for block in mesh.solid_blocks]))
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
