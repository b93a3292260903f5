"""Does the shear-wave speed rise with load?"""

from __future__ import annotations

from pathlib import Path

from limbcli.errors import CaseError
from limbcli.measurement.regression import Line
from limbcli.reporting.curves import read_predicted_speeds
from limbcli.reporting.figures.wave_speed import PredictedSpeeds, line_text, wave_speed
from limbcli.reporting.fit_view import read_fit_view
from limbcli.reporting.numbers import DASH, cell, number, quantity
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Cell, Picture, Reportlet, pictures_of, table
from limbcli.results import StageResult

TITLE = "Does the shear-wave speed rise with load, as the model predicts?"
_LOOK = (
    "speeds that rise steadily with load; the speed at zero load gives the stiffness "
    "c = 2µ at rest. Against depth the plot hardly depends on the force zero, on skin or on the mesh"
)
_BAD = (
    "a step or scatter larger than the bars, a speed that falls under load, or bars so tall that "
    "the first level could mean half or double the stiffness (c is proportional to the square of the speed)"
)
_LOOK_PREDICTED = (
    ". The prediction uses the speed at zero load only: it should pass through the other points "
    "too, and the difference maps should show no pattern"
)
_BAD_PREDICTED = (
    ". A prediction that starts with the wrong slope against depth does not point to m (the slope "
    "is purely kinematic: depth zero, anisotropy or a layer); one with too little or too much curvature does"
)


def elastography(page: ReportData, site: SiteMaterial) -> Reportlet:
    """Speed over force with its regression line and R2, and over depth, together with the prediction of the
    fit."""
    key = f"elastography-{site.name}"
    fit = page.outcomes.of("fit", site.name).result
    predicted, warned = _predicted(fit)
    speeds = read_fit_view(fit).speeds if fit else None
    if site.speeds is None and predicted is None:
        why = site.why_no_levels or "The levels of this site have no shear-wave speeds."
        return Reportlet(key, TITLE, "missing", site.name, notes=(why,), warned=warned)
    if site.why_no_line:
        warned += (site.why_no_line,)
    lines = (("force", "N", site.against_force), ("depth", "mm", site.against_depth))
    rows = (_row(name, unit, line, site.why_no_line) for name, unit, line in lines)
    names = ("speed against", "slope", "standard error", "speed at zero [m/s]", "R² [–]", "levels")
    slopes = table(f"Straight lines through the speeds at site {site.name}", names, rows)
    return Reportlet(
        key,
        TITLE,
        speeds.mood if speeds else "warning" if site.why_no_line else "neutral",
        site.name,
        pictures=(_speeds(site, predicted), *_pictures(site, fit)),
        tables=(slopes,) if site.speeds is not None else (),
        look_for=_LOOK + (_LOOK_PREDICTED if predicted else ""),
        bad=_BAD + (_BAD_PREDICTED if predicted else ""),
        notes=_notes(fit) if predicted else (),
        warned=warned,
        answer=speeds.sentence if speeds else "",
    )


def _predicted(fit: StageResult | None) -> tuple[PredictedSpeeds | None, tuple[str, ...]]:
    try:
        return (read_predicted_speeds(fit) if fit else None), ()
    except CaseError as error:
        return None, (f"{error.what}; {error.fix}.",)


def _speeds(site: SiteMaterial, predicted: PredictedSpeeds | None) -> Picture:
    alt = f"Shear-wave speed over probe force and over depth at site {site.name}."
    alt += f" {line_text(site.against_force, 'N')}." if site.against_force else ""
    if predicted is not None:
        ends = predicted.mean_m_per_s[[0, -1]]
        alt += f" The fitted model predicts {ends[0]:.2f} to {ends[1]:.2f} m/s."
    figure = wave_speed(
        site.speeds, against_force=site.against_force, against_depth=site.against_depth, predicted=predicted
    )
    return Picture(f"wave-speed-{site.name}", alt, figure=figure)


def _pictures(site: SiteMaterial, fit: StageResult | None) -> tuple[Picture, ...]:
    """Maps of the fit, if it wrote them."""
    if fit is None:
        return ()
    texts = {
        "swe_maps_picture": f"Shear-wave maps at site {site.name}, level by level, in the probe's frame: "
        "measured where measured, predicted by the fitted model, and the difference.",
        "stiffness_map": f"Section through the model at site {site.name} with the stiffness c of every "
        "element, from the shear-wave map at level 0.",
    }
    names = {key: Path(fit.files[key]).stem for key in texts if key in fit.files}
    return pictures_of(fit, {key: (f"{name}-{site.name}", texts[key]) for key, name in names.items()})


def _notes(fit: StageResult | None) -> tuple[str, ...]:
    """Error of the predicted speeds, and the c used."""
    reported = fit.data.get("swe") if fit else None
    notes = []
    if isinstance(reported, dict) and number(reported.get("rmse_m_per_s")) is not None:
        off = quantity(reported["rmse_m_per_s"], "m/s", digits=2)
        notes.append(f"Under load the predicted mean speed is off by {off} (root mean square over levels).")
    c = fit.data.get("stiffness_map") if fit else None
    if isinstance(c, dict):
        notes.append(
            f"c was taken element by element from {c.get('map')}: {c.get('n_elements_within_image')} of "
            f"{c.get('n_elements')} elements lie within the image; {quantity(c.get('low_kpa'), 'kPa')} to "
            f"{quantity(c.get('high_kpa'), 'kPa')}, median {quantity(c.get('median_kpa'), 'kPa')}."
        )
    return tuple(notes)


def _row(name: str, unit: str, line: Line | None, why: str) -> tuple[Cell, ...]:
    if line is None:
        return (Cell(name, lead=True), *[Cell(DASH, reason=why) for _ in range(5)])
    per = f"m/s per {unit}"
    return (
        Cell(name, lead=True),
        cell(line.slope, unit=per),
        cell(line.slope_se, unit=per, digits=2, reason="needs three levels"),
        cell(line.intercept),
        cell(line.r2, digits=4, reason="the speed does not vary"),
        Cell(str(line.n) if line.n else DASH),
    )
