"""check, the instruments' own files: problems at which `limbcli measure` would stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from limbcli.case import Case, Site
from limbcli.errors import LimbError
from limbcli.errors.problems import Problem

if TYPE_CHECKING:
    from limbcli.measurement.holds import Hold


def instrument_problems(case: Case) -> list[Problem]:
    """Records and images that cannot be read, or whose numbers of levels differ.

    If levels.csv exists already they are not needed, and the problems are only warnings.
    """
    return [problem for site in case.sites for problem in _of_site(site, str(case.file))]


def _of_site(site: Site, file: str) -> list[Problem]:
    severity: Any = "warning" if site.levels.is_file() else "error"
    counts: dict[str, int] = {}
    found = []
    for kind, table in site.instruments.items():
        if severity == "warning" and table["path"] == site.trace:
            continue  # a trace that accompanies levels.csv is checked as a trace
        try:
            levels = _levels(kind, table)
            counts[kind] = len(levels)
            if kind == "load_cell":
                found += _of_holds(levels, table, site.name, severity)
        except LimbError as error:
            found.append(Problem(error.what, error.where, error.fix, severity, "measurement"))
    if len(set(counts.values())) > 1:
        listed = ", ".join(f"{kind} {n}" for kind, n in counts.items())
        fix = "give one image per hold; change hold_s or hold_tolerance_n; remove surplus images"
        what = f"the instruments of site {site.name} have different numbers of levels: {listed}"
        found.append(Problem(what, file, fix, severity, "measurement"))
    return found


def _of_holds(holds: Sequence[Hold], table: Any, site: str, severity: Any) -> list[Problem]:
    """Impossible values among a record's holds."""
    from limbcli.stages.measuring.holds import column_problems, columns_of

    columns = columns_of(holds, float(table["step_n"]))
    problems = column_problems(columns, site=site, place=table["path"])
    return [replace(each, severity=severity) for each in problems]


def _levels(kind: str, table: Any) -> Sequence[Any]:
    """The holds of a record, or the images of a folder. Raises as `limbcli measure`."""
    from limbcli.stages.measuring.holds import holds_of
    from limbcli.stages.measuring.images import box_of, images_of

    if kind == "load_cell":
        return holds_of(table)[1]
    box = table["box_pixels" if kind == "b_mode" else "image_pixels"]
    return images_of(table, box_pixels=box_of(box) if box else None)
