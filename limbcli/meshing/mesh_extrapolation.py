"""Discretisation error of a result: its distance from the extrapolated limit of an infinitely fine mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

_ORDERS = (0.5, 6.0)
_USUAL_ORDER = 2.0
_SAFETY = 1.25  # safety factor of Roache's grid convergence index with an observed order (three meshes)
_ASSUMED_SAFETY = 3.0


@dataclass(frozen=True)
class Extrapolation:
    """The value extrapolated to size 0, the order of convergence, and whether that was observed or assumed.

    error_fraction : for each given size, the distance of its value from `limit` over |limit|, times a safety
        factor
    """

    limit: float
    order: float
    order_is_assumed: bool
    error_fraction: tuple[float, ...]


def extrapolate(sizes: Sequence[float], values: Sequence[float]) -> Extrapolation:
    """Richardson extrapolation from two or more sizes; only the finest three are used.

    value = limit + a size^p, with p from the three finest meshes if they converge monotonically with p in
    [0.5, 6], else p = 2 from the two finest. Errors carry the safety factor of the grid convergence index
    (Roache, Ann. Rev. Fluid Mech. 29, 1997): 1.25 with an observed order, 3 with an assumed one.

    >>> found = extrapolate([1.0, 2.0, 4.0], [10.1, 10.4, 11.6])
    >>> round(found.limit, 6), round(found.order, 6)
    (10.0, 2.0)
    """
    order = np.argsort(sizes)
    h, f = np.asarray(sizes, float)[order], np.asarray(values, float)[order]
    p = _observed_order(h[:3], f[:3]) if len(h) >= 3 else None
    assumed = p is None
    power = _USUAL_ORDER if p is None else p
    limit = f[0] - (f[1] - f[0]) * h[0] ** power / (h[1] ** power - h[0] ** power)
    safety = _ASSUMED_SAFETY if assumed else _SAFETY
    errors = tuple(float(safety * abs(v - limit) / abs(limit)) for v in values)
    return Extrapolation(float(limit), float(power), assumed, errors)


def _observed_order(h: np.ndarray, f: np.ndarray) -> float | None:
    """p with (f3 - f2) / (f2 - f1) = (h3^p - h2^p) / (h2^p - h1^p); None where there is none."""
    first, second = f[1] - f[0], f[2] - f[1]
    if first * second <= 0:
        return None
    ratio = second / first

    def gap(p: float) -> float:
        return float((h[2] ** p - h[1] ** p) / (h[1] ** p - h[0] ** p) - ratio)

    low, high = _ORDERS
    if gap(low) * gap(high) > 0:
        return None
    return float(brentq(gap, low, high))
