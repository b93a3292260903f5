"""Outcome of each stage: a result, a failure, or nothing yet."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from limbcli.case.schema import FAILED
from limbcli.errors import CaseError
from limbcli.errors.pasted_commands import typed
from limbcli.results import ERROR_FILE, UNLIKE_OURS, StageResult, read_result, stage_folder

SUBJECT_STAGES = ("segment",)
SITE_STAGES = ("mesh", "build-feb", "run", "fit")
# Optional stages, which are part of the page only if they have been run.
EXTRA_SUBJECT_STAGES = ("fit-joint", "limb", "socket")
EXTRA_SITE_STAGES = ("fit-states", "fit-elements", "mesh-study", "diagnose")
_COMMANDS = {
    "fit-joint": "fit {case} --objective joint",
    "fit-states": "fit {case} --objective states",
    "fit-elements": "fit {case} --compare-element",
    "mesh-study": "mesh {case} --study",
}

Status = Literal["done", "failed", "missing"]


@dataclass(frozen=True)
class Failure:
    """Why a stage ended without a result: error family, what happened, where, and the fix.

    problems : the same for each problem, if there are several
    """

    error: str
    what: str
    where: str
    fix: str
    problems: tuple[Mapping[str, str], ...] = ()

    @property
    def headline(self) -> str:
        """What happened, in one line; for several problems only their number."""
        return self.what.splitlines()[0] if self.problems else self.what


def problems_of(facts: object) -> tuple[Mapping[str, str], ...]:
    """What, where and fix of each problem in an error's facts; empty if there is only one.

    >>> problems_of({"problems": [{"what": "a", "where": "b", "fix": "c", "family": "case"}] * 2})[1]
    {'what': 'a', 'where': 'b', 'fix': 'c'}
    """
    listed = facts.get("problems") if isinstance(facts, Mapping) else None
    several = [each for each in listed if isinstance(each, Mapping)] if isinstance(listed, list) else []
    names = ("what", "where", "fix")
    return (
        tuple({name: str(each.get(name, "")) for name in names} for each in several)
        if len(several) > 1
        else ()
    )


def failure_of(content: Mapping[str, Any]) -> Failure:
    """A failure from the record of its error, in which `problems` may lie among the facts."""
    error, what, where, fix = (str(content.get(name) or "–") for name in ("error", "what", "where", "fix"))
    return Failure(error, what, where, fix, problems_of(content) or problems_of(content.get("facts")))


@dataclass(frozen=True, eq=False)
class Outcome:
    """One stage of one site (or of the subject). A failed stage may still have an older result.

    held_by : label of the earlier stage whose failure prevented this one from being run
    """

    stage: str
    site: str | None
    status: Status
    command: str
    _: KW_ONLY
    result: StageResult | None = None
    failure: Failure | None = None
    held_by: str = ""

    @property
    def label(self) -> str:
        return f"{self.stage} {self.site}" if self.site else self.stage

    @property
    def usable(self) -> StageResult | None:
        """The result, unless a later run failed."""
        return None if self.status == "failed" else self.result


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Outcomes of all stages for one subject, in the order of the workflow."""

    all: tuple[Outcome, ...]

    def of(self, stage: str, site: str | None = None) -> Outcome:
        return next(each for each in self.all if (each.stage, each.site) == (stage, site))

    def maybe(self, stage: str, site: str | None = None) -> Outcome | None:
        """Outcome of an optional stage, or None if it was not run."""
        return next((each for each in self.all if (each.stage, each.site) == (stage, site)), None)

    def usable(self, stage: str, site: str | None = None) -> StageResult | None:
        """Result of a stage, unless it was not run or a later run failed."""
        found = self.maybe(stage, site)
        return None if found is None else found.usable

    @property
    def done(self) -> tuple[Outcome, ...]:
        return tuple(each for each in self.all if each.result is not None)

    @property
    def failed(self) -> tuple[Outcome, ...]:
        return tuple(each for each in self.all if each.status == "failed")

    def warnings(self) -> list[tuple[Outcome, str]]:
        """Each warning with its stage; one that later stages repeat is listed once."""
        seen: dict[str, Outcome] = {}
        for outcome in self.all:
            for text in outcome.result.warnings if outcome.result is not None else ():
                seen.setdefault(text, outcome)
        return [(outcome, text) for text, outcome in seen.items()]


