"""One page for several subjects: key figures and links to their reports."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from limbcli.reporting.fit_view import FitView
from limbcli.reporting.numbers import DASH, cell
from limbcli.reporting.reportlet import Cell, Mood
from limbcli.reporting.sections.parameters import flagged, interval_words


@dataclass(frozen=True)
class IndexRow:
    """One site of one subject; `link` is relative to the index page, empty where there is no report."""

    folder: str
    subject: str
    site: str
    mood: Mood
    state: str
    n_warnings: int
    link: str
    view: FitView | None = None

    @property
    def cells(self) -> tuple[Cell, ...]:
        """c, m with interval, κ′, R2 and misfit of the Ogden type; dashes carry the state as their reason."""
        step = self.view.last if self.view else None
        if self.view is None or step is None:
            return (Cell(DASH, reason=self.state, span=6),)
        m, f_kappa = step.estimate("m"), step.estimate("f_κ")
        interval = Cell(DASH, reason="not computed")
        if m is not None and (m.low is not None or m.high is not None):
            interval = Cell(interval_words(m))
        return (
            cell(step.c_kpa),
            flagged(cell(step.m), m),
            interval,
            flagged(cell(step.kappa_kpa), f_kappa),
            cell(step.r2, digits=4),
            cell(step.rmse_n, digits=2),
        )


HEADINGS = (
    "subject", "site", "state", "warnings", "c [kPa]", "m [–]", "m, 95 % interval [–]", "κ′ [kPa]",
    "R² [–]", "misfit (RMS) [N]",
)  # fmt: skip


def relative(page: Path, folder: Path) -> str:
    """The address of a page as seen from a folder, with forward slashes."""
    return Path(os.path.relpath(page, folder)).as_posix()
