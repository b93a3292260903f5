"""Plausibility checks on the skin and bones of one limb: sizes, bone positions and the side of the body.

The surfaces may come from any source and in any frame. A misplaced bone, a skin in the wrong unit or a
mirrored limb still produces plausible-looking numbers, so they are checked here: the impossible is an error,
the unusual a warning.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from limbcli.errors.problems import Problem
from limbcli.meshing.crop import within
from limbcli.meshing.distance import Heights
from limbcli.meshing.mending import Plane, enclosed, mend, principal_axis, skin_and_bones
from limbcli.meshing.sites_on_skin import triple
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array

SKIN = "skin"
# volume of a plausible limb, cm3: from a short residual limb of a child to a whole thigh and leg
_SKIN_CM3 = (100.0, 2.5e4)
LEAST_BONE = 150.0  # smallest volume of a bone, mm3; the same limit as for label maps (imaging.labels)
# volume of all bones as a fraction of the limb's: warning above the first, error above the second
_BONE_SHARE = (0.5, 0.8)
# a bone's point farther outside the skin than this counts as outside; less is surface roughness
_OUT_MM = 2.0
_OUT_SHARE = (0.01, 0.2)  # fraction of a bone's points outside the skin: warning, error
_OUT_FAR_MM = 15.0
# The core of a bone is what lies deeper than this fraction of its greatest depth; with more than this
# fraction of the core outside the skin, the bone lies in a hole of it.
_MIDDLE, _HOLLOW = 0.6, 0.5
_TWICE = 0.5  # fraction of a bone's points inside another bone, above which both are the same bone
# medial offset of the fibula from the tibia that is a clear one: mm, and sine of its angle
_ASIDE_MM, _ASIDE = 5.0, 0.5
# length-to-width ratio of an elongated limb; cosine to +z below which it lies across the patient frame
_ELONGATED, _UPRIGHT = 1.5, 0.5
_POINTS = 500  # largest number of points sampled per bone
IN_ONE_FRAME = "give skin and bones in one frame (mm, patient LPS), of the same limb and the same image"
_OR_ACCEPT = "; or keep what is inside the skin: `limbcli segment CASE --accept-bones`"


def limb_problems(surfaces: Mapping[str, Triangles], *, limb: str, where: str) -> list[Problem]:
    """Check the skin and bones of one limb; a bone that lies outside the skin is an error.

    surfaces : "skin" and the bones by name, mm, patient LPS; open or closed
    limb : "left" or "right"; verified by the position of the fibula, if two bones are named tibia and fibula

    Raises MeshError if the skin does not enclose a body.
    """
    skin = surfaces[SKIN]
    bones = {name: each for name, each in surfaces.items() if name != SKIN}
    mended = mend(skin, [], where=where, beside=list(bones.values()))
    found = _sizes(mended.skin.volume, bones, where)
    above_skin = Heights(mended.skin)
    found += _second_wall(skin, mended.skin.volume, where)
    above = {name: Heights(bone) for name, bone in bones.items()}
    found += _in_holes(bones, above, above_skin, mended.ends, where)
    found += _outside(bones, above_skin, mended.ends, where).values()
    across = _across(mended.skin, bones, where)
    return found + _twice(bones, above, where) + (across or _side(bones, limb, where))


def bones_outside(surfaces: Mapping[str, Triangles], *, where: str) -> tuple[Triangles, dict[str, str]]:
    """The closed skin, and in words how far each bone that `limb_problems` refuses lies outside it.

    Raises MeshError if the skin does not enclose a body.
    """
    bones = {name: each for name, each in surfaces.items() if name != SKIN}
    mended = mend(surfaces[SKIN], [], where=where, beside=list(bones.values()))
    found = _outside(bones, Heights(mended.skin), mended.ends, where)
    return mended.skin, {name: each.what for name, each in found.items() if each.severity == "error"}


def bone_named(bones: Mapping[str, Triangles], name: str) -> Triangles | None:
    """The first bone whose name contains `name`, such as "tibia"; None if there is none."""
    return next((each for known, each in bones.items() if name in known), None)


def _sizes(volume: float, bones: Mapping[str, Triangles], where: str) -> list[Problem]:
    """Compare volumes (cm3) with those of real limbs."""
    found = []
    low, high = _SKIN_CM3
    if not low <= volume / 1e3 <= high:
        what = f"the skin encloses {volume / 1e3:.3g} cm3; an imaged limb has {low:g} to {high:g} cm3"
        severe = volume / 1e3 > 2 * high
        found.append(_problem(what, where, "save the surfaces in mm (patient LPS)", error=severe))
    volumes = {name: abs(each.volume) for name, each in bones.items()}
    for name, each in volumes.items():
        if each < LEAST_BONE:
            what = f"{name} encloses only {each / 1e3:.2g} cm3"
            found.append(_problem(what, where, "remove it, or give the whole bone"))
    share = sum(volumes.values()) / max(volume, 1e-9)
    if share > _BONE_SHARE[0]:
        what = f"the bones fill {share:.0%} of the skin's volume"
        fix = "check which file is the skin and which a bone, and that all are in mm"
        found.append(_problem(what, where, fix, error=share > _BONE_SHARE[1]))
    return found


def _second_wall(skin: Triangles, volume: float, where: str) -> list[Problem]:
    """Report a second body in the skin's file that fills the limb: it would be taken for a bone."""
    largest = max([0.0, *(enclosed(each) for each in skin_and_bones(skin)[1:])])
    share = largest / max(volume, 1e-9)
    if share <= _BONE_SHARE[0]:
        return []
    what = f"the skin's file holds a second body, which would be a bone, of {share:.0%} of the skin's volume"
    fix = "give the skin as one surface (the outer one), not as a sheet with a thickness"
    return [_problem(what, where, fix, error=True)]


