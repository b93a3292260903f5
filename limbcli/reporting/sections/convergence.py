"""Did the identification, and the solver in it, converge?"""

from __future__ import annotations

from limbcli.reporting.figures.convergence import fit_walk, newton_residuals
from limbcli.reporting.fit_view import read_fit_view
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Picture, Reportlet, placeholder

TITLE = "Did the identification converge?"


def convergence(page: ReportData, site: SiteMaterial) -> Reportlet:
    """Misfit and parameters by iteration of the search; the solver's residuals if recorded."""
    key = f"convergence-{site.name}"
    outcome = page.outcomes.of("fit", site.name)
    result = outcome.usable
    if result is None:
        return placeholder(key, TITLE, outcome)
    view = read_fit_view(result)
    pictures = []
    if view.walks:
        alt = f"Misfit and parameters of site {site.name} over the iterations of the search."
        pictures.append(Picture(f"convergence-{site.name}", alt, figure=fit_walk(view.walks)))
    if site.residuals is not None and site.residuals.ratio.size:
        alt = f"The solver's residual at site {site.name}, iteration by iteration, with its target."
        pictures.append(Picture(f"newton-{site.name}", alt, figure=newton_residuals(site.residuals)))
    return Reportlet(
        key,
        TITLE,
        "neutral" if pictures else "missing",
        site.name,
        pictures=tuple(pictures),
        look_for="a misfit that falls and then stays flat, and parameters that settle",
        bad="a parameter that is still moving at the last iteration or runs to the edge of its panel, or "
        "a solver residual that stays above its target",
        notes=() if pictures else ("The result contains no record of the iterations.",),
    )


PROFILES_TITLE = "How well do the data constrain each parameter?"


def profiles(page: ReportData, site: SiteMaterial) -> Reportlet | None:
    """Profile likelihoods computed by the fit, or None if there are none."""
    result = page.outcomes.of("fit", site.name).usable
    if result is None or "profiles" not in result.files:
        return None
    path = result.path("profiles")
    if not path.is_file():
        return None
    alt = f"Profile likelihood of each parameter of site {site.name}; the shaded range is its 95 % interval."
    return Reportlet(
        f"profiles-{site.name}",
        PROFILES_TITLE,
        "fine",
        site.name,
        pictures=(Picture(f"profiles-{site.name}", alt, source=path, vector=False),),
        look_for="a valley with steep sides around the fitted value: the data exclude values beyond the "
        "shaded range (the curve weights the levels by their noise, the published fit weights them "
        "equally, so the minimum may lie beside the fitted value)",
        bad="a curve that stays below the 95 % line on one side of its panel: the data exclude "
        "nothing in that direction, and the fitted value is where the search happened to stop",
    )
