"""How certain a fit is: standard errors, correlations, and a verdict for each parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limbcli.inference.parameter import FitParameter
from limbcli.inference.profile import Profile
from limbcli.model import Array
from limbcli.numbers.interval_limits import Flag
from limbcli.numbers.significant_digits import short

_NO_INFLUENCE = 1e-3  # relative change of the force by doubling a parameter, below which it has no influence
_WEAK_RATIO = 3.0  # upper over lower end of the interval, above which a parameter is weakly identified
_TRADES_OFF = 0.95  # magnitude of a correlation above which two parameters trade off
_TWO_SIDED = 1.96  # half width of a 95 % interval, in standard errors
_ALIKE = 1e-7  # singular value, relative to the largest, below which a combination changes nothing
_TAKES_PART = 1e-6  # component of such a unit vector above which a parameter belongs to the combination


def force_variance(slope: Array, *, force_deviation: float, depth_deviation: float) -> Array:
    """Variance of the force residual F_exp - F_sim(measured depth).

    sigma_F^2 + (dF/dd sigma_d)^2: force is controlled and depth is the noisy quantity, so the depth error
    enters through the slope of the curve.

    >>> force_variance(np.array([0.0, 4.0]), force_deviation=0.3, depth_deviation=0.1)
    array([0.09, 0.25])
    """
    return force_deviation**2 + (slope * depth_deviation) ** 2


def are_determined(columns: Array) -> NDArray[np.bool_]:
    """Parameters (p,) that the data can distinguish from the others, by the derivatives (n, p) of a
    prediction.

    A parameter without any influence, or whose effect others can reproduce exactly, has no standard error.

    >>> alike = np.array([[1.0, 2.0, 0.0], [2.0, 4.0, 1.0], [3.0, 6.0, 0.0]])
    >>> are_determined(alike).tolist(), are_determined(alike[:, [0, 2]]).tolist()
    ([False, False, True], [True, True])
    """
    lengths = np.linalg.norm(columns, axis=0)
    determined = np.asarray(lengths > 0.0)
    seen = np.flatnonzero(determined)
    if not len(seen):
        return determined
    _, sizes, ways = np.linalg.svd(columns[:, seen] / lengths[seen])
    silent = np.ones(len(seen), dtype=bool)
    silent[: len(sizes)] = sizes <= _ALIKE * sizes[0]
    determined[seen[(np.abs(ways[silent]) > _TAKES_PART).any(axis=0)]] = False
    return determined


def log_covariance(
    sensitivity: Array, variance: Array, *, nuisance: Array | None = None,
    nuisance_deviation: float | Array = 0.0,
) -> Array:  # fmt: skip
    """Covariance (p, p) of ln theta of an unweighted least-squares estimate; NaN where not determined.

    A V A' with A = (S'S)^-1 S' (the sandwich estimator: all residuals weigh the same although their variance
    (n,) differs), plus (A s)(A s)' sigma^2 of each quantity held fixed.

    sensitivity : (n, p) d prediction / d ln theta; nuisance : (n,) or (n, k), the same of what is held fixed
        (c); nuisance_deviation : standard deviation of its ln, or (k,)
    """
    p = sensitivity.shape[1]
    covariance = np.full((p, p), np.nan)
    seen = np.flatnonzero(are_determined(sensitivity))
    estimator = np.linalg.pinv(sensitivity)[seen]
    block = (estimator * variance) @ estimator.T
    if nuisance is not None:
        carried = estimator @ (nuisance * nuisance_deviation).reshape(len(nuisance), -1)
        block = block + carried @ carried.T
    covariance[np.ix_(seen, seen)] = block
    return covariance


def correlation(covariance: Array) -> Array:
    """Correlation matrix; NaN for a parameter whose variance is 0 or unknown.

    >>> correlation(np.array([[4.0, 1.0], [1.0, 1.0]]))
    array([[1. , 0.5], [0.5, 1. ]])
    >>> correlation(np.array([[4.0, 0.0], [0.0, 0.0]]))
    array([[ 1., nan],
           [nan, nan]])
    """
    deviation = np.sqrt(np.diag(covariance))
    deviation = np.where(deviation > 0.0, deviation, np.nan)
    return covariance / np.outer(deviation, deviation)


def has_influence(sensitivity: Array, prediction: Array) -> Array:
    """Whether doubling each parameter moves the prediction by more than 0.1 %: (p,) bool."""
    size = float(np.sqrt(np.mean(prediction**2)))
    effect = np.log(2.0) * np.sqrt(np.mean(sensitivity**2, axis=0))
    return effect > _NO_INFLUENCE * size


@dataclass(frozen=True)
class Verdict:
    """`flag`: a `Flag`, or "trades off with X"; `words`: why; `bound`: "lower" or "upper", if at one."""

    flag: str
    words: str
    bound: str = ""


@dataclass(frozen=True)
class NoProfile:
    """Why there is no profile; log_deviation : standard error of ln theta, NaN if unknown."""

    why: str = "no interval was computed"
    log_deviation: float = np.nan


def verdict(
    parameter: FitParameter, value: float, profile: Profile | NoProfile, *, influence: bool,
    correlations: Sequence[tuple[str, float]] = (), unit: str = "",
) -> Verdict:  # fmt: skip
    """Classification of a parameter, and the sentence that explains it, with numbers in `unit`.

    influence : whether the parameter changes the force at this value; even where it does not, other values
        may be excluded
    correlations : (other parameter, correlation) of the logs
    """
    name = parameter.name
    if not influence and (isinstance(profile, NoProfile) or (profile.open_low and profile.open_high)):
        return Verdict(
            Flag.NO_INFLUENCE,
            f"{name} has no influence on the force here (less than 0.1 % for a doubling): not identifiable.",
        )
    side = parameter.at_bound(value)
    excluded = profile.why if isinstance(profile, NoProfile) else _excluded(parameter, profile, unit)
    unit = unit and f" {unit}"
    if side:
        which, bound = ("lower", parameter.low) if side == "low" else ("upper", parameter.high)
        return Verdict(
            Flag.AT_BOUND, f"{name} ended on its {which} bound {bound:g}{unit}; {excluded}.", which
        )
    if isinstance(profile, NoProfile):
        return _without_profile(name, value, profile.log_deviation, profile.why)
    wide = profile.is_open or profile.high / profile.low > _WEAK_RATIO
    partner = max(correlations, key=lambda each: abs(each[1]), default=("", 0.0))
    if wide and abs(partner[1]) > _TRADES_OFF:
        text = f"{name} trades off with {partner[0]} (correlation {partner[1]:+.2f}): the data determine a"
        return Verdict(f"{Flag.TRADES_OFF} {partner[0]}", f"{text} combination of the two; {excluded}.")
    if profile.is_open:
        return Verdict(Flag.WEAK, f"{name} is not identifiable from these data: {excluded}.")
    if wide:
        return Verdict(Flag.WEAK, f"{name} is only weakly identified: {excluded}.")
    return Verdict(
        Flag.IDENTIFIED,
        f"{name} is identified: {short(profile.low, 4)} to {short(profile.high, 4)}{unit} (95 %).",
    )


def _without_profile(name: str, value: float, log_deviation: float, why: str) -> Verdict:
    """Verdict from the standard error alone or, without one, a statement that the uncertainty is unknown."""
    if not np.isfinite(log_deviation):
        return Verdict(Flag.WEAK, f"{name} = {short(value, 4)}; its uncertainty cannot be determined: {why}.")
    reach = float(np.exp(min(2 * _TWO_SIDED * log_deviation, 50.0)))
    flag = Flag.IDENTIFIED if reach <= _WEAK_RATIO else Flag.WEAK
    share = 100.0 * log_deviation
    return Verdict(flag, f"{name} = {short(value, 4)}, standard error {short(share, 2)} %; {why}.")


def _excluded(parameter: FitParameter, profile: Profile, unit: str = "") -> str:
    """The values that the data exclude, in words."""
    unit = unit and f" {unit}"
    below, above = f"below {short(profile.low)}{unit}", f"above {short(profile.high)}{unit}"
    if profile.open_low and profile.open_high:
        return f"the data exclude no value between {parameter.low:g} and {parameter.high:g}{unit}"
    if profile.open_high:
        return f"the data exclude only values {below} (95 %)"
    if profile.open_low:
        return f"the data exclude only values {above} (95 %)"
    return f"the data exclude values {below} and {above} (95 %)"
