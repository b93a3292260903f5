"""The index of several subjects' reports, as a batch leaves them in one folder."""

from __future__ import annotations

import json
import os
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from limbcli.drawing import data_file, write_data
from limbcli.errors import CaseError
from limbcli.files.atomic import atomic_file
from limbcli.progress import SILENT, Progress
from limbcli.reporting.figures.style import INK, literal, new_figure, plain_log, style
from limbcli.reporting.fit_view import EstimateView, FitView, read_fit_view
from limbcli.reporting.numbers import DASH, cell
from limbcli.reporting.outcome import SITE_STAGES, Failure, failure_of
from limbcli.reporting.page import data_uri, render
from limbcli.reporting.reportlet import Cell, Mood, worst_mood
from limbcli.reporting.sections.parameters import interval_text, with_verdict
from limbcli.results import (
    ERROR_FILE,
    UNLIKE_OURS,
    StageResult,
    provenance,
    read_result,
    result_if_there,
    stage_folder,
)

INDEX_FILE = "index.html"


@dataclass(frozen=True)
class IndexResult:
    page: Path
    rows: tuple[IndexRow, ...]

    @property
    def n_subjects(self) -> int:
        return len({row.folder for row in self.rows})

    def to_json(self) -> dict[str, Any]:
        rows = [
            {"subject": row.subject, "site": row.site, "state": row.state, "report": row.link}
            for row in self.rows
        ]
        return {"page": str(self.page), "n_subjects": self.n_subjects, "rows": rows}


def report_index(folder: Path, *, templates: Path | None = None, progress: Progress = SILENT) -> IndexResult:
    """Write `<folder>/index.html`: one row per site of every subject with results below `folder`.

    Raises CaseError if the folder is absent or holds no subject's results.
    """
    if not folder.is_dir():
        raise CaseError(
            f"there is no folder {folder}", where="--index", fix="give the output folder of a batch"
        )
    outs = sorted(each for each in (folder, *folder.iterdir()) if _is_output(each))
    if not outs:
        raise CaseError(
            "the folder contains no subject's results",
            where=str(folder),
            fix=f"run `limbcli batch CASE... --out {folder}` first",
        )
    rows: list[IndexRow] = []
    for k, out in enumerate(outs, 1):
        rows += _rows(out, folder)
        progress.event("task", name="index", done=k, total=len(outs))
    own = provenance()
    facts = {
        "rows": rows, "headings": HEADINGS, "own": own, "n_subjects": len(outs),
        "study": _picture(rows, folder),
        "name": folder.resolve().name,
    }  # fmt: skip
    html = render("index.html.j2", facts, templates=templates)
    with atomic_file(folder / INDEX_FILE) as path:
        path.write_text(html, encoding="utf-8")
    return IndexResult(folder / INDEX_FILE, tuple(rows))


def _picture(rows: list[IndexRow], folder: Path) -> str:
    """Figure comparing the parameters, as a data URI; also writes its SVG and data. Empty without a fit."""
    known: list[tuple[str, dict[str, EstimateView]]] = []
    for row in rows:
        if row.view is not None and (step := row.view.last) is not None:
            each = {"c": step.estimate("c"), "m": step.estimate("m"), "κ′": step.kappa}
            own = f" ({row.folder})" if row.folder != row.subject else ""
            known.append((f"{row.subject}{own} {row.site}".strip(), {k: v for k, v in each.items() if v}))
    if not known:
        return ""
    svg = folder / "study.svg"
    with style(), atomic_file(svg) as path, atomic_file(data_file(svg)) as table:
        figure = study_figure(known)
        figure.savefig(path, format="svg", metadata={"Date": None, "Creator": "limbcli"})
        write_data(figure, table)
    return data_uri(svg)


_OF_CASE = ("segment", "report")


def _is_output(folder: Path) -> bool:
    """Whether a folder is a subject's output: it holds a stage's result or the first stage's error.

    Its name cannot tell, because a subject's folder may have the name of a stage.
    """
    if not folder.is_dir() or folder.name.startswith("."):
        return False
    own = [stage_folder(folder, stage) / f"{stage}.json" for stage in _OF_CASE]
    if any(each.is_file() for each in (*own, stage_folder(folder, _OF_CASE[0]) / ERROR_FILE)):
        return True
    return any(any(stage_folder(folder, stage).glob(f"*/{stage}.json")) for stage in SITE_STAGES)


