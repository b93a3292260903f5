"""Profile likelihood of a quantity that follows from the parameters, such as where a curve is lowest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.inference.levenberg_marquardt import Fit
from limbcli.inference.parameter import FitParameter
from limbcli.inference.profile import best_of
from limbcli.inference.residual import Objective, Residual
from limbcli.interval_limits import THRESHOLD_95
from limbcli.model import Array

_HELD = 1e-3  # how closely the quantity is held, in its own unit
_STEP = 1e-4  # of ln theta, for its slopes


@dataclass(frozen=True)
class DerivedInterval:
    """value at the best fit; low, high: 95 % ends, or where the walk ended if nothing was excluded there."""

    value: float
    low: float
    high: float
    open_low: bool
    open_high: bool


def derived_interval(
    objective: Objective, parameters: Sequence[FitParameter], best: Fit, quantity: Callable[[Array], float],
    *, low: float, high: float, pace: float, scale: float = 1.0, threshold: float = THRESHOLD_95,
) -> DerivedInterval:  # fmt: skip
    """The values of `quantity` that the data do not exclude, between `low` and `high`.

    The quantity is held at values ever further from that of the best fit while all parameters give way, by a
    residual of its own that is not counted.

    objective : residuals in standard deviations; scale : the deviance is divided by it
    threshold : of the deviance at an end (`threshold_95` where the noise may be larger than stated)
    quantity : theta -> a number that changes smoothly with ln theta; pace : of the walk, in its unit

    Source: Venzon and Moolgavkar 1988, Appl. Stat. 37:87, for a function of the parameters.
    """
    value = float(np.clip(quantity(best.theta), low, high))

    def at(target: float, guess: Array) -> tuple[float, Array]:
        def held(theta: Array, derivative: bool = True) -> Residual:
            full, own = objective(theta, derivative), (quantity(theta) - target) / _HELD
            if full.jacobian is None:
                return Residual(np.r_[full.values, own])
            slopes = _slopes(quantity, theta) / _HELD
            return Residual(np.r_[full.values, own], np.vstack([full.jacobian, slopes]))

        fit = best_of(held, parameters, [guess])
        missed = abs(quantity(fit.theta) - target)
        if missed > 10.0 * _HELD:  # no parameters within their bounds make it that
            return np.inf, fit.theta
        return (objective(fit.theta, False).cost - best.cost) / scale, fit.theta

    ends, opens = [], []
    for sign, stop in ((-1.0, low), (1.0, high)):
        inside, theta, is_open = value, best.theta, True
        for _ in range(int(np.ceil(abs(stop - value) / pace))):
            outside = float(np.clip(inside + sign * pace, low, high))
            deviance, moved = at(outside, theta)
            if not np.isfinite(deviance):  # the parameters' bounds end the walk, not the data
                break
            if deviance > threshold:
                inside = _crossing(at, inside, theta, outside, threshold)
                is_open = False
                break
            inside, theta = outside, moved
        ends.append(inside)
        opens.append(is_open)
    return DerivedInterval(value, ends[0], ends[1], opens[0], opens[1])


def _crossing(
    at: Callable[[float, Array], tuple[float, Array]], near: float, theta: Array, far: float, threshold: float
) -> float:
    """Where the deviance meets its threshold between `near`, fitted by theta, and `far`: by halving."""
    for _ in range(4):
        middle = 0.5 * (near + far)
        deviance, moved = at(middle, theta)
        if deviance > threshold:
            far = middle
        else:
            near, theta = middle, moved
    return 0.5 * (near + far)


def _slopes(quantity: Callable[[Array], float], theta: Array) -> Array:
    out = np.zeros(len(theta))
    for k in range(len(theta)):
        up, down = theta.copy(), theta.copy()
        up[k], down[k] = theta[k] * np.exp(_STEP), theta[k] * np.exp(-_STEP)
        out[k] = (quantity(up) - quantity(down)) / (2 * _STEP * theta[k])
    return out
