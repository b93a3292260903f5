"""diagnose and report: what the model lacks, and the page that reports everything."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from limbcli.api.base import Result, SiteResults, by_site
from limbcli.api.call import CaseLike, Heard, PathLike, at_work, maybe_path, names_of, records_call
from limbcli.api.limits import one_of, tables, within
from limbcli.api.simulation import SOLVERS, SolverName
from limbcli.results import StageResult

if TYPE_CHECKING:
    from limbcli.model import LimbModel

_CANDIDATE = ("name", "kind", "sentence", "score", "p", "p_adjusted")


@dataclass(frozen=True, eq=False)
class DiagnosisResult(Result):
    """What a site's model lacks. `table()` has a row a candidate effect, the most likely first.

    Attributes
    ----------
    verdict : "adequate", "named", "ambiguous", "unexplained" or "untestable"
    reason : why, as a sentence
    added : the effects that were added to the model
    confidence_set : every explanation that fits, each a tuple of effects
    gap_closed : whether they close the gap; False where nothing was added
    sentences : the whole account, to be read from top to bottom
    next_measurement : what to measure next; None where nothing is proposed
    """

    stage: ClassVar[str] = "diagnose"
    verdict: str
    reason: str
    added: tuple[str, ...]
    confidence_set: tuple[tuple[str, ...], ...]
    gap_closed: bool
    sentences: tuple[str, ...]
    next_measurement: str | None

    @classmethod
    def of(cls, found: StageResult) -> Self:
        data = found.data
        return cls(
            found, data["verdict"], data["reason"], tuple(data["added"]),
            tuple(tuple(each) for each in data["confidence_set"]), data["gap_closed"],
            tuple(data["sentences"]), data["next_measurement"]["recommended"],
        )  # fmt: skip

    def rows(self) -> list[dict[str, Any]]:
        return [self._named({name: each[name] for name in _CANDIDATE}) for each in self.data["candidates"]]

    def model(self) -> LimbModel:
        """The model with what was added, as in diagnosed.feb."""
        from limbcli.feb.read import read_feb

        return read_feb(self.files["feb"])


@dataclass(frozen=True, eq=False)
class ReportResult(Result):
    """The page. `table()` has a row a stage: its label, and "done" or what else became of it.

    Attributes
    ----------
    page : one self-contained HTML file
    mood : how the whole came out, in one word
    n_warnings : warnings on the page
    """

    stage: ClassVar[str] = "report"
    page: Path
    mood: str
    n_warnings: int

    @classmethod
    def of(cls, found: StageResult) -> Self:
        return cls(found, found.path("page"), found.data["mood"], found.data["n_warnings"])

    def rows(self) -> list[dict[str, Any]]:
        return [
            self._named({"result": label, "status": status}) for label, status in self.data["stages"].items()
        ]


@records_call
def diagnose(
    case: CaseLike,
    *,
    out: PathLike | None = None,
    sites: str | Iterable[str] | None = None,
    effects: str | Iterable[str] = (),
    effect_file: PathLike | None = None,
    max_effects: int = 3,
    seed: int = 7,
    size_mm: float | None = None,
    far_size_mm: float = 14.0,
    interventions: bool = True,
    separate: bool = False,
    solver: SolverName = "auto",
    febio: PathLike | None = None,
    measured: Mapping[str, float] | None = None,
    templates: PathLike | None = None,
    wait: bool = True,
    progress: Heard = None,
) -> SiteResults[DiagnosisResult]:
    """Where model and measurement disagree, what is missing, and what to measure next. Comes after `mesh`.

    Parameters
    ----------
    case, out, wait, progress : as of `segment`
    sites : name or names; None: all
    effects : names of those to try; none: all
    effect_file : a Python file with an `EFFECT` of your own; it is tried whichever are named
    max_effects : effects added in turn, 1 to 3
    seed : of the bootstrap
    size_mm, far_size_mm : edges of the working mesh under the probe (None: 5, less where the tissue is
        thin) and far from it
    interventions : try cut and contact first, a few more simulations
    separate : each site alone, also those that share a place
    solver, febio : of draining tissue, which only FEBio simulates. "auto": where FEBio is found, and a force
        falls in a recorded hold; "febio": in every record with holds; "reference": never
    measured : numbers measured besides: tare_n, force_gain, first_depth_mm, rate_ratio
    templates : a folder of Jinja templates that come before ours

    Raises
    ------
    CaseError
        If `segment` or `mesh` has not been run, or an effect or argument is not known.
    MeasurementError
        If the levels cannot be used.
    ToolError
        If FEBio is asked for and is not there.
    SolveError, FitError
        If the model without effects cannot be solved or fitted.

    Source: the documentation, "The method and its limits"; each effect cites its own.
    """
    within("diagnose", max_effects=max_effects, seed=seed, size_mm=size_mm, far_size_mm=far_size_mm)
    one_of("diagnose", SOLVERS, solver=solver)
    tables("diagnose", {"tare_n": 0.4}, measured=measured)
    within("diagnose", **dict(measured or {}))
    from limbcli.stages import diagnose as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        options = stage.DiagnoseOptions(
            effects=tuple(names_of(effects or None, "effects") or ()),
            effect_file=maybe_path(effect_file, "effect_file"), max_effects=max_effects, seed=seed,
            size=size_mm, far_size=far_size_mm, templates=maybe_path(templates, "templates"),
            interventions=interventions, separate=separate,
            measured=dict(measured or {}), solver=solver, febio=maybe_path(febio, "febio"),
        )  # fmt: skip
        found = stage.diagnose(
            work.case, out=work.out, sites=names_of(sites), options=options, progress=work.progress
        )
    return by_site(DiagnosisResult, found)


@records_call
def report(
    case: CaseLike,
    *,
    out: PathLike | None = None,
    templates: PathLike | None = None,
    wait: bool = True,
    progress: Heard = None,
) -> ReportResult:
    """One self-contained page of what the stages left. What is missing or failed has its place on it.

    Parameters
    ----------
    case, out, wait, progress : as of `segment`
    templates : a folder of Jinja templates that come before ours

    Raises
    ------
    CaseError
        If the case cannot be opened.
    ToolError
        If the templates are not found.
    """
    from limbcli.stages import report as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        found = stage.report(
            work.case, out=work.out, templates=maybe_path(templates, "templates"), progress=work.progress
        )
    return ReportResult.of(found)