def _rows(out: Path, folder: Path) -> list[IndexRow]:
    """The rows of one subject; unreadable results give a row with the error, for this subject only."""
    try:
        report = read_result(out, "report")
        link = quote(Path(os.path.relpath(report.path("page"), folder)).as_posix())
        sites = list(report.data.get("sites", {})) or [""]
        return [_row(out, report, site, link) for site in sites]
    except CaseError as error:
        return [_row_without_report(out, error)]
    except UNLIKE_OURS as error:
        what = f"its results cannot be read ({type(error).__name__}: {error})"
        fix = "run `limbcli batch` or `limbcli report` of this case again"
        return [_row_without_report(out, CaseError(what, where=str(out), fix=fix))]


def _row(out: Path, report: StageResult, site: str, link: str) -> IndexRow:
    failures = [each for each in report.data.get("failures", []) if each.get("site") in (site, None)]
    row = IndexRow(
        folder=out.resolve().name, subject=report.subject, site=site, mood="missing", state="not fitted yet",
        n_warnings=int(report.data.get("n_warnings", 0)), link=link,
        assumed=str(report.data.get("geometry_assumed") or ""),
    )  # fmt: skip
    if failures:
        state = f"{failures[0]['stage']} failed: {failures[0]['what'].splitlines()[0]}"
        shown, view = tuple(failure_of(each) for each in failures), _fitted_all_the_same(out, report, site)
        return replace(row, mood="failed", state=state, view=view, failures=shown)
    fitted = result_if_there(out, "fit", site=site)
    if fitted is None:
        return row
    if fitted.subject != report.subject:  # consistent with the report page
        return replace(row, state=f"the fit is of {fitted.subject}")
    view, shown_fit = read_fit_view(fitted), report.value(f"fitted_utc/{site}")
    is_shown = shown_fit in (None, fitted.provenance.get("finished_utc"))
    older = "" if is_shown else "again after its report was made: make the report again"
    mood = worst_mood(view.whole.mood, "warning" if row.n_warnings or older else "fine")
    return replace(row, mood=mood, state="fitted", view=view, older=older)


def _fitted_all_the_same(out: Path, report: StageResult, site: str) -> FitView | None:
    """The fit that the page shows although something else (such as a joint fit or a diagnosis) failed."""
    if report.value(f"stages/fit {site}") != "done":
        return None
    fitted = result_if_there(out, "fit", site=site)
    return read_fit_view(fitted) if fitted is not None and fitted.subject == report.subject else None


def _row_without_report(out: Path, error: CaseError) -> IndexRow:
    """The row of a subject without a readable report: failed if a stage recorded a failure or the report is
    damaged, else not finished yet."""
    name = out.resolve().name
    row = IndexRow(
        folder=name, subject=name, site="", mood="missing", state="not finished: it has no report yet",
        n_warnings=0, link="",
    )  # fmt: skip
    for path in sorted(out.glob("**/error.json")):
        try:
            content = json.loads(path.read_text())
            state = f"{path.parent.relative_to(out)} failed: {content['what'].splitlines()[0]}"
            return replace(row, mood="failed", state=state, failures=(failure_of(content),))
        except UNLIKE_OURS:
            continue
    if not (stage_folder(out, "report") / "report.json").is_file():
        return row
    shown = Failure("CaseError", error.what, error.where, error.fix)
    return replace(row, mood="failed", state=error.what, failures=(shown,))


