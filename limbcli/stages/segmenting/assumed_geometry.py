"""The limb of a case without images: surfaces made from its assumed shape.

From numbers only: a straight circular tube with one circular bone, whose anterior depth is the sum of the
layers' thicknesses. From a scanned skin and a bone located by ultrasound: a straight circular rod along the
limb, whose nearest line lies at the measured distance under the probe; sites whose rods would overlap by half
share one bone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from limbcli.case import Case, Site
from limbcli.case.noting import unnoted
from limbcli.case.parts import Shape
from limbcli.case.parts import point as coordinates
from limbcli.errors import CaseError
from limbcli.errors.problems import Problem, errors_of, raise_errors
from limbcli.imaging.surface import BONE_EDGE, SKIN_EDGE
from limbcli.meshing.frame import proximal_direction, site_frame
from limbcli.meshing.mending import Limb, mend, skin_and_bones
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.rods import BoneHit, Rod, limb_axis, rods_for, tube
from limbcli.meshing.sites_on_skin import place_problems
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array
from limbcli.site_model.mesh_checks import measured_skin_bone
from limbcli.stages.segmenting.surfaces import read_body

LENGTH = 300.0  # mm, length of a limb given by numbers: longer than any usual model with its margin
# Tolerance of the layers' sum against the skin-bone distance: mm, and standard deviations (the larger).
_SUM_OFF, _BEYOND_CHANCE = 1.0, 4.0
# Share of the layers' sum by which a probe that already presses at level 0 may have shortened it; beyond it
# the numbers are wrong. Chosen.
_PRESSED = 0.2
_ASIDE = 0.5  # mm, difference from the anterior thickness above which a site is not anterior
_DEPTH_OFF = 1.0  # mm, deviation of a shared bone's depth from a site's measurement that is reported
BONE = "bone_1"


@dataclass(frozen=True, eq=False, kw_only=True)
class ThicknessComparison:
    """One site's skin-bone distance (mm): measured, with its source, and in the surfaces made."""

    measured: float
    source: str
    made: float | None
    bone: str
    point: tuple[float, float, float]
    normal: tuple[float, float, float]

    def to_json(self) -> dict[str, Any]:
        return {
            "skin_bone_mm": self.measured, "source": self.source, "made_mm": self.made, "bone": self.bone,
            "skin_point_mm": list(self.point), "normal": list(self.normal),
        }  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class AssumedLimb:
    """Surfaces by the names used by `segment`, the bones as rods, and each site's skin-bone distance."""

    surfaces: Mapping[str, Triangles]
    bones: Mapping[str, Rod]
    sites: Mapping[str, ThicknessComparison]
    notes: tuple[str, ...] = ()
    shape: Shape | None = None
    warnings: tuple[str, ...] = field(default=())

    def to_json(self, words: str) -> dict[str, Any]:
        """`geometry` of segment.json, from which a fit varies the assumptions."""
        return {
            "words": words,
            "kind": "from-ultrasound" if self.shape is None else "numbers",
            "circumference_mm": None if self.shape is None else self.shape.circumference,
            "bones": {
                name: {"centre_mm": each.centre, "axis": each.axis, "radius_mm": each.radius,
                       "towards": each.towards, "from_mm": each.low, "to_mm": each.high}
                for name, each in self.bones.items()
            },
            "sites": {name: each.to_json() for name, each in self.sites.items()},
        }  # fmt: skip


def assumed_limb(case: Case) -> AssumedLimb:
    """Skin and bones of a case without images of them.

    Raises CaseError listing every problem: layers that do not add up, a site without a distance to the bone.
    """
    problems = assumed_problems(case)
    raise_errors(problems, CaseError)
    made = _of_numbers(case.imaging.shape, case) if case.imaging.shape is not None else _of_a_scan(case)
    return replace(made, warnings=(*made.warnings, *(f"{each.what}; {each.fix}" for each in problems)))


