"""Position of a curve's minimum: on a grid of model values, and of measured points by a parabola."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from limbcli.model import Array

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
    z2 = _TWO_SIDED**2
    roots = np.roots(
        [
            4 * (c * c - z2 * covariance[2, 2]),
            4 * (b * c - z2 * covariance[1, 2]),
            b * b - z2 * covariance[1, 1],
        ]
    )
    return LowestPoint(float(-b / (2 * c)), float(roots.real.min()), float(roots.real.max()), True)
