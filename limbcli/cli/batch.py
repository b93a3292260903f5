"""`limbcli batch CASE [CASE ...]`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from limbcli.cli.output import report_error, say
from limbcli.cli.terminal import emit_json
from limbcli.errors import LimbError
from limbcli.progress import Progress

if TYPE_CHECKING:
    from limbcli.stages.batching.outcome import CaseOutcome, FailedStage


def batch_cases(
    cases: list[Path], *, out: Path | None, expect: bool, jobs: int | None, scheduler: str | None, wait: bool,
    json: bool, progress: Progress, **others: Any,
) -> None:  # fmt: skip
    """Run all stages of one or more cases, from images to report; only what changed is redone.

    A stage last called by hand with options is called with them again, with a note.
    With one CASE, --out is its output folder; with several, the folder that holds
    one output folder per case, and an index page. The last line printed is the report
    (of several cases, the index). A case that fails does not stop the others: the failed ones
    are listed at the end, with place and reason.
    """
    from limbcli.config import default_out
    from limbcli.stages.batch_cases import n_processes, outcomes, output_folders
    from limbcli.stages.batching.outcome import BatchOptions

    options = BatchOptions.of(**others)
    pairs = output_folders(cases, out)
    n_jobs = n_processes(jobs, scheduler, len(pairs))
    run = outcomes(pairs, options, jobs=n_jobs, scheduler=scheduler, wait=wait, progress=progress)
    entries = []
    for pair, outcome in zip(pairs, run, strict=True):
        for failure in outcome.failures if scheduler is None and n_jobs == 1 else ():
            report_error(failure.error, as_json=False)
        entries.append(_entry(*pair, outcome, expect=expect, as_json=json, progress=progress))
    if json:
        emit_json([content for content, _ in entries])
    if len(pairs) > 1:
        _index(out or default_out(cases[0]).parent, options.templates, progress, as_json=json)
    failed = [(content["case"], failures) for content, failures in entries if failures]
    if failed:
        say(f"{len(failed)} of {len(entries)} cases failed:", to_stderr=True)
        for case, failures in failed:
            lines = [case, *(line for each in failures for line in _lines(each))]
            say("\n".join(f"  {line}" for line in lines), to_stderr=True)
        raise typer.Exit(max(each.error.exit_code for _, failures in failed for each in failures))


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


def _lines(failure: FailedStage) -> list[str]:
    """Lines that describe a failure: stage and site, and its error."""
    error = failure.error
    what = f"{failure.place}: {error.what}" if failure.place else error.what
    return [f"  {what}", f"    where: {error.where}", f"    fix:   {error.fix}"]


def _entry(
    case: Path, target: Path, outcome: CaseOutcome, *, expect: bool, as_json: bool, progress: Progress
) -> tuple[dict[str, Any], list[FailedStage]]:
    """What --json tells of a case and its failures, compared with its expected.toml if requested."""
    from limbcli.stages.batch_cases import expectations

    content = outcome.to_json() | {"case": str(case), "out": str(target)}
    failures = list(outcome.failures)
    if not outcome.begun:
        content = {"case": str(case), "out": str(target), "error": failures[0].error.what}
    elif expect:
        found, unlike = expectations(case, target, progress=progress)
        content["expected"] = [{**vars(each), "expected": each.expected} for each in found]
        failures += unlike
        if not as_json:
            say("".join(f"{each}\n" for each in found), end="")
    if not as_json and outcome.report:
        say(outcome.report)
    return content, failures
