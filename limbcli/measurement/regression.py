"""Straight-line fits to the shear-wave speeds of the force levels.

Shear-wave speed increases with load because the tissue stiffens as it is compressed. Publications in the
field plot speed against force with a straight line and its R2; the plot against depth is the better test of a
model, since it does not change with a force offset, skin or locking.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.errors import MeasurementError
from limbcli.model import Array


@dataclass(frozen=True)
class Line:
    """y = intercept + slope x, by ordinary least squares over `n` points.

    `r2` is None if y does not vary: there is no variance to explain, so neither 0 nor 1 would be right.
    `slope_se` needs three points.
    """

    slope: float
    intercept: float
    r2: float | None
    slope_se: float | None
    n: int

    def at(self, x: Array) -> Array:
        return self.intercept + self.slope * np.asarray(x, dtype=float)


def speed_line(x: Array, speed_m_per_s: Array, *, against: str) -> Line:
    """Least-squares line of shear-wave speeds (m/s) over `x`, through the levels that have a speed.

    x : array, shape (n_levels,): probe force (N, compression positive) or indentation depth (mm)
    speed_m_per_s : array, shape (n_levels,), m/s, > 0; NaN where a level has no SWE
    against : what x is, for the messages ("force", "depth")

    Raises MeasurementError if a speed is not positive (level given), fewer than two levels have one, or all x
    are equal.

    >>> line = speed_line(np.array([0.0, 2.0, 4.0, 6.0]), np.array([2.0, 2.5, np.nan, 3.5]), against="force")
    >>> line.slope, line.intercept, line.r2, line.n
    (0.25, 2.0, 1.0, 3)
    """
    x, speed = np.asarray(x, dtype=float), np.asarray(speed_m_per_s, dtype=float)
    for level in np.flatnonzero(np.isinf(speed) | (speed <= 0.0)).tolist():
        raise MeasurementError(
            f"the shear-wave speed at level {level} is {speed[level]} m/s; it must be positive",
            where=f"level {level}, swe_mean_m_per_s against {against}",
            fix="leave the cell empty where there is no reading",
            level=level,
        )
    there = np.isfinite(x) & np.isfinite(speed)
    x, y = x[there], speed[there]
    if x.size < 2 or np.ptp(x) == 0.0:
        raise MeasurementError(
            f"a line needs readings at two different positions; there are {np.unique(x).size}",
            where=f"swe_mean_m_per_s against {against}",
            fix="give more levels, or omit the line",
            n_points=int(x.size),
        )
    dx, dy = x - x.mean(), y - y.mean()
    slope = float(dx @ dy / (dx @ dx))
    residual = dy - slope * dx
    # Readings that are equal up to round-off have no variance to explain.
    varies = float(np.ptp(y)) > 1e-12 * float(y.max())
    r2 = 1.0 - float(residual @ residual / (dy @ dy)) if varies else None
    spread = float(residual @ residual / (dx @ dx))
    slope_se = float(np.sqrt(spread / (x.size - 2))) if x.size > 2 else None
    return Line(slope, float(y.mean() - slope * x.mean()), r2, slope_se, int(x.size))
