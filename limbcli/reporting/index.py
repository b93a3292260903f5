"""Index page of several subjects: key figures and links to their reports."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from limbcli.reporting.figures.study import StudyRow
from limbcli.reporting.fit_view import FitView
from limbcli.reporting.numbers import DASH, cell
from limbcli.reporting.outcome import Failure
from limbcli.reporting.reportlet import Cell, Mood
from limbcli.reporting.sections.parameters import interval_text, with_verdict


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


def study_rows(rows: Sequence[IndexRow]) -> list[StudyRow]:
    """Estimates of c, m and kappa' for all fitted sites."""
    found = []
    for row in rows:
        step = row.view.last if row.view else None
        if step is None:
            continue
        c = next((each for each in step.estimates if each.name == "c"), None)
        known = {"c": c, "m": step.estimate("m"), "κ′": step.kappa}
        own = f" ({row.folder})" if row.folder != row.subject else ""
        label = f"{row.subject}{own} {row.site}".strip()
        found.append(StudyRow(label, {name: each for name, each in known.items() if each is not None}))
    return found


HEADINGS = (
    "subject", "site", "state", "warnings", "c [kPa]", "m [–]", "m, 95 % interval [–]", "κ′ [kPa]",
    "R² [–]", "misfit (RMS) [N]",
)  # fmt: skip


def relative(page: Path, folder: Path) -> str:
    """Address of a page relative to a folder, with forward slashes."""
    return Path(os.path.relpath(page, folder)).as_posix()
