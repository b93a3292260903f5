"""Batches of several cases: output folders, number of processes, and how a single case is run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path

from limbcli.case import Case
from limbcli.config import default_out
from limbcli.errors import CaseError, FitError, LimbError
from limbcli.errors.pasted_commands import pasted
from limbcli.files.output_lock import one_writer
from limbcli.progress import SILENT, Progress
from limbcli.stages.batch import batch
from limbcli.stages.batch_task import in_words
from limbcli.stages.batching.outcome import BatchOptions, CaseOutcome, FailedStage
from limbcli.stages.expect import EXPECTED_FILE, Comparison, compare


def output_folders(cases: Iterable[Path], out: Path | None) -> list[tuple[Path, Path]]:
    """Each case once, with its output folder: `out` for a single case, a subfolder of it for several.

    Raises CaseError if two cases would have the same output folder.
    """
    several = list({case.resolve(): case for case in cases}.values())
    taken: dict[Path, Path] = {}
    for case in several:
        own = default_out(case) if out is None else out if len(several) == 1 else out / case.resolve().name
        if own in taken:
            raise CaseError(
                f"{taken[own]} and {case} would have the same output folder {own}",
                where="CASE...",
                fix="run batch once for each folder that contains cases, each with its own --out",
            )
        taken[own] = case
    return [(case, own) for own, case in taken.items()]


def n_processes(jobs: int | None, scheduler: str | None, n_cases: int) -> int:
    """Number of local processes: as requested, else by the number of cases; one if Dask is not installed."""
    from limbcli.stages.batching.cluster import is_installed, jobs_for

    if jobs is not None and scheduler is not None:
        what = f"--jobs {jobs} and --scheduler are given: the scheduler's workers are as many as it has"
        raise CaseError(what, where="--jobs, --scheduler", fix="leave out one of the two")
    if jobs is not None or scheduler is not None:
        return jobs or 1
    return jobs_for(n_cases) if n_cases > 1 and is_installed() else 1


def one_case(
    case: Path, out: Path, options: BatchOptions, *, wait: bool = True, progress: Progress = SILENT
) -> CaseOutcome:
    """Run one case in this process; every error, including unexpected ones, is recorded in its outcome."""
    progress.event("stage", name=f"case {case}")
    try:
        turn = one_writer(out, wait=wait, progress=progress)
        with turn if case.is_dir() else nullcontext():
            return batch(case, out=out, options=options, progress=progress)
    except Exception as error:  # an error in one case never stops the others
        failure = FailedStage("", None, pasted(in_words(error, out), case, out))
        return CaseOutcome(case, out, failures=[failure], begun=False)


def outcomes(
    pairs: Sequence[tuple[Path, Path]], options: BatchOptions, *, jobs: int, scheduler: str | None,
    wait: bool, progress: Progress,
) -> Iterator[CaseOutcome]:  # fmt: skip
    """Run all (case, output folder) pairs, one after the other here or together in several processes.

    Raises ToolError as `batch_cluster.together`.
    """
    if scheduler is None and jobs == 1:
        yield from (one_case(*pair, options, wait=wait, progress=progress) for pair in pairs)
        return
    from limbcli.stages.batch_cluster import together

    absolute = [(case.absolute(), target.absolute()) for case, target in pairs]
    yield from together(absolute, options, scheduler=scheduler, jobs=jobs, wait=wait, progress=progress)


def _readable(folder: Path) -> Case | None:
    """The case, or None if it cannot be read (the batch itself reports that)."""
    try:
        return Case.open_limb(folder)
    except CaseError:
        return None


def expectations(case: Path, out: Path, *, progress: Progress) -> tuple[list[Comparison], list[FailedStage]]:
    """All comparisons with the case's expected.toml, and a failure for each that is not met."""
    file = case / EXPECTED_FILE
    if not file.is_file():
        progress.event("note", text=f"{case}: no {EXPECTED_FILE}, nothing to compare with")
        return [], []
    try:
        found = compare(case, out, case=_readable(case))
    except LimbError as error:
        return [], [FailedStage(EXPECTED_FILE, None, error)]
    fix = "check the report; if the new value is right, enter it there; correct any name that was not found"
    unlike = [
        FailedStage(
            "", None,
            FitError(f"{each.name} is {each.found}, expected {each.expected}", where=str(file), fix=fix),
        )
        for each in found if not each.holds
    ]  # fmt: skip
    return found, unlike