def _in_holes(
    bones: Mapping[str, Triangles],
    above: Mapping[str, Heights],
    above_skin: Heights,
    ends: tuple[Plane, ...],
    where: str,
) -> list[Problem]:
    """Report bones whose interior lies outside the skin although their surface does not.

    The skin then has holes around them.
    """
    found = []
    for name, bone in bones.items():
        deep = above[name].deepest(_MIDDLE)
        deep = deep[within(deep, ends)]
        out = float((above_skin.of(deep) > 0).mean()) if len(deep) else 0.0
        surface = float((above_skin.of(_some(bone.points)) > _OUT_MM).mean())
        if out > _HOLLOW and surface < _OUT_SHARE[1]:
            what = f"{name} lies in a hole of the skin: the inside of the bone is outside the limb"
            fix = "give the skin as the limb's outer surface, bones included; not the soft tissue around them"
            found.append(_problem(what, where, fix, error=True))
    return found


def _outside(
    bones: Mapping[str, Triangles], above_skin: Heights, ends: tuple[Plane, ...], where: str
) -> dict[str, Problem]:
    """By name, the bones that lie outside the skin.

    Points beyond a cut end of the limb count only if the whole bone lies beyond it.
    """
    found = {}
    for name, bone in bones.items():
        points = _some(bone.points)
        kept = within(points, ends)
        beyond = not kept.any()
        points = points if beyond else points[kept]
        height = above_skin.of(points)
        share, furthest = float((height > _OUT_MM).mean()), float(height.max())
        if beyond:
            what = f"{name} lies beyond the end of the skin, {height.min():.0f} mm from it at its nearest"
        elif share > _OUT_SHARE[0]:
            what = f"{share:.0%} of {name} lies outside the skin"
        else:
            continue
        what += f", by up to {furthest:.0f} mm at {triple(points[height.argmax()])} (LPS, mm)"
        is_error = beyond or share > _OUT_SHARE[1] or furthest > _OUT_FAR_MM
        fix = IN_ONE_FRAME + (_OR_ACCEPT if is_error else "")
        found[name] = _problem(what, where, fix, error=is_error)
    return found


def _twice(bones: Mapping[str, Triangles], above: Mapping[str, Heights], where: str) -> list[Problem]:
    """Report two bones that occupy the same place."""
    found = []
    names = sorted(bones, key=lambda each: -abs(bones[each].volume))
    for k, name in enumerate(names[:-1]):
        for other in names[k + 1 :]:
            points = _some(bones[other].points)
            share = float((above[name].of(points) < 0.5).mean())
            if share > _TWICE:
                what = f"{other} lies within {name} ({share:.0%} of it): the same bone twice?"
                fix = "give each bone once, each in a separate file"
                found.append(_problem(what, where, fix, error=True))
    return found


def _side(bones: Mapping[str, Triangles], limb: str, where: str) -> list[Problem]:
    """Check that the fibula lies lateral of the tibia: in a left leg towards +x (LPS), the patient's left.

    A fibula larger than the tibia is the tibia: nothing else is then told.
    """
    tibia, fibula = bone_named(bones, "tibia"), bone_named(bones, "fibula")
    if tibia is None or fibula is None:
        return []
    sizes = [abs(each.volume) / 1000 for each in (fibula, tibia)]
    if sizes[0] > sizes[1]:
        what = f"the fibula ({sizes[0]:.0f} cm3) is larger than the tibia ({sizes[1]:.0f} cm3)"
        return [_problem(what, where, "exchange their names: each is taken for the other")]
    x, y, _ = fibula.centroids.mean(axis=0) - tibia.centroids.mean(axis=0)
    lateral = x if limb == "left" else -x
    if lateral > -_ASIDE_MM or lateral > -_ASIDE * np.hypot(x, y):
        return []
    other = "right" if limb == "left" else "left"
    what = (
        f"the fibula lies {-lateral:.0f} mm medial of the tibia: that is a {other} leg, but the case states "
        f"{limb}"
    )
    fix = "correct [subject] limb, or the frame of the images or surfaces (LPS: +x is the patient's left)"
    return [_problem(what, where, fix)]


def _across(skin: Triangles, bones: Mapping[str, Triangles], where: str) -> list[Problem]:
    """Report a limb that lies across the patient frame, so that its proximal end cannot be determined."""
    axes = [principal_axis(each) for each in (skin, *bones.values())]
    axis, elongated = max(axes, key=lambda each: each[1])
    if elongated < _ELONGATED or abs(axis[2]) > _UPRIGHT:
        return []
    along = "xyz"[int(np.abs(axis).argmax())]
    what = (
        f"the limb lies along {along}; in the patient frame it lies along z, with the head at +z, so "
        'it is not known which end is proximal ("axial", "transverse" and images may be reversed)'
    )
    fix = "save the surfaces, or the label map, in patient LPS (x left, y posterior, z to the head), mm"
    return [_problem(what, where, fix)]


def _some(points: Array) -> Array:
    """At most about `_POINTS` of the points, evenly spaced by index."""
    return points[:: max(1, len(points) // _POINTS)]


def _problem(what: str, where: str, fix: str, *, error: bool = False) -> Problem:
    return Problem(what, where, fix, severity="error" if error else "warning")
