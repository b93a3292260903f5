"""check and measure: validate a case, and convert instrument files to levels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from limbcli.api.call import CaseLike, Heard, PathLike, at_work, folder_of, foreseen, listening, public
from limbcli.api.stage_result import Result, each_site
from limbcli.api.tables import Tabular, plain_rows, read_columns
from limbcli.errors.problems import Problem, errors_of
from limbcli.options import CASE, OUT, PROGRESS, SITES, WAIT, Option
from limbcli.results import StageResult

if TYPE_CHECKING:
    from limbcli.stages.check import CaseCheck as Checked


@dataclass(frozen=True)
class CheckResult(Tabular):
    """Result of checking a case. `table()` has one row per problem.

    Attributes
    ----------
    folder : the case's folder
    looked_at : files and folders that were read
    problems : each with what, where, fix, and severity "error" or "warning"
    """

    folder: Path
    looked_at: tuple[str, ...]
    problems: tuple[Problem, ...]

    @property
    def ok(self) -> bool:
        """Whether there is no error."""
        return not errors_of(self.problems)

    def __str__(self) -> str:
        problems = (
            f"{each.severity}: {each.what}\n  where: {each.where}\n  fix:   {each.fix}"
            for each in self.problems
        )
        return "\n".join(problems) or f"{self.folder}: the case is complete"

    def rows(self) -> list[dict[str, Any]]:
        """One row per problem: severity, what, where, fix."""
        names = ("severity", "what", "where", "fix")
        return [{name: getattr(each, name) for name in names} for each in self.problems]


@dataclass(frozen=True, eq=False)
class MeasureResult(Result):
    """The levels of a site, from the instruments' files. `table()` has one row per level.

    Attributes
    ----------
    levels : the table that was written, with the columns of levels.csv
    """

    stage: ClassVar[str] = "measure"
    levels: Path

    def rows(self) -> list[dict[str, Any]]:
        return [self._named(row) for row in plain_rows(read_columns(self.levels))]


def _checked(found: Checked) -> CheckResult:
    return CheckResult(found.case, found.looked_at, found.problems)


@public(_checked, "CheckResult")
def check(case: Annotated[CaseLike, CASE], *, progress: Annotated[Heard, PROGRESS] = None) -> Checked:
    """Check everything about a case folder that can be known before computing, and return all problems at
    once. An error in the case raises nothing: it is in `problems`.
    """
    from limbcli.case import Case
    from limbcli.stages import check as stage

    with foreseen():
        folder = case.folder if isinstance(case, Case) else folder_of(case, "case")
        return stage.check(folder, progress=listening(progress))


@each_site(MeasureResult)
def measure(
    case: Annotated[CaseLike, CASE],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    sites: Annotated[str | Iterable[str] | None, SITES] = None,
    write: Annotated[
        bool, Option("Also write levels.csv to the path given in case.toml (if absent).")
    ] = False,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> Iterable[StageResult]:
    """Convert the load-cell record, B-mode and elastography images to the rows of levels.csv.

    Raises
    ------
    CaseError
        If a site names no instrument, or `write` would overwrite a file.
    MeasurementError
        If a record or image cannot be read, or their numbers of levels differ.
    """
    from limbcli.stages import measure as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        return work.run(stage.measure, sites=sites, write=write)
