"""batch and cohort: run many cases through all stages, and analyse a table of many people."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from limbcli.api.call import (
    CaseLike,
    Heard,
    PathLike,
    folder_of,
    foreseen,
    listening,
    maybe_path,
    public,
    writing,
)
from limbcli.api.stage_result import Result, one
from limbcli.api.tables import Row, Tabular
from limbcli.config import default_out
from limbcli.errors import CaseError, LimbcliError
from limbcli.options import ELEMENT, FEBIO, OUT, PROGRESS, SOLVER, TEMPLATES, WAIT, Option, SolverName
from limbcli.results import StageResult
from limbcli.stages.batching.outcome import BatchOptions, FailedStage

if TYPE_CHECKING:
    from limbcli.progress import Progress
    from limbcli.stages.batching.outcome import CaseOutcome


@dataclass(frozen=True)
class CaseResult(Tabular):
    """Outcome of one case of a batch. `table()` has one row.

    Attributes
    ----------
    case, out : its folder, and its output folder
    ran, fresh : stages (and sites) that were run, and those that were up to date
    failures : empty if nothing failed
    expected : comparisons with its expected.toml, in words; empty if not requested
    report : its report page; None if there is none
    """

    case: Path
    out: Path
    ran: tuple[str, ...]
    fresh: tuple[str, ...]
    failures: tuple[FailedStage, ...]
    expected: tuple[str, ...] = ()
    report: Path | None = None

    @property
    def ok(self) -> bool:
        """Whether nothing failed."""
        return not self.failures

    def __str__(self) -> str:
        if self.ok:
            return f"{self.case}: done, {self.report or 'without a report'}"
        lines = (f"{each.place}: {each.error}" for each in self.failures)
        return "\n  ".join([f"{self.case}: failed", *"\n".join(lines).splitlines()])

    def rows(self) -> list[dict[str, Any]]:
        words = "; ".join(
            " ".join(each for each in (failure.stage, failure.site, failure.error.message) if each)
            for failure in self.failures
        )
        return [
            {
                "case": str(self.case), "out": str(self.out), "ok": self.ok, "n_ran": len(self.ran),
                "n_fresh": len(self.fresh), "failures": words,
                "report": str(self.report) if self.report else "",
            }
        ]  # fmt: skip


@dataclass(frozen=True)
class BatchResult(Tabular):
    """Outcome of the cases of a batch. `table()` has one row per case.

    Attributes
    ----------
    cases : in the order in which they were given
    index : page that lists all cases; None for a single case, or if no case has results to list
    """

    cases: tuple[CaseResult, ...]
    index: Path | None = None

    @property
    def ok(self) -> bool:
        """Whether nothing failed."""
        return all(each.ok for each in self.cases)

    def __str__(self) -> str:
        return "\n".join(map(str, self.cases))

    def __iter__(self) -> Iterator[CaseResult]:
        return iter(self.cases)

    def __len__(self) -> int:
        return len(self.cases)

    def rows(self) -> list[dict[str, Any]]:
        return [row for each in self.cases for row in each.rows()]


@dataclass(frozen=True, eq=False)
class CohortResult(Result):
    """Tissue of many people. `table()` has one row per row of the table that was used.

    Attributes
    ----------
    page : HTML page of the results
    sites : mean and spread of the population by site, as in cohort.json
    compliance_left_out : prediction error of the compliance of held-out people, as in cohort.json
    """

    stage: ClassVar[str] = "cohort"
    page: Path
    sites: Row = field(repr=False)
    compliance_left_out: Row = field(repr=False)

    @classmethod
    def read(cls, out: PathLike, site: str | None = None) -> Self:
        """The result that an earlier run wrote to `out`; `site` must be None.

        Raises
        ------
        CaseError
            If there is none, or it cannot be read.
        """
        from limbcli.stages.cohort import read_cohort

        if site is not None:
            raise CaseError(
                "a cohort is not a result of one site",
                where=f"read(site={site!r})",
                fix="omit the site: `sites` has all",
            )
        return cls.of(read_cohort(folder_of(out)))

    def rows(self) -> list[dict[str, Any]]:
        """The rows of rows.csv."""
        return [dict(row) for row in self.data["rows"]]


@public(lambda found: found, "BatchResult")
def batch(
    cases: Annotated[
        CaseLike | Iterable[CaseLike],
        Option("Case folders.", metavar="CASE...", kind=list[Path], python="One case or several, each once."),
    ],
    *,
    out: Annotated[
        PathLike | None,
        replace(
            OUT,
            python="Output folder of one case; of several, the folder that holds one output folder per case "
            "and an index page.",
        ),
    ] = None,
    element: Annotated[Literal["tet10", "tet4"] | None, ELEMENT] = None,
    solver: Annotated[SolverName, SOLVER] = "auto",
    febio: Annotated[PathLike | None, FEBIO] = None,
    templates: Annotated[PathLike | None, TEMPLATES] = None,
    force: Annotated[bool, Option("Redo every stage, even where nothing changed.")] = False,
    defaults: Annotated[
        bool, Option("Use default options instead of those that stages were last called with by hand.")
    ] = False,
    diagnose: Annotated[bool, Option("Also diagnose every place (minutes each), once it is fitted.")] = False,
    expect: Annotated[
        bool,
        Option(
            "Compare with the expected.toml of each case that has one.",
            python="Compare with the expected.toml of each case that has one; a mismatch is a failure.",
        ),
    ] = False,
    jobs: Annotated[
        int | None,
        Option(
            "Number of parallel processes; default for several cases: as many as cores and memory allow.",
            (1, None),
            short="-j",
            metavar="N",
        ),
    ] = None,
    scheduler: Annotated[
        str | None, Option("Run on an existing Dask cluster, such as tcp://10.0.0.5:8786.", metavar="ADDRESS")
    ] = None,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> BatchResult:
    """Run all stages of one or more cases, from images to report; only what changed is redone.

    More than one process needs the call in a script to be below `if __name__ == "__main__":`.
    A case that fails does not stop the others and raises nothing: check `ok` and `failures`.

    Raises
    ------
    CaseError
        If no case is given, an argument is invalid, or two cases would have the same output folder.
    ToolError
        If Dask is not installed, no scheduler answers, or the connection to it is lost.
    """
    from limbcli.stages.batch_cases import n_processes, outcomes, output_folders

    folders = _folders(cases)
    heard = listening(progress)
    options = BatchOptions.of(
        element=element, solver=solver, febio=maybe_path(febio, "febio"),
        templates=maybe_path(templates, "templates"), force=force, defaults=defaults, diagnose=diagnose,
    )  # fmt: skip
    with foreseen():
        pairs = output_folders(folders, maybe_path(out, "out"))
        n_jobs = n_processes(jobs, scheduler, len(pairs))
        run = outcomes(pairs, options, jobs=n_jobs, scheduler=scheduler, wait=wait, progress=heard)
        found = tuple(
            _case_result(*pair, outcome, expect=expect, heard=heard)
            for pair, outcome in zip(pairs, list(run), strict=True)
        )
        together_in = default_out(folders[0]).parent if out is None else folder_of(out)
        return BatchResult(found, _index(together_in, options.templates, heard) if len(pairs) > 1 else None)


def _folders(cases: CaseLike | Iterable[CaseLike]) -> list[Path]:
    """Folders of one case or several.

    Raises
    ------
    CaseError
        If there is none, or one is not a path.
    """
    from limbcli.case import Case

    one = isinstance(cases, Case | str) or not isinstance(cases, Iterable)
    several = [cases] if one else list(cases)  # type: ignore[arg-type]
    if not several:
        raise CaseError("no case is given", where="batch(cases)", fix="give a case folder, or several")
    return [each.folder if isinstance(each, Case) else folder_of(each, "cases") for each in several]  # type: ignore[arg-type]


def _case_result(
    case: Path, target: Path, outcome: CaseOutcome, *, expect: bool, heard: Progress
) -> CaseResult:
    """Result of a case, compared with its expected.toml if requested."""
    from limbcli.stages.batch_cases import expectations

    wanted = expect and outcome.begun
    compared, unlike = expectations(case, target, progress=heard) if wanted else ([], [])
    return CaseResult(
        case, target, tuple(outcome.ran), tuple(outcome.fresh), (*outcome.failures, *unlike),
        tuple(map(str, compared)), outcome.report,
    )  # fmt: skip


def _index(folder: Path, templates: Path | None, heard: Progress) -> Path | None:
    """Write the page that lists all cases; None if no case has results to list, as their failures give the
    reasons."""
    from limbcli.stages.report_pages.index import report_index

    try:
        return report_index(folder, templates=templates, progress=heard).page
    except LimbcliError as error:
        heard.event("note", text=str(error.message))
        return None


@one(CohortResult)
def cohort(
    table: Annotated[
        PathLike,
        Option(
            "One row per person and site.",
            metavar="TABLE.csv",
            kind=Path,
            python="A CSV file with one row per person and site; docs/cohort.md describes its columns.",
        ),
    ],
    *,
    out: Annotated[PathLike | None, replace(OUT, help="Output folder; default: out/<name of TABLE>.")] = None,
    seed: Annotated[int, Option("Random seed of the folds and of the sampling.", (0, None))] = 7,
    templates: Annotated[PathLike | None, TEMPLATES] = None,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> StageResult:
    """Estimate the tissue of many people from layers, force and slope; no limb model, MRI or wave speeds
    needed.

    Raises
    ------
    MeasurementError
        If the table cannot be used; each problem is reported with its line.
    CaseError, ToolError
        If the folder cannot be written, or the simulations shipped with limbcli are missing.
    """
    from limbcli.stages import cohort as stage

    file = folder_of(table, "table")
    with writing(file.with_suffix(""), out, wait=wait, progress=progress) as (target, heard):
        return stage.cohort(
            file, out=target, seed=seed, templates=maybe_path(templates, "templates"), progress=heard
        )