def assumed_problems(case: Case) -> list[Problem]:
    """Contradictions between numbers and measurements, and missing ones, before any surface is made."""
    if case.imaging.shape is not None:
        return [each for site in case.sites for each in _off_the_sum(case.imaging.shape, site, case)]
    if case.imaging.bone_radius is None:
        return []
    where = str(case.file)
    if not case.sites:
        if case.raw.get("site"):
            what = "no [[site]] with an ultrasound distance to the bone can be used yet"
            return [Problem(what, where, "`limbcli check CASE` lists what is missing; then segment")]
        fix = "add a [[site]] with position_mm, long_axis and the distance to the bone; then segment"
        return [Problem("there is no site yet with an ultrasound distance to the bone", where, fix)]
    found = []
    if not np.isfinite(case.probe.length):
        fix = "fill in [probe]: the bone's distance is that under its face"
        found.append(Problem("the probe that the bone's distance refers to is unknown", where, fix))
    for site in case.sites:
        if seen_depth(site) is None:
            what = f"site {site.name} has no distance from skin to bone, and no image shows the bone"
            fix = (
                "fill skin_bone_mm of the first row of levels.csv (or all layers there), or write "
                "`skin_bone_mm = ...` in its [[site]]"
            )
            found.append(Problem(what, where, fix))
    return found


def seen_depth(site: Site) -> tuple[float, str] | None:
    """Skin-bone distance (mm) at first touch and its source: by hand, else levels.csv, else [b_mode]."""
    if site.skin_bone is not None:
        return site.skin_bone, "skin_bone_mm of the site"
    measured = measured_skin_bone(site)
    if measured is not None:
        return measured, "levels.csv, first row"
    marked: Any = site.instruments.get("b_mode", {}).get("bone_mm")
    first = marked[0] if isinstance(marked, list) else marked
    return None if first is None else (float(first), "bone_mm of [site.b_mode]")


def _off_the_sum(shape: Shape, site: Site, case: Case) -> list[Problem]:
    """Problem if a site's skin-bone distance is not that of the circular limb (anterior: the layers' sum)."""
    seen, (point, normal) = seen_depth(site), _on_tube(shape, site)
    made = _rods(shape)[1].depth_under(point, -normal)
    allowed = max(_SUM_OFF, _BEYOND_CHANCE * 2.0 * unnoted(site).noise.layer)  # sqrt(4): three layers, total
    if seen is None or (made is not None and abs(seen[0] - made) <= allowed):
        return []
    but = f"but the skin-bone distance of site {site.name} is {seen[0]:g} mm ({seen[1]})"
    if _is_aside(shape, made):
        here = "has no bone under it" if made is None else f"is {made:.1f} mm thick there"
        what = f"site {site.name} is not anterior, and the round limb {here}, {but}"
        fix = "put the site into a separate case, with the layers read there and without position_mm"
        return [Problem(what, str(case.file), fix)]
    parts = f"skin {shape.skin:g} + fat {shape.fat:g} + muscle {shape.muscle:g} = {shape.skin_bone:g} mm"
    if (1.0 - _PRESSED) * shape.skin_bone <= seen[0] < shape.skin_bone:
        what = f"the layers add up to more than the thickness: {parts}, {but}"
        fix = "read both on one image; if the probe already pressed at level 0, the shape is that without it"
        return [Problem(what, str(case.file), fix, severity="warning")]
    what = f"the layers do not add up to the thickness: {parts}, {but}"
    return [Problem(what, str(case.file), "read layers and bone on one image; muscle_mm extends to the bone")]


# ---------------------------------------------------------------- made


def _rods(shape: Shape) -> tuple[Rod, Rod]:
    """Skin and bone of a limb given by numbers."""
    skin = tube(shape.radius, LENGTH)
    inward = shape.radius - shape.skin_bone - shape.bone_radius
    return skin, Rod(inward * skin.towards, skin.axis, shape.bone_radius, skin.low, skin.high, skin.towards)


def _on_tube(shape: Shape, site: Site) -> tuple[Array, Array]:
    """A site's point (3,) on the skin, and the normal (3,) there."""
    assert site.position is not None
    x, y, z = site.position
    normal = np.array([x, y, 0.0]) / max(float(np.hypot(x, y)), 1e-9)
    return shape.radius * normal + [0.0, 0.0, z], normal


