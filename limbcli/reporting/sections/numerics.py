"""How good the mesh is, and how much it, the elements and the fibre direction affect the result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

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


@of_stage("mesh", "mesh", "Is the mesh fine enough where it matters, and sound everywhere?")
def mesh(result: StageResult, _: ReportData, site: SiteMaterial) -> Reportlet:
    """Picture and quality figures of the mesh stage."""
    alt = (
        f"The mesh at site {site.name}: the skin with the probe's contact area, and a section with the bones."
    )
    figures = figures_table(f"Figures of the mesh at site {site.name}", result.data)
    return Reportlet(
        mood="warning" if result.warnings else "fine",
        pictures=pictures_of(result, {"picture": (f"mesh-{site.name}", alt)}),
        more=(figures,) if figures.rows else (),
        look_for="small elements under the probe whose size grows smoothly outwards, bones as clean "
        "holes, and the probe flat on the skin",
        bad="slivers, sudden jumps in element size, a bone that touches the skin or meets the cut faces "
        "irregularly, or a probe that overhangs an edge of the model",
        notes=result.summary,
        warned=result.warnings,
    )


_USE = (
    "The direction is used by “anisotropy” and “contraction” of a diagnosis and by the law “fibres” of a "
    "joint fit; the Ogden-type law has no fibres."
)


@of_stage("mesh", "fibres", "Which way do the muscle fibres run?", silent=True)
def fibres(result: StageResult, _: ReportData, site: SiteMaterial) -> Reportlet | None:
    """The picture and sentences written by `mesh`; None if it was not run."""
    found = result.data.get("fibres")
    if not isinstance(found, Mapping):
        return None
    alt = f"Two cuts through site {site.name} with the direction of the muscle fibres as short lines."
    return Reportlet(
        pictures=pictures_of(result, {"fibre_picture": (f"fibres-{site.name}", alt)}),
        look_for="lines that run as the muscle does: along the limb, or at its pennation angle",
        bad="lines that point out of the skin or cross the limb (wrong frame, flipped "
        "sign), or an unmeasured direction where a result depends on it",
        notes=(*_words(found), _USE),
    )


def _words(found: Mapping[str, Any]) -> Sequence[str]:
    lines = [f"Fibres: {found.get('source')}."]
    deviation, out, beside = (
        found.get(name) for name in ("deviation_deg", "out_of_skin_deg", "to_image_plane_deg")
    )
    if isinstance(out, float) and isinstance(beside, float):
        lines.append(
            f"On average they run {beside:.0f}° from the probe's long side and {out:.0f}° out of the skin's "
            "plane."
        )
    if isinstance(deviation, float):
        lines.append(f"One standard deviation of that direction: {deviation:.1f}°.")
    if isinstance(found.get("agreement_of_neighbours"), float):
        lines.append(
            f"{100 * found['covered_share']:.0f} % of the tissue's elements lie within the map, "
            f"{100 * found['from_nearest_share']:.0f} % take the nearest direction, "
            f"{100 * found['from_mean_share']:.0f} % the mean near the probe; neighbouring voxels agree to "
            f"{found['agreement_of_neighbours']:.2f} (1: all along one axis)."
        )
    return lines
