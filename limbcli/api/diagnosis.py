"""diagnose and report: find what the model lacks, and write the report page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from limbcli.api.call import CaseLike, Heard, PathLike, at_work, maybe_path, names_of
from limbcli.api.stage_result import Result, each_site, one
from limbcli.options import CASE, FEBIO, OUT, PROGRESS, SITES, SOLVER, TEMPLATES, WAIT, Option, SolverName
from limbcli.results import StageResult

if TYPE_CHECKING:
    from limbcli.model import LimbModel

MEASURED = ("tare_n", "force_gain", "first_depth_mm", "rate_ratio")
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
        empty one is that nothing is missing
    probability : of the most probable of them
    sentences : the full account, in reading order
    next_measurement : proposed next measurement; None if there is none
    """

    stage: ClassVar[str] = "diagnose"
    verdict: str
    reason: str
    added: tuple[str, ...]
    confidence_set: tuple[tuple[str, ...], ...]
    probability: float = field(metadata={"from": lambda found: found.data["explanations"][0]["probability"]})
    sentences: tuple[str, ...]
    next_measurement: str | None = field(metadata={"from": "next_measurement/recommended"})

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

    def rows(self) -> list[dict[str, Any]]:
        return [
            self._named({"result": label, "status": status}) for label, status in self.data["stages"].items()
        ]


@each_site(DiagnosisResult)
def diagnose(
    case: Annotated[CaseLike, CASE],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    sites: Annotated[str | Iterable[str] | None, SITES] = None,
    solver: Annotated[SolverName, SOLVER] = "auto",
    febio: Annotated[PathLike | None, FEBIO] = None,
    effects: Annotated[
        str | Iterable[str],
        Option(
            "Try only this effect (may be repeated), and that of --effect-file; default: all.",
            metavar="NAME",
            kind=list[str],
            python="Names of the effects to try; none: all.",
        ),
    ] = (),
    effect_file: Annotated[
        PathLike | None,
        Option(
            "A Python file with an effect of your own, which is tried too.",
            metavar="FILE",
            kind=Path,
            python="A Python file that defines your own `EFFECT`, which is tried too.",
        ),
    ] = None,
    max_effects: Annotated[
        int, Option("Largest number of effects that may be missing together.", (1, 2))
    ] = 2,
    seed: Annotated[int, Option("Random seed.", (0, None))] = 7,
    size_mm: Annotated[
        float | None,
        Option(
            "Edge length of the working mesh under the probe, mm; default: 5, less where tissue is thin.",
            (1, 20),
        ),
    ] = None,
    far_size_mm: Annotated[
        float, Option("Edge length of the working mesh far from the probe, mm.", (2, 50))
    ] = 14.0,
    interventions: Annotated[
        bool, Option("First test the model's cut and contact (a few more simulations).")
    ] = True,
    separate: Annotated[
        bool, Option("Diagnose each site on its own, even if several share a place.")
    ] = False,
    measured: Annotated[
        Mapping[str, float] | None,
        Option(
            f"A separately measured number: {', '.join(MEASURED)}.",
            metavar="KEY=VALUE",
            kind=list[str],
            such_as=tuple(f"{name}=" for name in MEASURED),
            example={"tare_n": 0.4},
        ),
    ] = None,
    templates: Annotated[PathLike | None, TEMPLATES] = None,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> Iterable[StageResult]:
    """Find where model and measurement disagree, what is missing, and what to measure next. Requires `mesh`.

    `solver` and `febio` are for draining tissue, which only FEBio can simulate. "auto": if FEBio is found and
    a force decreases in a recorded hold; "febio": for every record with holds; "reference": never.

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
    from limbcli.stages import diagnose as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        options = stage.DiagnoseOptions(
            effects=tuple(names_of(effects or None, "effects") or ()),
            effect_file=maybe_path(effect_file, "effect_file"), max_effects=max_effects, seed=seed,
            size=size_mm, far_size=far_size_mm, templates=maybe_path(templates, "templates"),
            interventions=interventions, separate=separate,
            measured=dict(measured or {}), solver=solver, febio=maybe_path(febio, "febio"),
        )  # fmt: skip
        return work.run(stage.diagnose, sites=sites, options=options)


@one(ReportResult)
def report(
    case: Annotated[CaseLike, CASE],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    templates: Annotated[PathLike | None, TEMPLATES] = None,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> StageResult:
    """Write one self-contained page of the stages' results, including what is missing or failed.

    Raises
    ------
    CaseError
        If the case cannot be opened.
    ToolError
        If the templates are not found.
    """
    from limbcli.stages import report as stage

    with at_work(case, out, wait=wait, progress=progress, sites_or_none=True) as work:
        return work.run(stage.report, templates=templates)
