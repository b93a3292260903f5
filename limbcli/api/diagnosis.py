"""diagnose and report: find what the model lacks, and write the report page."""

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

_CANDIDATE = ("name", "kind", "sentence", "probability", "ln_bayes_factor")


@dataclass(frozen=True, eq=False)
class DiagnosisResult(Result):
    """What a site's model lacks. `table()` has one row per candidate effect, the most likely first.

    Attributes
    ----------
    verdict : "adequate", "named", "ambiguous", "unexplained" or "untestable"
    reason : reason of the verdict, as a sentence
    added : effects that were added to the model
    confidence_set : the explanations that together have a probability of 95 %, each a tuple of effects; an
    empty one
        is that nothing is missing
    probability : of the most probable of them
    sentences : the full account, in reading order
    next_measurement : proposed next measurement; None if there is none
    """

    stage: ClassVar[str] = "diagnose"
    verdict: str
    reason: str
    added: tuple[str, ...]
    confidence_set: tuple[tuple[str, ...], ...]
    probability: float
    sentences: tuple[str, ...]
    next_measurement: str | None

    @classmethod
    def of(cls, found: StageResult) -> Self:
        data = found.data
        return cls(
            found, data["verdict"], data["reason"], tuple(data["added"]),
            tuple(tuple(each) for each in data["confidence_set"]), data["explanations"][0]["probability"],
            tuple(data["sentences"]), data["next_measurement"]["recommended"],
        )  # fmt: skip

    def rows(self) -> list[dict[str, Any]]:
        return [self._named({name: each[name] for name in _CANDIDATE}) for each in self.data["candidates"]]

    def model(self) -> LimbModel:
        """The model with the added effects, as in diagnosed.feb."""
        from limbcli.feb.read import read_feb

        return read_feb(self.files["feb"])


@dataclass(frozen=True, eq=False)
class ReportResult(Result):
    """The report page. `table()` has one row per stage: its label, and "done" or what happened instead.

    Attributes
    ----------
    page : one self-contained HTML file
    mood : overall outcome, in one word
    n_warnings : number of warnings on the page
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
    max_effects: int = 2,
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
    """Find where model and measurement disagree, what is missing, and what to measure next. Requires `mesh`.

    Parameters
    ----------
    case, out, wait, progress : as for `segment`
    sites : name or names; None: all
    effects : names of the effects to try; none: all
    effect_file : a Python file that defines your own `EFFECT`; it is tried in addition to those named
    max_effects : maximum number of effects missing together, 1 or 2
    seed : of all random draws
    size_mm, far_size_mm : edge lengths of the working mesh under the probe (None: 5, less where the tissue is
        thin) and far from it
    interventions : try cut and contact first (a few more simulations)
    separate : diagnose each site separately, even if several share a place
    solver, febio : used for draining tissue, which only FEBio can simulate. "auto": if FEBio is found and a
        force decreases in a recorded hold; "febio": for every record with holds; "reference": never
    measured : separately measured numbers: tare_n, force_gain, first_depth_mm, rate_ratio
    templates : a folder of Jinja templates that take precedence over the built-in ones

    Raises
    ------
    CaseError
        If `segment` or `mesh` has not been run, or an effect or argument is not known.
    MeasurementError
        If the levels cannot be used.
    ToolError
        If FEBio is requested and not found.
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
    """Write one self-contained page of the stages' results, including what is missing or failed.

    Parameters
    ----------
    case, out, wait, progress : as for `segment`
    templates : a folder of Jinja templates that take precedence over the built-in ones

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
