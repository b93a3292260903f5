"""Possible places of sites: markers, a grid of skin points with coordinates, and the case's own sites."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from limbcli.case import Case
from limbcli.errors import MeshError
from limbcli.errors.problems import Problem
from limbcli.meshing.mending import mend
from limbcli.meshing.sites_on_skin import place_faults, problem_of, triple
from limbcli.meshing.surfaces import Triangles
from limbcli.results import StageResult, StageWriter
from limbcli.stages.segmenting.site_grid import draw_places, grid_points, write_grid

PICTURE, TABLE = "site-grid.png", "site-grid.csv"


def report_places(
    case: Case, surfaces: Mapping[str, Triangles], markers: Sequence[Mapping[str, Any]], writer: StageWriter
) -> None:
    """Report markers and a figure with a grid; problems of the case's sites are stored in `site_problems`.

    A site that does not lie on the skin does not stop the others; `mesh` rejects it.
    """
    for each in markers:
        place = np.array(each["position_mm"])
        writer.summary.append(f"marker {each['number']}: position_mm = {triple(place)} (its middle)")
    places = {each.name: np.array(each.position) for each in case.sites if each.position is not None}
    faults = place_faults(surfaces["skin"], places)
    problems = {name: problem_of(name, each, where=str(case.file)) for name, each in faults.items()}
    writer.data["site_problems"] = {
        name: {"what": each.what, "fix": each.fix, "severity": each.severity}
        for name, each in problems.items()
    }
    writer.warnings.extend(f"{each.what}; {each.fix}" for each in problems.values())
    bones = [each for name, each in surfaces.items() if name != "skin"]
    try:
        limb = mend(surfaces["skin"], bones, where="skin.ply")
    except MeshError as error:
        writer.warnings.append(f"no grid of places was drawn: {error.what}")
        return
    grid = grid_points(limb)
    write_grid(writer.file("site_grid_table", TABLE), grid)
    at_markers = {str(each["number"]): np.array(each["position_mm"]) for each in markers}
    draw_places(writer.file("site_grid", PICTURE), limb, grid, at_markers, places, title=case.subject)
    writer.summary.append(f"where a site can be: {PICTURE}, with the coordinates of its grid in {TABLE}")


def warnings_of_limb(segmented: StageResult) -> list[str]:
    """The warnings of a result of `segment` except those about places, which may have changed since."""
    stored = segmented.data.get("site_problems", {}).values()
    of_places = [f"{each['what']}; {each['fix']}" for each in stored]
    return [each for each in segmented.warnings if each not in of_places]


def site_errors(data: Mapping[str, Any], where: str) -> list[Problem]:
    """The errors that `report_places` stored in a result of `segment`."""
    found = data.get("site_problems", {}).values()
    return [Problem(each["what"], where, each["fix"]) for each in found if each["severity"] == "error"]
