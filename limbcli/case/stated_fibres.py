"""Muscle fibres in case.toml: a direction, or pennation angles in the planes of ultrasound images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from limbcli.case import schema as schema
from limbcli.case.parts import Fibres, Imaging, Pennation, Site, point
from limbcli.case.reading import CaseReading
from limbcli.errors.problems import suggestion

_NAMED = ("axial", "transverse")


def read_fibres(values: Mapping[str, Any], label: str, reading: CaseReading) -> Fibres:
    """Read a site's fibre input; values : of its table, with defaults filled in."""
    direction, tables = values["fibre_direction"], values["pennation"]
    found: list[Pennation] = []
    for k, table in enumerate(tables or [], 1):
        own = reading.part()
        each = own.table(table, schema.PENNATION, f"{label} pennation {k}")
        if not own.problems:
            found.append(
                Pennation(each["orientation"], float(each["pennation_deg"]), float(each["deviation_deg"]))
            )
    names = [each.orientation for each in found]
    for name in sorted({each for each in names if names.count(each) > 1}):
        what = f"{label} gives the pennation in the image plane of {name!r} twice"
        fix = "keep one [[site.pennation]] per orientation (their mean, where both were measured)"
        reading.wrong(what, fix)
    if len(set(names)) > 2:
        what = f"{label} gives the pennation in {len(set(names))} image planes"
        reading.wrong(what, "two planes determine a direction; keep the two best")
    if direction is not None and tables:
        what = f"{label} has both fibre_direction and [[site.pennation]]"
        reading.wrong(what, "keep the one that was measured")
    return Fibres(None, tuple(found)) if direction is None else Fibres(point(direction))


def check_fibres(sites: Sequence[Site], imaging: Imaging, reading: CaseReading) -> None:
    """Check the fibre input across sites and tables.

    Unknown orientations or those of a site elsewhere, a single image across the limb, coinciding planes, and
    a `fibre_frame` without `fibres`.
    """
    for site in sites:
        for each in site.fibres.pennation:
            if each.orientation in _NAMED:
                continue
            named = next((one for one in sites if one.name == each.orientation), None)
            where = f"site {site.name}: the orientation {each.orientation!r}"
            if named is None:
                known = [*_NAMED, *(one.name for one in sites)]
                fix = f"use axial, transverse or a site's name ({suggestion(each.orientation, known)})"
                reading.wrong(f"{where} is not known", fix)
            elif (named.position, named.marker) != (site.position, site.marker):
                fix = "name a site at the same place (position_mm or marker), axial or transverse"
                reading.wrong(f"{where} is that of another place", fix)
        if [_plane(each.orientation, sites) for each in site.fibres.pennation] == ["transverse"]:
            what = (
                f"site {site.name}: the pennation is given only in an image across the limb, which the "
                f"fibres cross"
            )
            fix = 'add one with orientation = "axial", or give fibre_direction'
            reading.wrong(what, fix)
        planes = {_plane(each.orientation, sites) for each in site.fibres.pennation}
        if len(planes) < len(site.fibres.pennation):
            what = f"site {site.name}: the two pennation angles are in the same image plane, given twice"
            reading.wrong(what, "keep one of them, or give the plane perpendicular to it")
    if imaging.fibres is None and imaging.fibre_frame is not None:
        fix = 'add `fibres = "v1.nii.gz"`, or remove fibre_frame'
        reading.wrong("[imaging] has fibre_frame but no `fibres` it refers to", fix)


def _plane(orientation: str, sites: Sequence[Site]) -> object:
    """Key by which coinciding planes are recognised: the long axis."""
    named = next((one for one in sites if one.name == orientation), None)
    return orientation if orientation in _NAMED or named is None else named.long_axis
