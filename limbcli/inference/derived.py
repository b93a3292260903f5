"""Profile likelihood of a quantity derived from the parameters, such as the position of a curve's minimum."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from limbcli.inference.least_squares import Fit
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import Objective, Residual
from limbcli.inference.profile import best_of, walk
from limbcli.model import Array
from limbcli.numbers.interval_limits import THRESHOLD_95

_HELD = 1e-3  # standard deviation of the penalty that constrains the quantity, in its own unit
_STEP = 1e-4  # finite-difference step in ln theta for the quantity's derivatives


@dataclass(frozen=True)
class DerivedInterval:
    """Value at the best fit, and ends of its 95 % interval; the last reached where nothing is excluded."""

    value: float
    low: float
    high: float
    open_low: bool
    open_high: bool


def derived_interval(
    objective: Objective, parameters: Sequence[FitParameter], best: Fit, quantity: Callable[[Array], float],
    low: float, high: float, pace: float, *, scale: float = 1.0, threshold: float = THRESHOLD_95,
) -> DerivedInterval:  # fmt: skip
    """Interval of the values of `quantity` (of theta, smooth in ln theta), between low and high, that the
    data do not exclude: it is held ever farther from its best-fit value, by steps of `pace`, with all
    parameters refitted. The penalty that holds it does not enter the deviance.

    objective : residuals in standard deviations; scale, threshold : as of `profile_likelihood`

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
        if missed > 10.0 * _HELD:  # no parameters within their bounds give this value
            return np.inf, fit.theta
        return (objective(fit.theta, False).cost - best.cost) / scale, fit.theta

    sides = []
    for stop in (low, high):
        steps = np.arange(1.0, np.ceil(abs(stop - value) / pace) + 1.0)
        grid = np.clip(value + np.sign(stop - value) * pace * steps, low, high)
        sides.append(walk(at, (value, 0.0, best.theta), grid, threshold))
    down, up = sides
    return DerivedInterval(value, down.end, up.end, down.is_open, up.is_open)


def _slopes(quantity: Callable[[Array], float], theta: Array) -> Array:
    out = np.zeros(len(theta))
    for k in range(len(theta)):
        up, down = theta.copy(), theta.copy()
        up[k], down[k] = theta[k] * np.exp(_STEP), theta[k] * np.exp(-_STEP)
        out[k] = (quantity(up) - quantity(down)) / (2 * _STEP * theta[k])
    return out


_TWO_SIDED = float(ndtri(0.975))
_FEWEST = 3


@dataclass(frozen=True)
class LowestPoint:
    """Minimum of a parabola through points.

    at : position of the minimum; None if the parabola has none
    low, high : ends of its 95 % interval; None where open
    has_curvature : whether the points curve upwards by more than their noise explains (one-sided 97.5 %)
    """

    at: float | None
    low: float | None
    high: float | None
    has_curvature: bool


def lowest_on_grid(x: Array, y: Array) -> float:
    """The x of the smallest y, refined by a parabola through it and its neighbours; the end point if it is
    smallest.

    >>> x = np.linspace(-1.0, 1.0, 21)
    >>> round(lowest_on_grid(x, (x - 0.23) ** 2), 6), lowest_on_grid(x, x)
    (0.23, -1.0)
    """
    k = int(np.argmin(y))
    if k in (0, len(x) - 1):
        return float(x[k])
    a, b, c = y[k - 1 : k + 2]
    return float(x[k] + 0.5 * (x[k + 1] - x[k]) * (a - c) / (a - 2 * b + c))


def lowest_of_points(x: Array, y: Array, deviation: Array) -> LowestPoint:
    """Minimum of the parabola y = a + b x + c x^2 through measured points (n,), given the standard deviations
    of y.

    The interval holds every x at which the slope b + 2 c x is compatible with 0. It is bounded only if c
    exceeds 0 by more than its noise; otherwise no ends are reported.

    Source: Fieller 1954, J R Stat Soc B 16:175.

    >>> x = np.array([-1.0, 0.0, 1.0])
    >>> found = lowest_of_points(x, (x - 0.5) ** 2, np.full(3, 0.1))
    >>> round(found.at, 6), round(found.low, 3), round(found.high, 3)
    (0.5, 0.385, 0.677)
    >>> lowest_of_points(x, (x - 0.5) ** 2, np.full(3, 2.0)).has_curvature
    False
    """
    nothing = LowestPoint(None, None, None, False)
    if len(np.unique(x)) < _FEWEST:
        return nothing
    design = np.stack([np.ones_like(x), x, x * x], axis=1) / deviation[:, None]
    covariance = np.linalg.inv(design.T @ design)
    _, b, c = covariance @ design.T @ (y / deviation)
    if c <= _TWO_SIDED * np.sqrt(covariance[2, 2]):
        return nothing if c <= 0 else LowestPoint(float(-b / (2 * c)), None, None, False)
    # (b + 2 c x)^2 = z^2 (Vbb + 4 x Vbc + 4 x^2 Vcc), a quadratic in x
    left = np.outer([b, c], [b, c]) - _TWO_SIDED**2 * covariance[1:, 1:]
    roots = np.roots([4 * left[1, 1], 4 * left[0, 1], left[0, 0]])
    return LowestPoint(float(-b / (2 * c)), float(roots.real.min()), float(roots.real.max()), True)
