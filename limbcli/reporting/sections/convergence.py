"""Did the identification, and the solver in it, converge?"""

from __future__ import annotations

from collections.abc import Mapping

from limbcli.numbers.interval_limits import THRESHOLD_95
from limbcli.numbers.significant_digits import significant
from limbcli.reporting.figures.convergence import fit_walk, newton_residuals
from limbcli.reporting.fit_view import OGDEN, StepView, read_fit_view
from limbcli.reporting.numbers import number
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Picture, Reportlet, pictures_of
from limbcli.reporting.sections.assumed_geometry import SYMBOLS
from limbcli.reporting.sections.of_stage import of_stage
from limbcli.reporting.sections.parameters import interval_text
from limbcli.results import StageResult


@of_stage("fit", "convergence", "Did the identification converge?")
def convergence(result: StageResult, _: ReportData, site: SiteMaterial) -> Reportlet:
    """Misfit and parameters by iteration of the search; the solver's residuals if recorded."""
    view = read_fit_view(result)
    pictures = []
    if view.walks:
        alt = f"Misfit and parameters of site {site.name} over the iterations of the search."
        pictures.append(Picture(f"convergence-{site.name}", alt, figure=fit_walk(view.walks)))
    if site.residuals is not None and site.residuals.ratio.size:
        alt = f"The solver's residual at site {site.name}, iteration by iteration, with its target."
        pictures.append(Picture(f"newton-{site.name}", alt, figure=newton_residuals(site.residuals)))
    return Reportlet(
        mood="neutral" if pictures else "missing",
        pictures=tuple(pictures),
        look_for="a misfit that falls and then stays flat, and parameters that settle",
        bad="a parameter that is still moving at the last iteration or runs to the edge of its panel, or "
        "a solver residual that stays above its target",
        notes=() if pictures else ("The result contains no record of the iterations.",),
    )


@of_stage("fit", "profiles", "How well do the data constrain each parameter?", silent=True)
def profiles(result: StageResult, _: ReportData, site: SiteMaterial) -> Reportlet | None:
    """Profile likelihoods computed by the fit, or None if there are none."""
    alt = f"Profile likelihood of each parameter of site {site.name}; the shaded range is its 95 % interval."
    pictures = pictures_of(result, {"profiles": (f"profiles-{site.name}", alt)})
    if not pictures:
        return None
    step = read_fit_view(result).last
    return Reportlet(
        mood="fine" if step and all(each.is_sound for each in step.estimates) else "warning",
        pictures=pictures,
        look_for="a valley with steep sides around the fitted value: the data exclude values beyond the "
        "shaded range (the curve weights the levels by their noise, the published fit weights them "
        "equally, so the minimum may lie beside the fitted value)",
        bad="a curve that stays below the 95 % line on one side of its panel: the data exclude "
        "nothing in that direction, and the fitted value is where the search happened to stop",
        notes=_limit_words(result),
        answer=_told(step),
    )


def _told(step: StepView | None) -> str:
    """Each parameter with the interval that the picture shows, and its verdict."""
    shown = [
        f"{each.name}: {interval_text(each)} (95 %), {each.flag}"
        if each.low is not None or each.high is not None
        else f"{each.name}: no value is excluded, {each.flag}"
        for each in (step.estimates if step else ())
        if each.flag != "fixed"
    ]
    return f"{'; '.join(shown)}." if shown else ""


def _limit_words(result: StageResult) -> tuple[str, ...]:
    """Why the limit is not that of chi-square, and where an interval reaches beyond its curve's crossing."""
    found = result.value(f"steps/{OGDEN}/profiles")
    if not isinstance(found, Mapping) or not found:
        return ()
    profiles = {name: each for name, each in found.items() if isinstance(each, Mapping)}
    limit = next((number(each.get("limit")) for each in profiles.values()), None)
    times, n = number(result.value("noise_scale")), result.value("n_freedom")
    words = ["The interval of each parameter is where its curve lies below the limit."]
    if limit is not None and limit > 1.01 * THRESHOLD_95:
        larger = f" {significant(times, 2)} times" if times is not None and times > 1.0 else ""
        words.append(
            f"The limit is {limit:.2f} instead of {THRESHOLD_95:.2f}, because the data scatter{larger} as "
            f"much as the stated noise explains and only {n} degrees of freedom tell how large the noise is."
        )
    beyond = [SYMBOLS.get(name, name) for name, each in profiles.items() if each.get("extended_to_fit")]
    if beyond:
        words.append(
            f"For {' and '.join(beyond)} the interval is extended to the value of the published fit "
            "(dotted), which lies where the curve is above the limit."
        )
    return tuple(words)
