"""report: present the results of all stages on one page that can be read and printed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from limbcli.case import Case
from limbcli.config import templates_folder
from limbcli.progress import SILENT, Progress
from limbcli.provenance.chain_inputs import CaseInputs
from limbcli.provenance.requested_options import requested_of
from limbcli.reporting.page import embed, render, save_pictures
from limbcli.reporting.report_data import ReportData
from limbcli.reporting.reportlet import Reportlet
from limbcli.reporting.sections.groups import groups
from limbcli.reporting.sections.methods import FILE as METHODS_FILE
from limbcli.reporting.sections.methods import methods_text
from limbcli.reporting.sections.overview import Overview, overview
from limbcli.results import StageResult, StageWriter, open_stage, provenance
from limbcli.stages.report_pages.material import gather

PAGE_FILE = "report.html"


def report(
    case: Case, *, out: Path, templates: Path | None = None, progress: Progress = SILENT
) -> StageResult:
    """Write `<out>/report/report.html`, one self-contained page, and its figures as PNG and SVG.

    A stage that has not been run or that failed gets its own place on the page, with its error
    and the command that runs it; missing results never stop the report.
    templates : a folder whose `report/` takes precedence over limbcli's templates

    Raises as `limbcli.report`.
    """
    templates_folder(templates)  # before their content is hashed
    inputs = CaseInputs(case)
    page = gather(inputs.case, out=out, progress=progress)
    glance = overview(page)
    with open_stage(out, "report", subject=case.subject) as writer:
        writer.used("case.toml", case.file)
        inputs.into(writer)
        writer.data["asked"] = requested_of({"templates": templates})
        if templates is not None:
            writer.used("templates", templates, role=str(templates.resolve()))
        _write_page(page, glance, writer, templates, progress)
        writer.data.update(_data(page, glance))
        writer.summary.append(glance.sentence)
        writer.summary += [f"{site.name}: {site.sentence}" for site in glance.sites]
        diagnosed = [site for site in glance.sites if site.diagnosis]
        writer.summary += [f"{site.name}: diagnosis: {site.diagnosis}" for site in diagnosed]
        writer.summary.append(f"page: {writer.target / PAGE_FILE}")
        writer.warnings += [each.text for each in glance.warnings]
        not_drawn = [site for site in page.sites if site.deformed is None and site.why_not_deformed]
        writer.warnings += [f"site {site.name}: {site.why_not_deformed}" for site in not_drawn]
    return writer.result


def _write_page(
    page: ReportData, glance: Overview, writer: StageWriter, templates: Path | None, progress: Progress
) -> None:
    own = {**provenance(), "inputs_sha256": writer.inputs}
    chapters = groups(page, own, told={each.text for each in glance.warnings})
    places = tuple(site.picture for site in glance.sites if site.picture is not None)
    reportlets = [Reportlet("overview", "At a glance", pictures=places)]
    reportlets += [each for chapter in chapters for each in chapter.reportlets]
    progress.event("task", name="report: drawing", done=0, total=1)
    files = save_pictures(reportlets, writer.work / "figures")
    for name, path in files.items():
        writer.files[f"figure_{name}"] = f"figures/{path.name}"
    case, face = page.case, page.case.probe
    facts = {
        "subject": case.subject, "limb": case.limb, "sites": case.sites,
        "probe": f"{face.name}, {face.length:g} × {face.width:g} mm",
        "own": own, "overview": glance, "groups": chapters, "shown": embed(reportlets, files),
        "has_scene": any(each.scene for reportlet in reportlets for each in reportlet.pictures),
    }  # fmt: skip
    html = render("report.html.j2", facts, templates=templates)
    writer.file("page", PAGE_FILE).write_text(html, encoding="utf-8")
    writer.file("methods", METHODS_FILE).write_text(methods_text(page, own), encoding="utf-8")
    progress.event("task", name="report: drawing", done=1, total=1)


def _data(page: ReportData, glance: Overview) -> dict[str, Any]:
    """The content of the page as data, for other programs and for the index of several subjects."""
    return {
        "mood": glance.mood,
        "limb": page.case.limb,
        "geometry_assumed": page.case.imaging.assumed,
        "stages": {each.label: each.status for each in page.outcomes.all},
        "failures": [
            {"stage": each.stage, "site": each.site, **vars(each.failure)} for each in glance.failures
        ],
        "n_warnings": len(glance.warnings),
        "sites": {site.name: _lines(page, site.name) for site in page.sites},
        "fitted_utc": _fitted(page),
    }


def _fitted(page: ReportData) -> dict[str, Any]:
    """For each site, the fit that the page shows, with the time at which it ended."""
    fits = (each for each in page.outcomes.done if each.stage == "fit")
    return {str(each.site): each.result.provenance.get("finished_utc") for each in fits if each.result}


def _lines(page: ReportData, name: str) -> dict[str, Any]:
    """Slope, intercept and R2 of the speed lines of a site."""
    site = next(each for each in page.sites if each.name == name)
    found: dict[str, Any] = {}
    for line, what, unit in ((site.against_force, "force", "n"), (site.against_depth, "depth", "mm")):
        if line is not None:
            found[f"swe_against_{what}"] = {
                f"slope_m_per_s_per_{unit}": line.slope,
                f"slope_se_m_per_s_per_{unit}": line.slope_se,
                "intercept_m_per_s": line.intercept,
                "r2": line.r2,
                "n_levels": line.n,
            }
    return found
