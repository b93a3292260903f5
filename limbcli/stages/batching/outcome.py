"""Options of a batch, and the outcome of one case: stages run, up to date, or failed (and why)."""

from __future__ import annotations

import json
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any

from limbcli.errors import LimbcliError, LimbError
from limbcli.errors.pasted_commands import pasted, typed
from limbcli.files.atomic import atomic_file
from limbcli.results import ERROR_FILE, StageResult, error_json, open_stage, plain, provenance, stage_folder

_KEPT = ("segment",)  # result is kept on failure, as it shows whether the label map has been edited since


@dataclass(frozen=True)
class BatchOptions:
    """Options of a batch. element : None for the case's own; force : repeat everything.

    defaults : discard options of manual calls; otherwise each stage is called as it was last called by hand
    diagnose : also diagnose every place once its sites are fitted
    """

    element: str | None = None
    solver: str = "auto"
    febio: Path | None = None
    templates: Path | None = None
    force: bool = False
    defaults: bool = False
    diagnose: bool = False

    @classmethod
    def of(cls, *, febio: Path | None, templates: Path | None, **others: Any) -> BatchOptions:
        """Options with absolute paths, for other processes; a `febio` that is no file is a command name."""
        named = febio.absolute() if febio is not None and febio.exists() else febio
        return cls(febio=named, templates=None if templates is None else templates.absolute(), **others)


@dataclass(frozen=True)
class FailedStage:
    """A failed stage of a case, and the reason.

    Attributes
    ----------
    stage : name such as "fit"; "" where the case could not be started or an expectation is not met
    site : None for a stage of the whole subject
    error : with message, where and fix
    """

    stage: str
    site: str | None
    error: LimbcliError

    @property
    def place(self) -> str:
        """Stage and site: "segment", "mesh p1"."""
        return f"{self.stage} {self.site}" if self.site else self.stage


@dataclass
class CaseOutcome:
    """Outcome of one case: stages run, stages up to date, failures, and its report.

    kept : by stage, options of a manual call that are used again, in words
    begun : False if the case folder did not exist or another process was writing to the output folder
    """

    case: Path
    out: Path
    _: KW_ONLY
    ran: list[str] = field(default_factory=list)
    fresh: list[str] = field(default_factory=list)
    kept: dict[str, str] = field(default_factory=dict)
    failures: list[FailedStage] = field(default_factory=list)
    report: Path | None = None
    begun: bool = True

    def add(self, part: CaseOutcome) -> None:
        """Add the outcome of another part of the same case."""
        self.ran += part.ran
        self.fresh += part.fresh
        self.kept |= part.kept
        self.failures += part.failures
        self.report = part.report or self.report

    def to_json(self) -> dict[str, Any]:
        failed = [
            {"stage": each.stage, "site": each.site, **error_json(each.error)} for each in self.failures
        ]
        return {k: plain(v) for k, v in vars(self).items() if k != "begun"} | {"failures": failed}


def keep_error(
    out: Path, stage: str, site: str | None, error: LimbcliError, *, keep_result: bool = False
) -> None:
    """Write a stage's failure where the report finds it, and remove the stale result.

    keep_result : keep the stale result, which records how to make it again (always so for `segment`)
    """
    folder = stage_folder(out, stage, site)
    if error.facts.get("foreign") == str(folder):
        return  # never write to a folder that belongs to the user
    try:
        with atomic_file(folder / ERROR_FILE) as path:
            path.write_text(json.dumps(error_json(error), indent=1), encoding="utf-8")
    finally:  # even if the disk is full
        if not keep_result and stage not in _KEPT:
            (folder / f"{stage}.json").unlink(missing_ok=True)


def report_failure(folder: Path, error: LimbError, *, out: Path) -> StageResult:
    """Write an `<out>/report/report.html` that shows why a case could not be opened.

    One subject's unusable folder does not stop a batch; that subject still gets a page and a row in
    the index.
    """
    from limbcli.reporting.outcome import Failure, problems_of
    from limbcli.reporting.page import render

    shown = pasted(error, folder, out)
    failure = Failure(type(shown).__name__, shown.what, shown.where, shown.fix, problems_of(shown.facts))
    name = folder.resolve().name
    with open_stage(out, "report", subject=name) as writer:
        command = f"limbcli check {typed(folder)}"
        facts = {"subject": name, "own": provenance(), "failure": failure, "command": command}
        page = render("failure.html.j2", facts)
        writer.file("page", "report.html").write_text(page, encoding="utf-8")
        failures = [{"stage": "check", "site": None, **vars(failure)}]
        writer.data.update(mood="failed", failures=failures, n_warnings=0, sites={})
        writer.summary.append(f"the case cannot be used: {error.what}")
    return writer.result