@dataclass(frozen=True, kw_only=True)
class IndexRow:
    """One site of one subject; `link` is relative to the index page, "" if there is no report.

    assumed : which part of the geometry was not imaged, in words; "" if all was
    older : in words, that the report shows another fit than this one; "" if it shows this one
    """

    folder: str
    subject: str
    site: str
    mood: Mood
    state: str
    n_warnings: int
    link: str
    view: FitView | None = None
    failures: tuple[Failure, ...] = ()
    assumed: str = ""
    older: str = ""

    @property
    def word(self) -> str:
        """The state in one or two words."""
        if self.failures:
            return "failed"
        if self.view is None:
            return "failed" if self.mood == "failed" else "not fitted"
        return {"bad": "poor fit", "doubtful": "doubtful fit", "untested": "not tested"}.get(
            self.view.whole.state, "fitted"
        )

    @property
    def cells(self) -> tuple[Cell, ...]:
        """c, m with interval, κ′, R2 and misfit of the Ogden type; dashes give the state as their reason."""
        step = self.view.last if self.view else None
        if self.view is None or step is None:
            return (Cell(DASH, reason=self.state, span=6),)
        m = step.estimate("m")
        interval = Cell(DASH, reason=m.interval_why if m and m.interval_why else "not computed")
        if m is not None and (m.low is not None or m.high is not None):
            interval = Cell(interval_text(m))
        return (
            cell(step.c_kpa),
            with_verdict(cell(step.m), m),
            interval,
            with_verdict(cell(step.kappa_kpa), step.kappa),
            cell(step.r2, digits=4),
            cell(step.rmse_n, digits=2),
        )


HEADINGS = (
    "subject", "site", "state", "warnings", "c [kPa]", "m [–]", "m, 95 % interval [–]", "κ′ [kPa]",
    "R² [–]", "misfit (RMS) [N]",
)  # fmt: skip


_COLUMNS = (("c", "c [kPa]"), ("m", "m [–]"), ("κ′", "κ′ [kPa]"))
_OPEN = "#8a8a8a"
_NAME_WIDTH = 28  # characters per line of a label


def study_figure(rows: Sequence[tuple[str, Mapping[str, EstimateView]]]) -> Figure:
    """One row per site (its label, and its estimates by symbol), one panel per parameter: a dot with its
    interval if the data determine a value, else an arrow on the side that is not excluded."""
    with style():
        names = [textwrap.fill(label, _NAME_WIDTH) for label, _ in rows]
        lines = max((name.count("\n") + 1 for name in names), default=1)
        figure = new_figure(9.2, 1.5 + (0.2 + 0.14 * lines) * max(len(rows), 2))
        panels = figure.subplots(1, len(_COLUMNS), sharey=True)
        for axes, (name, label) in zip(panels, _COLUMNS, strict=True):
            for k, (site, estimates) in enumerate(rows):
                if name in estimates:
                    _draw(axes, k, estimates[name], literal(site))
            if any(_is_drawn(estimates.get(name)) for _, estimates in rows):
                axes.set_xscale("log")
                plain_log(axes.xaxis, few=True)
            else:
                axes.set_xticks([])
                axes.text(0.5, 0.5, "not known", ha="center", transform=axes.transAxes, color=_OPEN)
            axes.set(xlabel=label)
            axes.grid(True, axis="x", linewidth=0.4, alpha=0.5)
        panels[0].set_yticks(range(len(rows)), [literal(name) for name in names], fontsize=8.5)
        panels[0].set_ylim(len(rows) - 0.5, -0.5)
        marks = [
            Line2D([], [], color=INK, marker="o", markersize=5, lw=1.4, label="value, 95 % interval"),
            Line2D([], [], color=_OPEN, marker="|", markersize=7, lw=1.4, label="no value, within (95 %)"),
            Line2D([], [], color=_OPEN, marker=9, ms=8, lw=0, label="no value, beyond this end (95 %)"),
        ]
        figure.legend(handles=marks, loc="outside lower center", ncols=3, fontsize=8.5)
    return figure


def _is_drawn(each: EstimateView | None) -> bool:
    return each is not None and bool(each.low or each.high or (each.is_sound and each.value))


def _draw(axes: Axes, k: int, each: EstimateView, name: str) -> None:
    plot, within = axes.plot, f"{name}, 95 %"
    if each.is_sound and each.value:
        if each.low and each.high:
            plot([each.low, each.high], [k, k], color=INK, lw=1.4, label=within)
        plot([each.value], [k], "o", color=INK, markersize=5, label=name)
    elif each.low and each.high:
        plot([each.low, each.high], [k, k], "|-", color=_OPEN, lw=1.4, markersize=7, label=within)
    elif each.low:
        plot([each.low], [k], marker=9, color=_OPEN, markersize=8, label=f"{name}, above")
    elif each.high:
        plot([each.high], [k], marker=8, color=_OPEN, markersize=8, label=f"{name}, below")
