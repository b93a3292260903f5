"""The numbers of fit.json: values, standard errors, intervals and verdicts of each step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from limbcli.inference.adaptive import Intervals
from limbcli.inference.agreement import FitAgreement, force_agreement
from limbcli.inference.geometry_uncertainty import ends, shifts
from limbcli.inference.identifiability import (
    NoProfile,
    Verdict,
    correlation,
    has_influence,
    log_covariance,
    verdict,
)
from limbcli.inference.profile_intervals import Stiffness
from limbcli.inference.two_step_fit import CurveMatch, FittedStep, sensitivities
from limbcli.model import Array
from limbcli.numbers.interval_limits import Flag
from limbcli.numbers.units import kpa_from_mpa
from limbcli.reporting.headline import headline

NAMES = ("f_kappa", "m")
_LEAST_EXPECTED = 0.5  # lower limit of the expected chi-square: with as many parameters as levels it is 0


@dataclass(frozen=True, eq=False)
class Identified(CurveMatch):
    """All results of the two steps.

    modes : changes of ln force (n_modes, n_knots), one standard deviation each, by what is not known of the
    model's geometry and boundaries
    known : c with its uncertainty, and the numerical error of ln force, at each step
    """

    known: Sequence[Stiffness]
    c_source: str
    start: Array
    steps: Sequence[FittedStep]
    intervals: Sequence[Intervals] | None
    cold_seconds: float
    why_no_intervals: str = "no interval was requested"
    modes: Array | None = None

    @property
    def stiffness(self) -> Stiffness:
        return self.known[-1]

    def gain_of(self, step: FittedStep) -> float:
        """Numerical error of ln force at the step's parameters, one standard deviation."""
        return self.known[self.place(step)].gain_deviation

    def place(self, step: FittedStep) -> int:
        return next(k for k, each in enumerate(self.steps) if each is step)


def step_table(found: Identified, k: int) -> dict[str, Any]:
    """One step of the identification as plain values; keys contain the units."""
    step, c = found.steps[k], found.stiffness.c
    f_kappa, m = (float(each) for each in step.theta)
    covariance = total_covariance(found, step)
    deviation = np.sqrt(np.diag(covariance))
    verdicts = _verdicts(found, k, covariance)
    values = {"c_kpa": kpa_from_mpa(c), "f_kappa": f_kappa, "m": m, "kappa_kpa": kpa_from_mpa(c * f_kappa)}
    errors = {name: values[name] * each for name, each in zip(("c_kpa", *NAMES), deviation, strict=True)}
    spread = covariance[0, 0] + covariance[1, 1] + 2 * covariance[0, 1]
    errors["kappa_kpa"] = values["kappa_kpa"] * float(np.sqrt(spread))
    intervals = _intervals(found, k, values["c_kpa"])
    rho = correlation(covariance)
    searched = [parameter.name for parameter in step.fit.parameters]
    return {
        **values,
        "r2": step.r2, "rmse_n": step.rmse, "cost_n2": step.fit.cost, "reason": step.fit.reason,
        "n_iterations": step.fit.n_iterations, "n_solves": step.n_solves, "seconds": step.seconds,
        "numerical_error_fraction": found.gain_of(step),
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
            {"cost_n2": cost, **dict(zip(searched, theta, strict=True))} for theta, cost in step.fit.history
        ],
    }  # fmt: skip


def total_covariance(found: Identified, step: FittedStep) -> Array:
    """Covariance (3, 3) of ln c, ln f_kappa, ln m, with the noise scaled as for the intervals; NaN for
    parameters not searched or without influence."""
    answer = sensitivities(found, step.theta)
    variance = found.variance(step.theta)
    free = inside(step)
    columns = answer.slopes[:, free]
    sigma_c = found.stiffness.log_deviation
    by_c = answer.values * found.stiffness.share_at_levels(found)
    covariance = np.full((3, 3), np.nan)
    covariance[0, 0] = sigma_c**2
    if not free:
        return covariance
    if not variance.any():  # without stated noise there is no standard error
        return covariance
    held = np.column_stack([by_c, answer.values])  # by ln c, and by an error common to all forces
    deviations = np.array([sigma_c, found.gain_of(step)])
    variance = variance * _noise_scale(found, step, columns, variance, held * deviations)
    block = log_covariance(columns, variance, nuisance=held, nuisance_deviation=deviations)
    if found.modes is not None:
        moved = shifts(columns, found.moved(step.theta, found.modes))
        block = block + moved.T @ moved
    places = [1 + k for k in free]
    covariance[np.ix_(places, places)] = block
    if np.isfinite(block).all():
        carried = -(sigma_c**2) * np.linalg.pinv(columns) @ by_c
        covariance[0, places] = covariance[places, 0] = carried
    return covariance


