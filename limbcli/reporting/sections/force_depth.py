"""Does the model reproduce the measured force?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.errors import CaseError
from limbcli.model import Array
from limbcli.reporting.curves import read_curves, read_run_curve
from limbcli.reporting.figures.force_depth import SimulatedCurve, force_depth
from limbcli.reporting.fit_view import FitView, read_fit_view
from limbcli.reporting.numbers import quantity
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Picture, Reportlet, placeholder

TITLE = "Does the model follow the measured force?"
_NO_FIT = (
    "No fit is available: shown are the measured levels, and the simulation with start values if it was run."
)
_R2_CAVEAT = (
    "R² is near 1 for any curve that rises with the data; judge by the residuals in the lower panel, in N."
)


def force_over_depth(page: ReportData, site: SiteMaterial) -> Reportlet:
    """Measured levels with the start, m = 2 and Ogden curves."""
    key = f"force-depth-{site.name}"
    outcome = page.outcomes.of("fit", site.name)
    if site.measured is None:
        return Reportlet(key, TITLE, "failed", site.name, warned=(site.why_no_levels,))
    curves, warned = _curves(page, site)
    notes: list[str] = []
    view = read_fit_view(outcome.result) if outcome.result is not None else None
    measured = site.measured
    if view is not None:
        notes = [
            f"{step.label}: root-mean-square difference over all levels, first touch included, "
            f"{quantity(step.rmse_n, 'N', digits=2)}, R² {quantity(step.r2, '', digits=4)}."
            for step in view.steps
        ]
        notes.append(_R2_CAVEAT)
        measured = replace(measured, counted=_counted(view))
    gap = placeholder(key, TITLE, outcome) if outcome.status != "done" else None
    name = f"force-depth-{site.name}"
    picture = Picture(name, _alt(site, curves), figure=force_depth(measured, curves))
    return Reportlet(
        key,
        TITLE,
        gap.mood if gap else view.force.mood if view else "missing",
        site.name,
        pictures=(picture,),
        look_for="the solid curve passes through the points and the differences scatter around zero, inside "
        "the grey band: one standard deviation of the noise that the fit counted, that of the depth included",
        bad="differences that drift slowly from one side to the other (the model lacks something), a curve "
        "that fits at one end only, or a start curve that already fits (the data are not informative)",
        notes=tuple(notes) if not gap else (_NO_FIT, *gap.notes),
        warned=warned,
        failure=gap.failure if gap else None,
        command=gap.command if gap else "",
        answer=view.force.sentence if view and not gap else "",
    )


def _counted(view: FitView) -> tuple[Array, Array] | None:
    """Depths (mm) of the loaded levels and the noise (N) that the fit counted there, or None."""
    force = (view.raw.get("agreement") or {}).get("force") or {}
    depth, spread = (np.asarray(force.get(name, ()), float) for name in ("depths_mm", "counted_noise_n"))
    return (depth, spread) if depth.size and depth.shape == spread.shape and spread.any() else None


def _curves(page: ReportData, site: SiteMaterial) -> tuple[tuple[SimulatedCurve, ...], tuple[str, ...]]:
    """The curves of the fit or, without one, of the run; and messages about what could not be read."""
    assert site.measured is not None
    fit, run = page.outcomes.of("fit", site.name), page.outcomes.of("run", site.name)
    try:
        if fit.result is not None:
            return read_curves(fit.result, site.measured.depth), ()
        if run.result is not None:
            return (read_run_curve(run.result),), ()
    except CaseError as error:
        return (), (f"{error.what}; {error.fix}.",)
    return (), ()


def _alt(site: SiteMaterial, curves: tuple[SimulatedCurve, ...]) -> str:
    assert site.measured is not None
    depth, force = float(site.measured.depth.max()), float(site.measured.force.max())
    text = (
        f"Probe force over indentation depth at site {site.name}: {site.measured.depth.size} measured levels "
    )
    text += f"up to {force:.1f} N at {depth:.1f} mm"
    return text + (f", with {', '.join(each.label for each in curves)}." if curves else ".")
