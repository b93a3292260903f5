"""check, the geometry: consistency of skin, bones, label map and sites."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from limbcli.case import Case
from limbcli.errors import LimbError
from limbcli.errors.problems import Problem

if TYPE_CHECKING:
    from limbcli.meshing.surfaces import Triangles

_ROUGH = 15.0  # mm, largest distance of a place from the rough skin: the height of a marker and a voxel
_EDGE = 4.0  # mm, edge length of the surfaces made from a label map; coarse, for these checks only


def geometry_findings(case: Case, known: Sequence[Problem]) -> tuple[list[Problem], list[str]]:
    """Problems of the geometry (bones outside the skin, a label map off its series, sites off the skin), and
    lines on surfaces that were converted to patient LPS and mm, and on the bones at the sites.

    known : problems found so far; they are not repeated, and files that they report as unreadable are skipped
    """
    lines: list[str] = []
    try:
        if case.imaging.assumed:
            found = _assumed(case)
            lines, _ = _frames(case)
        elif case.imaging.skin is None and not case.imaging.label_maps:
            found = _images(case)
        else:
            read = _surfaces if case.imaging.skin is not None else _label_map
            surfaces, where, found, lines = read(case)
            stated, mixed = _frames(case)
            lines, found = [*lines, *stated], [*found, *mixed, *_of_limb(case, surfaces, where)]
            lines += _bone_lines(case, surfaces)
    except LimbError as error:
        found = [Problem(error.what, error.where, error.fix)]
    reported = {each.what for each in known}
    return [each for each in found if each.what not in reported], lines


def _frames(case: Case) -> tuple[list[str], list[Problem]]:
    if case.imaging.skin is None:
        return [], []
    from limbcli.stages.segmenting.surfaces import frames_of

    return frames_of(case)


def _of_limb(case: Case, surfaces: Mapping[str, Triangles], where: str) -> list[Problem]:
    from limbcli.meshing.anatomy import SKIN, limb_problems
    from limbcli.meshing.sites_on_skin import place_problems

    found = limb_problems(surfaces, limb=case.limb, where=where)
    return found + place_problems(surfaces[SKIN], _places(case), where=str(case.file))


def _bone_lines(case: Case, surfaces: Mapping[str, Triangles]) -> list[str]:
    """A line for each site whose height has neither two bones, as in a lower leg, nor the femur alone.

    A bone that is missing, or one too many, is not seen later on.
    """
    from limbcli.meshing.anatomy import SKIN
    from limbcli.meshing.mending import long_axis

    bones = {name: each for name, each in surfaces.items() if name != SKIN}
    axis = long_axis([surfaces[SKIN], *bones.values()])
    spans = {name: each.points @ axis for name, each in bones.items()}
    lines = []
    for site, place in _places(case).items():
        here = [name for name, along in spans.items() if along.min() <= place @ axis <= along.max()]
        if len(here) != 2 and here != ["bone_femur"]:
            count = f"{len(here)} bone{'' if len(here) == 1 else 's'}"
            names = f" ({', '.join(here)})" if here else ""
            lines.append(
                f"site {site}: {count} at its height{names}; if one is missing, or one too many, `diagnose` "
                "may take it for an effect"
            )
    return lines


_Geometry = tuple[dict[str, "Triangles"], str, list[Problem], list[str]]


def _surfaces(case: Case) -> _Geometry:
    from limbcli.stages.segmenting.surfaces import read_surfaces

    surfaces, _, left_out = read_surfaces(case)
    fix = "none needed, if these are scraps of the scan"
    found = [Problem(each, str(case.imaging.skin), fix, severity="warning") for each in left_out]
    return surfaces, str(case.imaging.skin), found, []


def _assumed(case: Case) -> list[Problem]:
    """Warn that the geometry was not imaged; problems where its numbers contradict the measurements."""
    from limbcli.errors.problems import errors_of
    from limbcli.stages.segmenting.assumed import FIX
    from limbcli.stages.segmenting.assumed_geometry import assumed_limb, assumed_problems

    found = [Problem(case.imaging.assumed, str(case.file), FIX, severity="warning"), *assumed_problems(case)]
    if errors_of(found):
        return found
    limb = assumed_limb(case)
    return found + _of_limb(case, limb.surfaces, str(case.imaging.skin or case.file))


def _images(case: Case) -> list[Problem]:
    """Sites that lie outside the images or far from any tissue visible in them."""
    if case.imaging.mri is None or not _places(case):
        return []
    from limbcli.imaging.image_files import read_image
    from limbcli.imaging.nearest_skin import RoughSkin, is_inside, reach_of
    from limbcli.meshing.sites_on_skin import TURNED, judged, problem_of, triple

    image = read_image(case.imaging.mri).volume
    skin = RoughSkin(image)
    found = []
    for name, place in _places(case).items():
        near, far = skin.nearest(place)
        turned = skin.nearest(TURNED * place)[1]
        fault = judged(place, near, far, turned, most=_ROUGH, about="about ")
        if fault is not None and not fault.usable:
            found.append(problem_of(name, fault, where=str(case.file)))
        elif not is_inside(image, place):
            low, high = (triple(each) for each in reach_of(image))
            what = f"site {name} is outside the images, which extend from {low} to {high} (LPS, mm)"
            fix = (
                f"write position_mm = {triple(near)}, approximately the nearest point of the skin, if "
                f"that is the intended site"
            )
            found.append(Problem(what, str(case.file), fix))
    return found


def _places(case: Case) -> dict[str, np.ndarray]:
    return {each.name: np.array(each.position) for each in case.sites if each.position is not None}


def _label_map(case: Case) -> _Geometry:
    from limbcli.imaging.bones import name_bones
    from limbcli.imaging.surface import surface_of
    from limbcli.meshing.anatomy import SKIN
    from limbcli.stages.segmenting.label_maps import labelled_limb

    path = str(case.imaging.label_maps[0].path)
    limb = labelled_limb(case, side=case.limb)
    parts = limb.found
    names = parts.bone_names or name_bones(parts.bones)
    bones = {f"bone_{name}": each for name, each in zip(names, parts.bones, strict=True)}
    masks = {SKIN: parts.skin, **bones}
    surfaces = {name: surface_of(each, edge=_EDGE, where=name) for name, each in masks.items()}
    return surfaces, path, list(limb.problems), list(limb.lines)
