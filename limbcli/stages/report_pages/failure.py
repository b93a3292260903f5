"""The page of a subject whose case folder cannot be read."""

from __future__ import annotations

from pathlib import Path

from limbcli.errors import LimbError
from limbcli.errors.pasted_commands import pasted, typed
from limbcli.reporting.outcome import Failure, problems_of
from limbcli.reporting.page import render
from limbcli.results import StageResult, open_stage, provenance

PAGE_FILE = "report.html"


def report_failure(folder: Path, error: LimbError, *, out: Path) -> StageResult:
    """Write an `<out>/report/report.html` that shows why a case could not be opened.

    One subject's unusable folder does not stop a batch; that subject still gets a page and a row in
    the index.
    """
    shown = pasted(error, folder, out)
    failure = Failure(type(shown).__name__, shown.what, shown.where, shown.fix, problems_of(shown.facts))
    name = folder.resolve().name
    with open_stage(out, "report", subject=name) as writer:
        command = f"limbcli check {typed(folder)}"
        facts = {"subject": name, "own": provenance(), "failure": failure, "command": command}
        page = render("failure.html.j2", facts)
        writer.file("page", PAGE_FILE).write_text(page, encoding="utf-8")
        failures = [{"stage": "check", "site": None, **vars(failure)}]
        writer.data.update(mood="failed", failures=failures, n_warnings=0, sites={})
        writer.summary.append(f"the case cannot be used: {error.what}")
    return writer.result
