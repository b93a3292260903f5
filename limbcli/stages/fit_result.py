"""What `fit` leaves: the numbers of fit.json, the curves, the pictures."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Site
from limbcli.inference.adaptive import Intervals
from limbcli.inference.identify import MOONEY_RIVLIN, OGDEN, FittedStep, ForceDepth, sensitivities
from limbcli.inference.interpolation import pchip_sample
from limbcli.inference.interval import Stiffness
from limbcli.inference.prediction import Memory, slopes_at
from limbcli.inference.uncertainty import (
    Verdict,
    correlation,
    force_variance,
    has_influence,
    log_covariance,
    verdict,
)
from limbcli.model import Array, LimbModel
from limbcli.reporting.figures.force_depth import MeasuredCurve, SimulatedCurve, force_depth
from limbcli.results import StageWriter
from limbcli.solvers.base import Simulation
from limbcli.stages.fit_exports import leave_exports, parameter_rows
from limbcli.units import kpa_from_mpa

NAMES = ("f_kappa", "m")
_FINE = 120
_TOP = (
    "c_kpa", "f_kappa", "kappa_kpa", "m", "r2", "rmse_n",
    "standard_error", "interval_95", "flags", "words",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Identified:
    """Everything the two steps found, before it is written down."""

    curve: Memory
    knots: Array
    data: ForceDepth
    stiffness: Stiffness
    c_source: str
    start: Array
    steps: Sequence[FittedStep]
    intervals: Sequence[Intervals] | None
    cold_seconds: float
    why_no_intervals: str = "no interval was asked for"

    def simulated(self, theta: Array, depths: Array) -> Array:
        values = self.curve(theta).values
        return pchip_sample(np.r_[0.0, self.knots], np.r_[0.0, values], depths).values


def leave_result(
    found: Identified, fitted: LimbModel, simulation: Simulation, writer: StageWriter, site: Site, *,
    seconds: float,
) -> None:  # fmt: skip
    """Fill fit.json, curves.csv and the pictures."""
    tables = {step.name: step_table(found, k) for k, step in enumerate(found.steps)}
    last = tables[OGDEN]
    top = (
        "c_kpa",
        "f_kappa",
        "kappa_kpa",
        "m",
        "r2",
        "rmse_n",
        "standard_error",
        "interval_95",
        "flags",
        "words",
    )
    writer.data.update({key: last[key] for key in top})
    writer.data.update(
        law="ogden type", objective="force", element=_element(fitted),
        solver=simulation.solver, solver_version=simulation.version,
        linear_solver=simulation.linear_solver, c_source=found.c_source,
        c_deviation_fraction=found.stiffness.log_deviation,
        numerical_error_fraction=found.stiffness.gain_deviation,
        correlation=last["correlations"], steps=tables,
        n_iterations=sum(step.fit.n_iterations for step in found.steps),
        n_solves=sum(step.n_solves for step in found.steps) + 1,
        n_interval_solves=sum(each.n_solves for each in found.intervals or ()),
        seconds=seconds, cold_solve_seconds=found.cold_seconds,
        identification_seconds=found.cold_seconds + sum(step.seconds for step in found.steps),
        n_levels=len(found.data.force),
        noise={"force_n": site.noise.force, "depth_mm": site.noise.depth,
               "swe_level_fraction": site.noise.swe_level_fraction,
               "swe_pixel_fraction": site.noise.swe_pixel_fraction, "source": site.noise.source},
        variance="force residual: sigma_F^2 + (dF/dd sigma_d)^2",
    )  # fmt: skip
    if found.intervals:
        best = found.intervals[-1]
        writer.data["chi_square"], writer.data["n_freedom"] = best.chi_square, best.n_freedom
        writer.data["noise_scale"] = float(np.sqrt(best.scale))
        writer.data["most_likely"] = dict(
            zip(("c_kpa", *NAMES), (kpa_from_mpa(float(best.best[0])), *best.best[1:]), strict=True)
        )
        _warn_unsolved(best, writer)
    write_curves(found, writer.file("curves", "curves.csv"))
    rows = [
        row for name, each in tables.items() for row in parameter_rows(site.name, name, each["parameters"])
    ]
    leave_exports(writer, rows, writer.data, fitted)
    draw_fit(found, site, writer)
    _summarise(found, last, writer)


def step_table(found: Identified, k: int) -> dict[str, Any]:
    """One step of the identification as plain values, keys with units."""
    step, c = found.steps[k], found.stiffness.c
    f_kappa, m = (float(each) for each in step.theta)
    covariance = total_covariance(found, step)
    deviation = np.sqrt(np.diag(covariance))
    verdicts = _verdicts(found, k, covariance)
    values = {"c_kpa": kpa_from_mpa(c), "f_kappa": f_kappa, "m": m, "kappa_kpa": kpa_from_mpa(c * f_kappa)}
    errors = {
        "c_kpa": values["c_kpa"] * deviation[0],
        "f_kappa": f_kappa * deviation[1],
        "m": m * deviation[2],
    }
    spread = covariance[0, 0] + covariance[1, 1] + 2 * covariance[0, 1]
    errors["kappa_kpa"] = values["kappa_kpa"] * float(np.sqrt(spread))
    intervals = _intervals(found, k, values["c_kpa"])
    rho = correlation(covariance)
    searched = [parameter.name for parameter in step.fit.parameters]
    return {
        **values,
        "r2": step.r2, "rmse_n": step.rmse, "cost_n2": step.fit.cost, "reason": step.fit.reason,
        "n_iterations": step.fit.n_iterations, "n_solves": step.n_solves, "seconds": step.seconds,
        "standard_error": errors,
        "interval_95": intervals,
        "correlation": float(rho[1, 2]),
        "correlations": {"f_kappa,m": rho[1, 2], "c,f_kappa": rho[0, 1], "c,m": rho[0, 2]},
        "flags": {name: each.flag for name, each in verdicts.items()},
        "words": {name: each.words for name, each in verdicts.items()},
        "parameters": {
            name: _parameter(found, values[name], intervals.get(name), verdicts[name], errors[name])
            for name in ("c_kpa", *NAMES) if name in verdicts
        },
        "profiles": _profiles(found, k),
        "history": [
            {"cost_n2": each.cost, **dict(zip(searched, each.theta, strict=True))}
            for each in step.fit.history
        ],
    }  # fmt: skip


def total_covariance(found: Identified, step: FittedStep) -> Array:
    """Covariance (3, 3) of ln c, ln f_kappa, ln m; NaN for what was not searched or not seen."""
    answer = sensitivities(found.curve, found.knots, found.data, step.theta)
    assert answer.jacobian is not None
    depth = found.data.depth[found.data.loaded]
    slope = slopes_at(found.curve, found.knots, depth, step.theta)
    variance = force_variance(
        slope, force_deviation=found.data.force_deviation, depth_deviation=found.data.depth_deviation
    )
    free = _inside(step)
    columns = answer.jacobian[:, free]
    sigma, sigma_c = found.stiffness.force_deviation, found.stiffness.log_deviation
    covariance = np.full((3, 3), np.nan)
    covariance[0, 0] = sigma_c**2
    if not free:
        return covariance
    if not variance.any():  # without stated noise there is no standard error
        return covariance
    block = log_covariance(columns, variance, nuisance=answer.values, nuisance_deviation=sigma)
    places = [1 + k for k in free]
    covariance[np.ix_(places, places)] = block
    if np.isfinite(block).all():
        carried = -(sigma_c**2) * np.linalg.pinv(columns) @ answer.values
        covariance[0, places] = covariance[places, 0] = carried
    return covariance


def _inside(step: FittedStep) -> list[int]:
    """The searched parameters that did not end on a bound."""
    pairs = zip(step.free, step.fit.parameters, step.fit.theta, strict=True)
    return [k for k, parameter, value in pairs if parameter.at_bound(float(value)) is None]


def _verdicts(found: Identified, k: int, covariance: Array) -> dict[str, Verdict]:
    step = found.steps[k]
    answer = sensitivities(found.curve, found.knots, found.data, step.theta)
    assert answer.jacobian is not None
    influence = has_influence(answer.jacobian, answer.values)
    rho = np.nan_to_num(correlation(covariance))
    verdicts = {"c_kpa": Verdict("fixed", f"c is held fixed: {found.c_source}.")}
    for parameter, index in zip(step.fit.parameters, step.free, strict=True):
        profile = found.intervals[k].profiles.get(parameter.name) if found.intervals else None
        others = [("c", rho[1 + index, 0])]
        others += [(NAMES[j], rho[1 + index, 1 + j]) for j in step.free if j != index]
        verdicts[parameter.name] = verdict(
            parameter, float(step.theta[index]), profile,
            influence=bool(influence[index]), correlations=others,
            log_deviation=float(np.sqrt(covariance[1 + index, 1 + index])),
            why_no_profile=found.why_no_intervals,
        )  # fmt: skip
    return verdicts


def _intervals(found: Identified, k: int, c_kpa: float) -> dict[str, list[float | None]]:
    """[low, high] by parameter; None where the data exclude nothing up to the bound."""
    sigma = found.stiffness.log_deviation
    intervals: dict[str, list[float | None]] = {
        "c_kpa": [c_kpa * float(np.exp(-1.96 * sigma)), c_kpa * float(np.exp(1.96 * sigma))]
    }
    for name, profile in (found.intervals[k].profiles if found.intervals else {}).items():
        intervals[name] = [
            None if profile.open_low else profile.low, None if profile.open_high else profile.high
        ]  # fmt: skip
    return intervals


def _parameter(
    found: Identified, value: float, interval: Sequence[float | None] | None, said: Verdict, error: float
) -> dict[str, Any]:
    low, high = interval or (None, None)
    reason = "open to both bounds: nothing is excluded" if interval else found.why_no_intervals
    return {
        "value": value, "low": low, "high": high, "standard_error": error,
        "interval_reason": reason if low is None and high is None else "",
        "flag": said.flag, "words": said.words,
    }  # fmt: skip


def _profiles(found: Identified, k: int) -> dict[str, dict[str, Array]]:
    """The profile likelihoods: values, and the rise of -2 ln likelihood there."""
    profiles = found.intervals[k].profiles if found.intervals else {}
    return {name: {"values": each.values, "deviance": each.deviance} for name, each in profiles.items()}


def _warn_unsolved(best: Intervals, writer: StageWriter) -> None:
    for theta in best.unsolved:
        writer.warnings.append(
            f"no simulation converged at f_kappa {theta[0]:.3g}, m {theta[1]:.3g}: "
            "the intervals stop before it and are marked open there"
        )


def write_curves(found: Identified, path: Path) -> None:
    """curves.csv: measured force where measured, and the simulated curves at first guess and steps."""
    depths = np.unique(np.r_[np.linspace(0.0, found.knots[-1], _FINE), np.maximum(found.data.depth, 0.0)])
    thetas = [found.start, *(step.theta for step in found.steps)]
    curves = [found.simulated(theta, depths) for theta in thetas]
    measured = {float(d): f for d, f in zip(np.maximum(found.data.depth, 0.0), found.data.force, strict=True)}
    with path.open("w", newline="", encoding="utf-8") as stream:
        rows = csv.writer(stream)
        rows.writerow(["depth_mm", "measured_n", "start_n", f"{MOONEY_RIVLIN}_n", f"{OGDEN}_n"])
        for k, depth in enumerate(depths):
            force = measured.get(float(depth))
            simulated = [f"{each[k]:.6g}" for each in curves]
            rows.writerow([f"{depth:.6g}", "" if force is None else f"{force:.6g}", *simulated])


def draw_fit(found: Identified, site: Site, writer: StageWriter) -> None:
    """fit.png: measured levels, the curves, what is left between; profiles.png where computed."""
    from limbcli.reporting.figures.profiles import ProfileCurve, profile_figure

    depths = np.linspace(0.0, found.knots[-1], _FINE)
    labels = ("start (f_κ 100, m 2)", "Mooney-Rivlin type (m = 2)", "Ogden type")
    thetas = [found.start, *(step.theta for step in found.steps)]
    curves = [
        SimulatedCurve(key, label, depths, found.simulated(theta, depths))
        for key, label, theta in zip(("start", MOONEY_RIVLIN, OGDEN), labels, thetas, strict=True)
    ]
    measured = MeasuredCurve(found.data.depth, found.data.force, site.noise.depth, site.noise.force)
    force_depth(measured, curves).savefig(writer.file("picture", "fit.png"))
    if not found.intervals:
        return
    profiles = [
        ProfileCurve(name, each.values, each.deviance, float(value))
        for (name, each), value in zip(
            found.intervals[-1].profiles.items(), found.steps[-1].theta, strict=True
        )
    ]
    profile_figure(profiles).savefig(writer.file("profiles", "profiles.png"))


def _summarise(found: Identified, last: Mapping[str, Any], writer: StageWriter) -> None:
    writer.summary.append(f"c = {last['c_kpa']:.2f} kPa, held fixed ({found.c_source})")
    for name in NAMES:
        words = _interval_words(last["interval_95"].get(name))
        writer.summary.append(f"{name} = {last[name]:.4g} ({words}): {last['flags'][name]}")
    first = found.steps[0]
    writer.summary.append(
        f"R2 {last['r2']:.4f}, RMSE {last['rmse_n']:.3f} N (m = 2: f_kappa {first.theta[0]:.4g}, "
        f"R2 {first.r2:.4f}); {writer.data['n_iterations']} iterations, {writer.data['n_solves']} solves"
    )
    error = 100 * found.stiffness.gain_deviation
    writer.summary.append(f"counted as uncertainty of the simulated force: {error:.2g} % by the mesh")
    if "tet4" in writer.data["element"]:
        writer.warnings.append(
            "linear tetrahedra lock: f_kappa is a property of this mesh as much as of the tissue, and its "
            "interval holds on this mesh; tet10 elements do not lock (--compare-element shows both)"
        )
    for name in NAMES:
        if last["flags"][name] not in ("identified", "fixed"):
            writer.warnings.append(last["words"][name])


def _interval_words(interval: Sequence[float | None] | None) -> str:
    """
    >>> _interval_words([47.6, None]), _interval_words(None)
    ('95 %: 47.6 to open', 'no interval')
    """
    if interval is None:
        return "no interval"
    low, high = ("open" if each is None else f"{each:.3g}" for each in interval)
    return f"95 %: {low} to {high}"


def _element(model: LimbModel) -> str:
    return "+".join(sorted({block.kind for block in model.mesh.solid_blocks}))
