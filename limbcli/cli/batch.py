"""`limbcli batch CASE [CASE ...]`."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from limbcli.cli.options import (
    FebioOpt,
    JsonOpt,
    NoWaitOpt,
    OutOpt,
    QuietOpt,
    SolverOpt,
    TemplatesOpt,
    VerboseOpt,
)
from limbcli.cli.terminal import emit_json, terminal
from limbcli.errors import FitError, LimbError
from limbcli.writing import one_writer

if TYPE_CHECKING:
    from limbcli.progress import Progress
    from limbcli.stages.batching.outcome import BatchOptions, CaseOutcome

CasesArg = Annotated[list[Path], typer.Argument(metavar="CASE...", help="Case folders.", show_default=False)]
ElementOpt = Annotated[
    str | None, typer.Option("--element", help="tet10 | tet4; default: the case's own.", show_default=False)
]
ForceOpt = Annotated[bool, typer.Option("--force", help="Redo every stage, also where nothing changed.")]
DefaultsOpt = Annotated[
    bool, typer.Option("--defaults", help="Forget the options that stages were called with by hand.")
]
DiagnoseOpt = Annotated[
    bool, typer.Option("--diagnose", help="Diagnose every place, too (minutes each), once it is fitted.")
]
ExpectOpt = Annotated[
    bool, typer.Option("--expect", help="Compare with the expected.toml of each case that has one.")
]
JobsOpt = Annotated[
    int | None,
    typer.Option(
        "--jobs", "-j", min=1, metavar="N", show_default=False,
        help="Processes side by side; default: of several cases as many as cores and memory allow.",
    ),
]  # fmt: skip
SchedulerOpt = Annotated[
    str | None,
    typer.Option(
        "--scheduler", metavar="ADDRESS", show_default=False,
        help="A running Dask cluster does the work, such as tcp://10.0.0.5:8786.",
    ),
]  # fmt: skip


def command(
    cases: CasesArg,
    out: OutOpt = None,
    element: ElementOpt = None,
    solver: SolverOpt = "auto",
    febio: FebioOpt = None,
    templates: TemplatesOpt = None,
    force: ForceOpt = False,
    defaults: DefaultsOpt = False,
    diagnose: DiagnoseOpt = False,
    expect: ExpectOpt = False,
    jobs: JobsOpt = None,
    scheduler: SchedulerOpt = None,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """All stages of one or more cases, from images to report; redoes only what changed.

    A stage that was called by hand with options is called with them again, and that is said.
    With one CASE, --out is its output folder; with several, the folder that holds
    one output folder a case, and an index page. The last line printed is the report
    (of several cases, the index). A case that fails does not stop the others: who failed,
    where and why is listed at the end.
    """
    from limbcli.config import default_out
    from limbcli.stages.batching.outcome import BatchOptions

    options = BatchOptions(
        element=element, solver=solver, febio=_absolute(febio), templates=_absolute(templates), force=force,
        defaults=defaults, diagnose=diagnose,
    )  # fmt: skip
    progress = terminal(quiet=quiet, verbose=verbose)
    pairs = _folders(cases, out)
    way = _Way(options, progress, wait=not no_wait, expect=expect, as_json=json)
    n_jobs = _jobs(jobs, scheduler, len(pairs))
    if scheduler is None and n_jobs == 1:
        entries = [way.alone(case, target) for case, target in pairs]
    else:
        entries = way.together(pairs, scheduler=scheduler, jobs=n_jobs)
    if json:
        emit_json([each.content for each in entries])
    if len(pairs) > 1:
        _index(out or default_out(cases[0]).parent, progress, as_json=json)
    failed = [each for each in entries if each.code]
    if failed:
        print(f"{len(failed)} of {len(entries)} cases failed:", file=sys.stderr)
        for each in failed:
            print("\n".join(f"  {line}" for line in each.lines()), file=sys.stderr)
        raise typer.Exit(max(each.code for each in failed))


def _absolute(path: Path | None) -> Path | None:
    return None if path is None else path.absolute()


def _jobs(jobs: int | None, scheduler: str | None, n_cases: int) -> int:
    """Local processes: those asked for, else what suits several cases; one where Dask is not installed."""
    from limbcli.stages.batching.cluster import is_installed, jobs_for

    if jobs is not None or scheduler is not None:
        return jobs or 1
    return jobs_for(n_cases) if n_cases > 1 and is_installed() else 1


def _folders(cases: list[Path], out: Path | None) -> list[tuple[Path, Path]]:
    """Each case once, with its output folder.

    Raises
    ------
    CaseError
        If two cases would have the same.
    """
    from limbcli.config import default_out
    from limbcli.errors import CaseError

    several = list({case.resolve(): case for case in cases}.values())
    taken: dict[Path, Path] = {}
    for case in several:
        own = default_out(case) if out is None else out if len(several) == 1 else out / case.resolve().name
        if own in taken:
            raise CaseError(
                f"{taken[own]} and {case} would have the same output folder {own}",
                where="CASE...",
                fix="call batch once for each folder that holds cases, with an --out of its own",
            )
        taken[own] = case
    return [(case, own) for own, case in taken.items()]


def _index(folder: Path, progress: Progress, *, as_json: bool) -> None:
    """The page that lists all; where no case left anything to list, that is said and is no failure more."""
    from limbcli.cli.app import report_error
    from limbcli.stages.report_pages.index import report_index

    try:
        index = report_index(folder, progress=progress)
    except LimbError as error:
        report_error(error, as_json=False)
        return
    if not as_json:
        print(index.page)


@dataclass(frozen=True)
class _Failed:
    """What failed (stage and site), and its error."""

    place: str
    error: LimbError

    def lines(self) -> list[str]:
        what = f"{self.place}: {self.error.what}" if self.place else self.error.what
        return [f"  {what}", f"    where: {self.error.where}", f"    fix:   {self.error.fix}"]


@dataclass(frozen=True)
class _Entry:
    """How one case went, for the end: content of --json, and what failed."""

    content: dict[str, Any]
    failures: list[_Failed]

    @property
    def code(self) -> int:
        """For the shell."""
        return max((each.error.exit_code for each in self.failures), default=0)

    def lines(self) -> list[str]:
        return [str(self.content["case"]), *(line for each in self.failures for line in each.lines())]


class _Way:
    """How cases are run, and what is reported of each."""

    def __init__(self, options: BatchOptions, progress: Progress, *, wait: bool, expect: bool, as_json: bool):
        self.options, self.progress = options, progress
        self.wait, self.expect, self.as_json = wait, expect, as_json

    def alone(self, case: Path, target: Path) -> _Entry:
        """One case in this process; its error is shown, not raised."""
        from limbcli.cli.app import report_error
        from limbcli.cli.batch_task import in_words
        from limbcli.pasting import pasted
        from limbcli.stages.batch import batch

        self.progress.event("stage", name=f"case {case}")
        try:
            turn = one_writer(target, wait=self.wait, progress=self.progress)
            with turn if case.is_dir() else nullcontext():
                outcome = batch(case, out=target, options=self.options, progress=self.progress)
        except Exception as error:  # one case's fault never stops the others
            shown = pasted(in_words(error, target), case, target)
            report_error(shown, as_json=False)
            content = {"case": str(case), "out": str(target), "error": shown.what}
            return _Entry(content, [_Failed("", shown)])
        for failure in outcome.failures:
            report_error(failure.error, as_json=False)
        return self._entry(case, target, outcome)

    def together(self, pairs: list[tuple[Path, Path]], *, scheduler: str | None, jobs: int) -> list[_Entry]:
        """All on a cluster, or in so many local processes."""
        from limbcli.cli.batch_cluster import together

        absolute = [(case.absolute(), target.absolute()) for case, target in pairs]
        outcomes = together(
            absolute, self.options, scheduler=scheduler, jobs=jobs, wait=self.wait, progress=self.progress
        )
        return [self._entry(*pair, outcome) for pair, outcome in zip(pairs, outcomes, strict=True)]

    def _entry(self, case: Path, target: Path, outcome: CaseOutcome) -> _Entry:
        failures = [_Failed(each.place, each.error) for each in outcome.failures]
        content = outcome.to_json() | {"case": str(case), "out": str(target)}
        if self.expect:
            content["expected"], unlike = self._expected(case, target)
            failures += unlike
        if not self.as_json and outcome.report:
            print(outcome.report)
        return _Entry(content, failures)

    def _expected(self, case: Path, target: Path) -> tuple[list[dict[str, Any]], list[_Failed]]:
        """What was compared with expected.toml, and what of it does not hold."""
        from limbcli.stages.expect import EXPECTED_FILE, compare

        file = case / EXPECTED_FILE
        if not file.is_file():
            self.progress.event("note", text=f"{case}: no {EXPECTED_FILE}, nothing to compare with")
            return [], []
        try:
            found = compare(case, target)
        except LimbError as error:
            return [], [_Failed(EXPECTED_FILE, error)]
        if not self.as_json:
            for each in found:
                print(each)
        fix = "look at the report; if the new value is right, write it there"
        unlike = [
            _Failed(
                "",
                FitError(f"{each.name} is {each.found}, expected {each.expected}", where=str(file), fix=fix),
            )
            for each in found
            if not each.holds
        ]
        return [{**vars(each), "expected": each.expected} for each in found], unlike
