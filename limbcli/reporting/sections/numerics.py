"""How much the mesh affects the result: comparison of elements, and the mesh study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from limbcli.reporting.numbers import DASH, cell, figures_table
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import (
    Cell,
    Reportlet,
    pictures_of,
    placeholder,
    table,
)

ELEMENTS_TITLE = "How much of f_κ is due to the element type?"
STUDY_TITLE = "How much of the force is due to mesh and crop?"
_LARGE = 0.1  # relative numerical error of the force that counts as large


def elements(page: ReportData, site: SiteMaterial) -> Reportlet | None:
    """Linear and quadratic tetrahedra on the same mesh; None if they were not compared."""
    key = f"fit-elements-{site.name}"
    outcome = page.outcomes.maybe("fit-elements", site.name)
    if outcome is None:
        return None
    result = outcome.usable
    if result is None:
        return placeholder(key, ELEMENTS_TITLE, outcome)
    found = result.data.get("elements", {})
    rows = (_element_row(name, each) for name, each in found.items())
    names = ("element", "unknowns", "f_κ [–]", "m [–]", "f_κ at m = 2 [–]", "R² [–]", "RMSE [N]")
    alt = (
        f"Site {site.name}: forces of tet4 and tet10 on the same mesh at the same parameters and after "
        "each fit, and how the last force grows with f_κ."
    )
    return Reportlet(
        key,
        ELEMENTS_TITLE,
        site=site.name,
        pictures=pictures_of(result, {"picture": (f"elements-{site.name}", alt)}),
        tables=(table(f"The same mesh in two elements at site {site.name}", names, rows),),
        look_for="dotted curves that coincide and right-hand curves that are flat: then the "
        "element type does not matter",
        bad="a tet4 curve that rises with f_κ where tet10's is flat. The element locks, and the f_κ fitted "
        "with it reflects the stiffness of the mesh, not the compressibility of the tissue",
        notes=result.summary,
        warned=result.warnings,
    )


def _element_row(name: str, row: Mapping[str, Any]) -> tuple[Cell, ...]:
    return (
        Cell(name, lead=True),
        Cell(str(row.get("n_unknowns", DASH))),
        cell(row.get("f_kappa")),
        cell(row.get("m")),
        cell(row.get("f_kappa_mooney_rivlin")),
        cell(row.get("r2"), digits=4),
        cell(row.get("rmse_n")),
    )


def mesh_study(page: ReportData, site: SiteMaterial) -> Reportlet | None:
    """Force over element size and margin; None if the study was not run."""
    key = f"mesh-study-{site.name}"
    outcome = page.outcomes.maybe("mesh-study", site.name)
    if outcome is None:
        return None
    result = outcome.usable
    if result is None:
        return placeholder(key, STUDY_TITLE, outcome)
    error = result.data.get("numerical_error_fraction")
    alt = f"Site {site.name}: force at full depth over element size and over the margin of the model."
    return Reportlet(
        key,
        STUDY_TITLE,
        "warning" if result.warnings or not isinstance(error, float) or error > _LARGE else "fine",
        site.name,
        pictures=pictures_of(result, {"picture": (f"mesh-study-{site.name}", alt)}),
        more=(figures_table(f"Mesh study at site {site.name}", result.data),),
        look_for="curves that level off towards small elements and wide margins, and a numerical error well "
        "below the noise of the measurement",
        bad="a force that still moves at the mesh in use: that share of it is numerical error, and no "
        "parameter "
        "fitted with this mesh is more accurate than that",
        notes=result.summary,
        warned=result.warnings,
    )
