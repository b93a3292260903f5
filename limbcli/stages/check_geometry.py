"""check, the geometry: what skin, bones, label map and sites say of each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from limbcli.case import Case
from limbcli.errors import LimbError
from limbcli.problems import Problem

_EDGE = 4.0  # mm: triangles of a label map's surfaces, coarse, only to be looked at


def geometry_problems(case: Case, known: Sequence[Problem]) -> list[Problem]:
    """Bones outside the skin, a label map elsewhere than its series, sites off the skin.

    known : problems found so far; what is among them already is not said again, and a file that cannot be
        read is left to them
    """
    try:
        found = _surfaces(case) if case.imaging.skin is not None else _label_map(case)
    except LimbError as error:
        found = [Problem(error.what, error.where, error.fix)]
    said = {each.what for each in known}
    return [each for each in found if each.what not in said]


def _surfaces(case: Case) -> list[Problem]:
    from limbcli.meshing.anatomy import SKIN, limb_problems, place_problems
    from limbcli.stages.segment_surfaces import read_surfaces, triangles_of

    surfaces = triangles_of(read_surfaces(case)[0])
    found = limb_problems(surfaces, limb=case.limb, where=str(case.imaging.skin))
    places = {each.name: np.array(each.position) for each in case.sites if each.position is not None}
    return found + place_problems(surfaces[SKIN], places, where=str(case.file))


def _label_map(case: Case) -> list[Problem]:
    if case.imaging.labels is None:
        return []
    from limbcli.imaging.dicom import read_series
    from limbcli.imaging.label_files import read_label_file
    from limbcli.imaging.label_frame import compare_frames
    from limbcli.imaging.labels import segmentation_from
    from limbcli.imaging.surface import surface_of
    from limbcli.meshing.anatomy import SKIN, limb_problems, place_problems
    from limbcli.stages.segment_surfaces import triangles_of

    path = str(case.imaging.labels)
    labels = read_label_file(case.imaging.labels)
    found: list[Problem] = []
    if case.imaging.mri is not None:
        found += compare_frames(labels, read_series(case.imaging.mri).volume, where=path).problems
    parts = segmentation_from(labels)
    bones = {f"bone {number}": each for number, each in enumerate(parts.bones, 1)}
    surfaces = triangles_of(
        {name: surface_of(each, edge=_EDGE) for name, each in {SKIN: parts.skin, **bones}.items()}
    )
    found += limb_problems(surfaces, limb=case.limb, where=path)
    places = {each.name: np.array(each.position) for each in case.sites if each.position is not None}
    return found + place_problems(surfaces[SKIN], places, where=str(case.file))
