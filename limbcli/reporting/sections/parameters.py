"""Which parameters were found, how certain they are, and what these data cannot determine."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from limbcli.numbers.significant_digits import significant
from limbcli.reporting.fit_view import MOONEY_RIVLIN, OGDEN, EstimateView, FitView, StepView, read_fit_view
from limbcli.reporting.numbers import DASH, cell, interval, quantity
from limbcli.reporting.outcome import Outcome
from limbcli.reporting.report_data import ReportData
from limbcli.reporting.reportlet import Cell, Mood, PageTable, Reportlet, head, table, worst_mood
from limbcli.reporting.sections.assumed_geometry import geometry_tables
from limbcli.reporting.sections.model_checks import model_check_tables, noise_alone

KEY, TITLE = "parameters", "Which tissue parameters, and how certain are they?"
_NOTABLE = 1.5  # ratio of misfit to stated noise above which it is mentioned
TET4_WORDS = (
    "This model is made of four-node tetrahedra, which lock: they resist the change of shape of nearly "
    "incompressible tissue. The f_κ (and κ′) found with them compensates for the mesh. It is a property "
    "of this mesh, not of the tissue; do not carry it over to another model."
)
TET10_WORDS = (
    "With ten-node tetrahedra the force hardly changes once f_κ is above about 50: an interval that is "
    "open upwards means “nearly incompressible”, and no more than that."
)


def parameters(page: ReportData) -> Reportlet:
    """The table used in the papers, one row per site, followed by intervals and flags in plain words."""
    outcomes = [page.outcomes.of("fit", site.name) for site in page.sites]
    views = _views(page)
    notes, warned = _notes(views)
    details = tuple(_details(str(site), view) for site, view in views.items())
    for site, view in views.items():
        details += (*geometry_tables(str(site), view.raw), *model_check_tables(str(site), view.raw))
    return Reportlet(
        KEY,
        TITLE,
        _mood(outcomes, views),
        tables=(_paper_table(outcomes, views), *details),
        look_for="a narrow interval and the word “identified”. c comes from shear waves at zero load and "
        "is held fixed; m describes how fast the tissue stiffens; κ′ = f_κ c how it resists volume change",
        bad="“at bound”, “no influence”, “trades off” or an interval open to one side: such a value is "
        "where the search stopped, not a property of the tissue",
        notes=tuple(notes),
        warned=tuple(warned),
    )


def parameter_warnings(page: ReportData) -> list[str]:
    """Reasons why these numbers may not describe the tissue: noise that was assumed or exceeded."""
    return [f"Site {site}: {text}" for site, view in _views(page).items() for text in _noise_words(view)]


def _views(page: ReportData) -> dict[str | None, FitView]:
    outcomes = [page.outcomes.of("fit", site.name) for site in page.sites]
    return {each.site: read_fit_view(each.result) for each in outcomes if each.result}


def _mood(outcomes: list[Outcome], views: dict[str | None, FitView]) -> Mood:
    if any(each.status == "failed" for each in outcomes):
        return "failed"
    if not views:
        return "missing"
    steps = [view.last for view in views.values()]
    sound = all(each.is_sound for step in steps if step for each in step.estimates)
    own: Mood = "fine" if sound and len(views) == len(outcomes) else "warning"
    return worst_mood(own, *(view.whole.mood for view in views.values()))


def _paper_table(outcomes: list[Outcome], views: dict[str | None, FitView]) -> PageTable:
    names = ("c [kPa]", "m [–]", "κ′ [kPa]", "R² [–]")
    top = (
        Cell("site", lead=True, down=2),
        Cell("Mooney-Rivlin type (m = 2)", lead=True, span=4),
        Cell("Ogden type", lead=True, span=4),
    )
    rows = []
    for outcome in outcomes:
        view = views.get(outcome.site)
        why = "the fit failed" if outcome.status == "failed" else "the fit has not been run"
        why = f"{outcome.held_by} failed" if outcome.held_by else why
        cells = [each for key in (MOONEY_RIVLIN, OGDEN) for each in _four(view, key, why)]
        rows.append((Cell(str(outcome.site), lead=True), *cells))
    caption = (
        "Identified parameters. Ψ = c/(2m²) Σ(λᵢᵐ + λᵢ⁻ᵐ − 2) + κ′/2 (J − 1)²; c = 2µ from shear-wave speed"
    )
    return PageTable(caption, (top, head(*names, *names)), tuple(rows))


def _four(view: FitView | None, key: str, why: str) -> list[Cell]:
    step = view.step(key) if view else None
    if step is None:
        return [Cell(DASH, reason=why, span=4)]
    return [
        cell(step.c_kpa),
        with_verdict(cell(step.m), step.estimate("m")),
        with_verdict(cell(step.kappa_kpa), step.kappa),
        cell(step.r2, digits=4, reason="the measured force does not vary"),
    ]


def with_verdict(shown: Cell, estimate: EstimateView | None) -> Cell:
    """Cell of a value; if the data do not determine it, words instead, with the verdict below."""
    if estimate is None or estimate.is_sound:
        return shown
    return replace(shown, text=estimate.headline.text, reason=f"{estimate.name}: {estimate.flag}")


def _details(site: str, view: FitView) -> PageTable:
    """All parameters of all steps: value, interval, flag and computational effort."""
    names = ("type", "parameter", "value", "95 % interval", "verdict")
    rows = []
    for step in view.steps:
        for k, each in enumerate(step.estimates):
            label = (Cell(step.label, lead=True, down=len(step.estimates)),) if k == 0 else ()
            rows.append((*label, *estimate_cells(each)))
    caption = (
        f"Site {site}: confidence interval and identifiability of each parameter ({view.element}, "
        f"{view.solver})"
    )
    return table(caption, names, rows, numeric=False)


def estimates_table(caption: str, estimates: Iterable[EstimateView]) -> PageTable:
    """One row for each parameter of a fit."""
    names = ("parameter", "value", "95 % interval", "verdict")
    return table(caption, names, map(estimate_cells, estimates), numeric=False)


def estimate_cells(each: EstimateView) -> tuple[Cell, ...]:
    """Name, value, 95 % interval and verdict; words without a number have no unit.

    >>> c = EstimateView(name="c", value=50.0, unit="kPa", low=1.0, high=90.0, flag="no influence")
    >>> [cell.text.replace("\u00a0", " ") for cell in estimate_cells(c)]
    ['c', 'not identifiable', '1.00 to 90.0 kPa', 'no influence']
    """
    unit, found = f"\u00a0{each.unit}" if each.unit else "", each.headline
    return (
        Cell(each.name),
        cell(each.value, unit=each.unit) if each.is_sound else Cell(
            found.text + (unit if found.unit else "")
        ),
        Cell(interval_text(each) + unit) if each.low is not None or each.high is not None else Cell(
            DASH, reason=each.interval_why
        ),
        Cell(each.flag, reason=each.words),
    )  # fmt: skip


def interval_text(each: EstimateView) -> str:
    """An interval with at least one known end, without its unit.

    >>> interval_text(EstimateView(name="m", value=4.0, low=3.0, flag="weak"))
    'above\xa03.00'
    """
    return interval((each.low, each.high)).replace(" ", "\u00a0")


def _notes(views: dict[str | None, FitView]) -> tuple[list[str], list[str]]:
    notes, warned = [], []
    for site, view in views.items():
        if view.whole.state == "bad":
            warned.append(f"Site {site}: poor fit: {view.whole.words}.")
        notes.append(f"Site {site}: c is {view.c_source or 'of unknown origin'}.")
        notes += [f"Site {site}, {_effort(step)}" for step in view.steps]
        warned += [f"Site {site}: {text}" for text in _noise_words(view)]
        notes += [f"Site {site}: {text}." for text in [noise_alone(view.raw)] if text]
    elements = {view.element for view in views.values()}
    if "tet4" in elements:
        notes.append(TET4_WORDS)  # its fit warns of it
    if "tet10" in elements:
        notes.append(TET10_WORDS)
    return notes, warned


def _noise_words(view: FitView) -> list[str]:
    """Whether the intervals are based on measured noise, and whether that noise explains the residuals."""
    words = []
    if view.noise_source == "assumed":
        words.append(
            "the measurement noise is assumed, not measured, so the intervals are only as reliable as that "
            "assumption. Repeat a level and state its standard deviation in [site.noise]."
        )
    if view.noise_scale is not None and view.noise_scale > _NOTABLE:
        words.append(
            f"the differences are {significant(view.noise_scale, 2)} times as large as the stated noise "
            f"explains. The intervals were widened accordingly; the model may lack something."
        )
    return words


def _effort(step: StepView) -> str:
    text = f"{step.label}: {_counted(step.n_iterations, 'iteration')}, {_counted(step.n_solves, 'solve')}"
    if step.seconds is not None:
        text += f", {quantity(step.seconds, 's', digits=2)}"
    return text + (f"; it ended because {step.reason}." if step.reason else ".")


def _counted(n: int | None, noun: str) -> str:
    """
    >>> _counted(1, "solve"), _counted(0, "solve"), _counted(None, "solve")
    ('1 solve', '0 solves', '– solves')
    """
    return f"{DASH if n is None else n} {noun}{'' if n == 1 else 's'}"
