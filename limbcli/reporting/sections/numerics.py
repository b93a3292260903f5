"""How much the mesh affects the result: comparison of elements, and the mesh study."""

from __future__ import annotations

from limbcli.reporting.numbers import DASH, cell, figures_table
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Cell, Reportlet, pictures_of, table
from limbcli.reporting.sections.of_stage import of_stage
from limbcli.results import StageResult

_LARGE = 0.1  # relative numerical error of the force that counts as large


@of_stage("fit-elements", "fit-elements", "How much of f_κ is due to the element type?")
def elements(result: StageResult, _: ReportData, site: SiteMaterial) -> Reportlet:
    """Linear and quadratic tetrahedra on the same mesh."""
    found = result.data.get("elements", {})
    rows = (
        (
            Cell(name, lead=True), Cell(str(row.get("n_unknowns", DASH))), cell(row.get("f_kappa")),
            cell(row.get("m")), cell(row.get("f_kappa_mooney_rivlin")), cell(row.get("r2"), digits=4),
            cell(row.get("rmse_n")),
        )
        for name, row in found.items()
    )  # fmt: skip
    names = ("element", "unknowns", "f_κ [–]", "m [–]", "f_κ at m = 2 [–]", "R² [–]", "RMSE [N]")
    alt = (
        f"Site {site.name}: forces of tet4 and tet10 on the same mesh at the same parameters and after "
        "each fit, and how the last force grows with f_κ."
    )
    return Reportlet(
        pictures=pictures_of(result, {"picture": (f"elements-{site.name}", alt)}),
        tables=(table(f"The same mesh in two elements at site {site.name}", names, rows),),
        look_for="dotted curves that coincide and right-hand curves that are flat: then the "
        "element type does not matter",
        bad="a tet4 curve that rises with f_κ where tet10's is flat. The element locks, and the f_κ fitted "
        "with it reflects the stiffness of the mesh, not the compressibility of the tissue",
        notes=result.summary,
        warned=result.warnings,
    )


@of_stage("mesh-study", "mesh-study", "How much of the force is due to mesh and crop?")
def mesh_study(result: StageResult, _: ReportData, site: SiteMaterial) -> Reportlet:
    """Force over element size and margin."""
    error = result.data.get("numerical_error_fraction")
    alt = f"Site {site.name}: force at full depth over element size and over the margin of the model."
    return Reportlet(
        mood="warning" if result.warnings or not isinstance(error, float) or error > _LARGE else "fine",
        pictures=pictures_of(result, {"picture": (f"mesh-study-{site.name}", alt)}),
        more=(figures_table(f"Mesh study at site {site.name}", result.data),),
        look_for="curves that level off towards small elements and wide margins, and a numerical error well "
        "below the noise of the measurement",
        bad="a force that still moves at the mesh in use: that share of it is numerical error, and no "
        "parameter fitted with this mesh is more accurate than that",
        notes=result.summary,
        warned=result.warnings,
    )