def read_outcomes(
    out: Path, sites: tuple[str, ...], *, case_name: str = "CASE", subject: str = ""
) -> Outcomes:
    """Read the folders of all stages below `out`; never raises for missing or damaged content.

    subject : expected subject; results of another are shown as failures and not used
    """
    keys: list[tuple[str, str | None]] = [(stage, None) for stage in SUBJECT_STAGES]
    keys += [(stage, site) for site in sites for stage in SITE_STAGES]
    outcomes: list[Outcome] = []
    for stage, site in keys:
        outcome = _outcome(out, stage, site, case_name, subject)
        before = (each for each in outcomes if each.site in (None, site) and each.status == "failed")
        outcomes.append(_held(outcome, next(before, None)))
    extra: list[tuple[str, str | None]] = [(stage, None) for stage in EXTRA_SUBJECT_STAGES]
    extra += [(stage, site) for site in sites for stage in EXTRA_SITE_STAGES]
    found = [_outcome(out, stage, site, case_name, subject) for stage, site in extra]
    outcomes += [each for each in found if each.status != "missing"]
    return Outcomes(tuple(outcomes))


def _held(outcome: Outcome, before: Outcome | None) -> Outcome:
    """Mark a stage without a result as not run if an earlier stage failed."""
    if before is None or outcome.result is not None:
        return outcome
    return replace(outcome, status="missing", failure=None, held_by=before.label)


def command_of(stage: str, site: str | None, *, out: Path, case_name: str) -> str:
    """The command that runs a stage.

    >>> command_of("fit-states", "p1", out=Path("out"), case_name="S1")
    'limbcli fit S1 --objective states --site p1 --out out'
    """
    words = _COMMANDS.get(stage, f"{stage} {{case}}").format(case=typed(case_name))
    return f"limbcli {words}" + (f" --site {site}" if site else "") + f" --out {typed(out)}"


def _outcome(out: Path, stage: str, site: str | None, case_name: str, subject: str) -> Outcome:
    folder = stage_folder(out, stage, site)
    command = command_of(stage, site, out=out, case_name=case_name)
    failure = _failure(folder / ERROR_FILE) or _failed_run(folder, stage)
    result = None
    if (folder / f"{stage}.json").is_file():
        try:
            result = read_result(out, stage, site=site)
        except CaseError as error:
            failure = failure or Failure("CaseError", error.what, error.where, error.fix)
        if result is not None and subject and result.subject != subject:
            what = f"the result is of {result.subject}, but the case is of {subject}"
            failure, result = Failure("CaseError", what, str(folder), command), None
    status: Status = "failed" if failure else ("done" if result else "missing")
    return Outcome(stage, site, status, command, result=result, failure=failure)


def _failed_run(folder: Path, stage: str) -> Failure | None:
    """Failure of the last run, if it wrote a report of it beside the place of a result; or None."""
    path = folder.with_name(folder.name + FAILED) / f"{stage}.json"
    try:
        return failure_of(json.loads(path.read_text(encoding="utf-8"))["data"]["failure"])
    except (OSError, *UNLIKE_OURS):
        return None


def _failure(path: Path) -> Failure | None:
    """The failure recorded by a batch, or None. A record that cannot be read also counts as a failure."""
    if not path.is_file():
        return None
    try:
        return failure_of(json.loads(path.read_text(encoding="utf-8")))
    except UNLIKE_OURS:
        what = "the stage failed; its note cannot be read"
        return Failure("unknown", what, str(path), "run the stage again")
