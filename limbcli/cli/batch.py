"""`limbcli batch CASE [CASE ...]`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from limbcli.cli.error_output import report_error
from limbcli.cli.say import say
from limbcli.cli.terminal import emit_json
from limbcli.errors import LimbError
from limbcli.progress import Progress

if TYPE_CHECKING:
    from limbcli.stages.batching.outcome import BatchOptions, CaseOutcome, StepFailure


def batch_cases(
    cases: list[Path],
    *,
    out: Path | None,
    expect: bool,
    jobs: int | None,
    scheduler: str | None,
    wait: bool,
    json: bool,
    progress: Progress,
    **others: Any,
) -> None:
    """Run all stages of one or more cases, from images to report; only what changed is redone.

    A stage last called by hand with options is called with them again, with a note.
    With one CASE, --out is its output folder; with several, the folder that holds
    one output folder per case, and an index page. The last line printed is the report
    (of several cases, the index). A case that fails does not stop the others: the failed ones
    are listed at the end, with place and reason.
    """
    from limbcli.config import default_out
    from limbcli.stages.batch_cases import n_processes, output_folders
    from limbcli.stages.batching.outcome import BatchOptions

    options = BatchOptions.of(**others)
    pairs = output_folders(cases, out)
    way = _Way(options, progress, wait=wait, expect=expect, as_json=json)
    n_jobs = n_processes(jobs, scheduler, len(pairs))
    if scheduler is None and n_jobs == 1:
        entries = [way.alone(case, target) for case, target in pairs]
    else:
        entries = way.together(pairs, scheduler=scheduler, jobs=n_jobs)
    if json:
        emit_json([each.content for each in entries])
    if len(pairs) > 1:
        _index(out or default_out(cases[0]).parent, options.templates, progress, as_json=json)
    failed = [each for each in entries if each.code]
    if failed:
        say(f"{len(failed)} of {len(entries)} cases failed:", to_stderr=True)
        for each in failed:
            say("\n".join(f"  {line}" for line in each.lines()), to_stderr=True)
        raise typer.Exit(max(each.code for each in failed))


def _index(folder: Path, templates: Path | None, progress: Progress, *, as_json: bool) -> None:
    """Write the page that lists all cases; if none has results to list, a note says so and it is not a
    further failure."""
    from limbcli.stages.report_pages.index import report_index

    try:
        index = report_index(folder, templates=templates, progress=progress)
    except LimbError as error:
        report_error(error, as_json=False)
        return
    if not as_json:
        say(index.page)


@dataclass(frozen=True)
class _Entry:
    """Outcome of one case for the final summary: content of --json, and failures."""

    content: dict[str, Any]
    failures: list[StepFailure]

    @property
    def code(self) -> int:
        """Exit code of the case."""
        return max((each.error.exit_code for each in self.failures), default=0)

    def lines(self) -> list[str]:
        return [str(self.content["case"]), *(line for each in self.failures for line in _lines(each))]


def _lines(failure: StepFailure) -> list[str]:
    """Lines that describe a failure: stage and site, and its error."""
    error = failure.error
    what = f"{failure.place}: {error.what}" if failure.place else error.what
    return [f"  {what}", f"    where: {error.where}", f"    fix:   {error.fix}"]


class _Way:
    """How cases are run, and what is reported for each."""

    def __init__(self, options: BatchOptions, progress: Progress, *, wait: bool, expect: bool, as_json: bool):
        self.options, self.progress = options, progress
        self.wait, self.expect, self.as_json = wait, expect, as_json

    def alone(self, case: Path, target: Path) -> _Entry:
        """Run one case in this process; its errors are printed, not raised."""
        from limbcli.stages.batch_cases import one_case

        outcome = one_case(case, target, self.options, wait=self.wait, progress=self.progress)
        for failure in outcome.failures:
            report_error(failure.error, as_json=False)
        return self._entry(case, target, outcome)

    def together(self, pairs: list[tuple[Path, Path]], *, scheduler: str | None, jobs: int) -> list[_Entry]:
        """Run all cases on a cluster, or in `jobs` local processes."""
        from limbcli.stages.batch_cluster import together

        absolute = [(case.absolute(), target.absolute()) for case, target in pairs]
        outcomes = together(
            absolute, self.options, scheduler=scheduler, jobs=jobs, wait=self.wait, progress=self.progress
        )
        return [self._entry(*pair, outcome) for pair, outcome in zip(pairs, outcomes, strict=True)]

    def _entry(self, case: Path, target: Path, outcome: CaseOutcome) -> _Entry:
        from limbcli.stages.batch_cases import expectations

        content = outcome.to_json() | {"case": str(case), "out": str(target)}
        failures = list(outcome.failures)
        if not outcome.begun:
            content = {"case": str(case), "out": str(target), "error": failures[0].error.what}
        elif self.expect:
            found, unlike = expectations(case, target, progress=self.progress)
            content["expected"] = [{**vars(each), "expected": each.expected} for each in found]
            failures += unlike
            if not self.as_json:
                say("".join(f"{each}\n" for each in found), end="")
        if not self.as_json and outcome.report:
            say(outcome.report)
        return _Entry(content, failures)