def _noise_scale(found: Identified, step: FittedStep, columns: Array, variance: Array, held: Array) -> float:
    """Factor by which the noise's variance exceeds the stated one: that of the intervals, else by the
    residuals over those that an unweighted fit leaves of the noise and of `held` (n, k), N, one deviation of
    each quantity held fixed. columns (n, p) : sensitivities"""
    if found.intervals:
        return found.intervals[found.place(step)].scale
    left = np.eye(len(variance)) - columns @ np.linalg.pinv(columns)
    expected = np.diag(left @ (np.diag(variance) + held @ held.T) @ left.T)
    chi_square = np.sum(step.fit.residual[found.data.loaded] ** 2 / variance)
    return max(1.0, float(chi_square / max(np.sum(expected / variance), _LEAST_EXPECTED)))


def step_agreement(found: Identified, step: FittedStep) -> FitAgreement:
    """FitAgreement of a step's curve with the measured forces, by the noise that the fit counted."""
    order = np.argsort(found.data.loaded_depth, kind="stable")
    residual = step.fit.residual[found.data.loaded][order]
    intervals = found.intervals[found.place(step)] if found.intervals else None
    return force_agreement(
        residual, counted_deviation(found, step)[order], step.r2, n_free=len(step.free),
        likelihood=(intervals.chi_square, intervals.n_freedom) if intervals else None,
    )  # fmt: skip


def counted_deviation(found: Identified, step: FittedStep) -> Array:
    """Standard deviation of the force (n,), N, that the fit counted at the loaded levels."""
    return np.sqrt(found.variance(step.theta))


def inside(step: FittedStep) -> list[int]:
    """The searched parameters that did not end on a bound."""
    pairs = zip(step.free, step.fit.parameters, step.fit.theta, strict=True)
    return [k for k, parameter, value in pairs if parameter.at_bound(float(value)) is None]


def _verdicts(found: Identified, k: int, covariance: Array) -> dict[str, Verdict]:
    step = found.steps[k]
    answer = sensitivities(found, step.theta)
    influence = has_influence(answer.slopes, answer.values)
    rho = np.nan_to_num(correlation(covariance))
    verdicts = {"c_kpa": Verdict(Flag.FIXED, f"c is held fixed: {found.c_source}.")}
    for parameter, index in zip(step.fit.parameters, step.free, strict=True):
        own = found.intervals[k].profiles.get(parameter.name) if found.intervals else None
        error = float(np.sqrt(covariance[1 + index, 1 + index]))
        others = [("c", rho[1 + index, 0])]
        others += [(NAMES[j], rho[1 + index, 1 + j]) for j in step.free if j != index]
        verdicts[parameter.name] = verdict(
            parameter, float(step.theta[index]),
            NoProfile(found.why_no_intervals, error) if own is None else own,
            influence=bool(influence[index]), correlations=others,
        )  # fmt: skip
    return verdicts


def _intervals(found: Identified, k: int, c_kpa: float) -> dict[str, list[float | None]]:
    """[low, high] by parameter; None where the interval is open up to the parameter's bound."""
    sigma = found.stiffness.log_deviation
    intervals: dict[str, list[float | None]] = {
        "c_kpa": [c_kpa * float(np.exp(-1.96 * sigma)), c_kpa * float(np.exp(1.96 * sigma))]
    }
    return intervals | (ends(found.intervals[k]) if found.intervals else {})


def _parameter(
    found: Identified, value: float, interval: Sequence[float | None] | None, verdict: Verdict, error: float
) -> dict[str, Any]:
    low, high = interval or (None, None)
    reason = "open to both bounds: no value is excluded" if interval else found.why_no_intervals
    return {
        "value": value, "low": low, "high": high, "standard_error": error,
        "headline": str(headline(
            value, low, high, verdict.flag, bound=verdict.bound, computed=interval is not None
        )),
        "interval_reason": reason if low is None and high is None else "",
        "flag": verdict.flag, "bound": verdict.bound, "words": verdict.words,
    }  # fmt: skip


def _profiles(found: Identified, k: int) -> dict[str, dict[str, Any]]:
    """The profile likelihoods: values, deviance, its limit at 95 %, and whether the interval was extended to
    the published fit, where the curve is above that limit."""
    if not found.intervals:
        return {}
    limit = found.intervals[k].threshold
    return {
        name: {
            "values": each.values, "deviance": each.deviance, "limit": limit,
            "extended_to_fit": each.ends_beyond(limit),
        }
        for name, each in found.intervals[k].profiles.items()
    }  # fmt: skip