def _is_aside(shape: Shape, made: float | None) -> bool:
    return made is None or abs(made - shape.skin_bone) > _ASIDE


def _of_numbers(shape: Shape, case: Case) -> AssumedLimb:
    skin, bone = _rods(shape)
    surfaces = {"skin": skin.surface(edge=SKIN_EDGE), BONE: bone.surface(edge=BONE_EDGE)}
    sites, aside = {}, []
    for site in case.sites:
        point, normal = _on_tube(shape, site)
        made, depth, source = bone.depth_under(point, -normal), shape.skin_bone, "[imaging] shape"
        if _is_aside(shape, made):
            aside.append(site.name)
            depth, source = seen_depth(site) or (made or depth, source)
        sites[site.name] = ThicknessComparison(
            measured=depth,
            source=source,
            made=made,
            bone=BONE,
            point=coordinates(point),
            normal=coordinates(normal),
        )
    warnings = tuple(
        f"site {name} is not anterior, where [imaging] shape gives the layers: the tissue "
        "thickness there is that of the round limb" for name in aside
    )  # fmt: skip
    return AssumedLimb(surfaces=surfaces, bones={BONE: bone}, sites=sites, shape=shape, warnings=warnings)


def _of_a_scan(case: Case) -> AssumedLimb:
    path, radius = case.imaging.skin, case.imaging.bone_radius
    assert path is not None
    assert radius is not None
    skin, warnings = read_body(path, case.imaging)
    pieces = skin_and_bones(skin)
    notes = [f"{len(pieces) - 1} smaller bodies of {path.name} are excluded"] if len(pieces) > 1 else []
    limb = mend(pieces[0], [], where=str(path))
    proximal = proximal_direction(limb)
    places = {site.name: np.array(site.position) for site in case.sites}
    raise_errors(errors_of(place_problems(limb.skin, places, where=str(case.file))), CaseError)
    seen = {site.name: _seen(site, limb, case) for site in case.sites}
    axis = limb_axis(limb, np.array([each.point for each in seen.values()]), proximal)
    bones, sites, whole = {}, {}, {"skin": pieces[0]}
    for number, (rod, names) in enumerate(rods_for(seen, limb, axis, radius), 1):
        bone = f"bone_{number}"
        bones[bone], whole[bone] = rod, rod.surface(edge=BONE_EDGE)
        notes.append(f"{bone}: as measured at {', '.join(names)}, {rod.high - rod.low:.0f} mm long")
        for name in names:
            each, (depth, source) = seen[name], _known(case.site(name))
            made = rod.depth_under(each.point, -each.normal)
            sites[name] = ThicknessComparison(
                measured=depth, source=source, made=made, bone=bone, point=coordinates(each.point),
                normal=coordinates(each.normal),
            )  # fmt: skip
            warnings += _disagreement(name, depth, made, names)
    return AssumedLimb(surfaces=whole, bones=bones, sites=sites, notes=tuple(notes), warnings=tuple(warnings))


def _disagreement(name: str, measured: float, made: float | None, names: list[str]) -> list[str]:
    if made is not None and abs(made - measured) <= _DEPTH_OFF:
        return []
    lies = "its beam misses the bone" if made is None else f"it lies {made:.1f} mm deep there"
    return [
        f"site {name} measured the bone {measured:g} mm deep; with the one straight bone that "
        f"{', '.join(names)} share, {lies}"
    ]


def _seen(site: Site, limb: Limb, case: Case) -> BoneHit:
    probe = ProbeShape(case.probe.length, case.probe.width, case.probe.edge_radius)
    assert site.position is not None
    frame = site_frame(limb, np.array(site.position), site.long_axis, probe, where=f"site {site.name}")
    return BoneHit(frame.skin_point, frame.normal, _known(site)[0])


def _known(site: Site) -> tuple[float, str]:
    found = seen_depth(site)
    assert found is not None
    return found
