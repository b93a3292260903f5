"""What a batch is asked for, and how one case went: what ran, what was fresh, what failed and why."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from limbcli.atomic_files import atomic_file
from limbcli.errors import LimbError
from limbcli.results import ERROR_FILE, plain, stage_folder

_KEPT = ("segment",)  # whose result tells whether the label map beside it was edited by hand since


@dataclass(frozen=True)
class BatchOptions:
    """What the stages are asked for: `element` None is the case's own; `force` redoes everything.

    defaults : stages forget what they were asked for by hand; else each is called as it was last called
    diagnose : every place is diagnosed, too, once its sites are fitted
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
        """With paths that hold in other processes, too; a FEBio that is no file here is a program's name."""
        named = febio.absolute() if febio is not None and febio.exists() else febio
        return cls(febio=named, templates=None if templates is None else templates.absolute(), **others)


@dataclass(frozen=True)
class StepFailure:
    stage: str
    site: str | None
    error: LimbError

    @property
    def place(self) -> str:
        """Stage and site: "segment", "mesh p1"."""
        return f"{self.stage} {self.site}" if self.site else self.stage


@dataclass
class CaseOutcome:
    """How one case went: what ran, what was fresh, what failed, and its report.

    kept : options that a stage was called with by hand and is called with again, in words
    begun : whether there was a case folder, and nobody else wrote into its output folder
    """

    case: Path
    out: Path
    ran: list[str] = field(default_factory=list)
    fresh: list[str] = field(default_factory=list)
    kept: dict[str, str] = field(default_factory=dict)
    failures: list[StepFailure] = field(default_factory=list)
    report: Path | None = None
    begun: bool = True

    def add(self, part: CaseOutcome) -> None:
        """What another part of the same case's work left."""
        self.ran += part.ran
        self.fresh += part.fresh
        self.kept |= part.kept
        self.failures += part.failures
        self.report = part.report or self.report

    def to_json(self) -> dict[str, Any]:
        return {
            "case": str(self.case),
            "out": str(self.out),
            "ran": self.ran,
            "fresh": self.fresh,
            "kept": self.kept,
            "failures": [
                {"stage": each.stage, "site": each.site, **error_json(each.error)} for each in self.failures
            ],
            "report": str(self.report) if self.report else None,
        }


def keep_error(
    out: Path, stage: str, site: str | None, error: LimbError, *, keep_result: bool = False
) -> None:
    """Leave a stage's failure where the report finds it; the stale result no longer counts.

    keep_result : it stays beside the failure, to tell another time how to make it again (as that of
        `segment` always does)
    """
    folder = stage_folder(out, stage, site)
    if error.facts.get("foreign") == str(folder):
        return  # a file of ours in a user's folder would make it ours
    try:
        with atomic_file(folder / ERROR_FILE) as path:
            path.write_text(json.dumps(error_json(error), indent=1), encoding="utf-8")
    finally:  # also where the disk is full
        if not keep_result and stage not in _KEPT:
            (folder / f"{stage}.json").unlink(missing_ok=True)


def error_json(error: LimbError) -> dict[str, Any]:
    return {
        "error": type(error).__name__,
        "exit_code": error.exit_code,
        "what": error.what,
        "where": error.where,
        "fix": error.fix,
        "facts": json.loads(json.dumps(plain(error.facts), default=str)),
    }
