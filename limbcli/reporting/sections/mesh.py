"""Is the mesh good enough for the computation?"""

from __future__ import annotations

from limbcli.reporting.numbers import figures_table
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Reportlet, pictures_of
from limbcli.reporting.sections.of_stage import of_stage
from limbcli.results import StageResult


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
