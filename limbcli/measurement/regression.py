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


def straight_line(x: Array, y: Array) -> Line:
    """Least-squares line through the points whose x and y are both finite.

    Parameters
    ----------
    x, y : array, shape (n_points,); NaN where there is no reading

    Raises
    ------
    MeasurementError
        If fewer than two points remain, or all x are equal.

    >>> line = straight_line(np.array([0.0, 1.0, 2.0]), np.array([1.0, 3.0, 5.0]))
    >>> round(line.slope, 12), round(line.intercept, 12), round(line.r2, 12)
    (2.0, 1.0, 1.0)
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    there = np.isfinite(x) & np.isfinite(y)
    x, y = x[there], y[there]
    if x.size < 2 or np.ptp(x) == 0.0:
        raise MeasurementError(
            f"a line needs readings at two different positions; there are {np.unique(x).size}",
            where="straight_line",
            fix="give more levels, or omit the line",
            n_points=int(x.size),
        )
    dx, dy = x - x.mean(), y - y.mean()
    slope = float(dx @ dy / (dx @ dx))
    residual = dy - slope * dx
    # Readings that are equal up to round-off have no variance to explain.
    varies = float(np.ptp(y)) > 1e-12 * max(float(np.abs(y).max()), 1e-300)
    r2 = 1.0 - float(residual @ residual / (dy @ dy)) if varies else None
    spread = float(residual @ residual / (dx @ dx))
    slope_se = float(np.sqrt(spread / (x.size - 2))) if x.size > 2 else None
    return Line(slope, float(y.mean() - slope * x.mean()), r2, slope_se, int(x.size))


def speed_against_force(force: Array, speed_m_per_s: Array) -> Line:
    """Shear-wave speed (m/s) over probe force (N): slope in m/s per N.

    Parameters
    ----------
    force : array, shape (n_levels,), N, compression positive
    speed_m_per_s : array, shape (n_levels,), m/s, > 0; NaN where a level has no SWE

    Raises
    ------
    MeasurementError
        If a speed is not positive (level given), or fewer than two levels have one.

    >>> speed_against_force(np.array([0.0, 2.0, 4.0]), np.array([2.0, 2.5, np.nan])).slope
    0.25
    """
    return _speed_line(force, speed_m_per_s, "force")


def speed_against_depth(depth: Array, speed_m_per_s: Array) -> Line:
    """Shear-wave speed (m/s) over indentation depth (mm): slope in m/s per mm.

    Raises as `speed_against_force`.

    >>> speed_against_depth(np.array([0.0, 5.0]), np.array([2.0, 3.0])).slope
    0.2
    """
    return _speed_line(depth, speed_m_per_s, "depth")


def _speed_line(x: Array, speed_m_per_s: Array, what: str) -> Line:
    speed = np.asarray(speed_m_per_s, dtype=float)
    wrong = np.flatnonzero(np.isinf(speed) | (speed <= 0.0))
    if wrong.size:
        level = int(wrong[0])
        raise MeasurementError(
            f"the shear-wave speed at level {level} is {speed[level]} m/s; it must be positive",
            where=f"level {level}, swe_mean_m_per_s against {what}",
            fix="leave the cell empty where there is no reading",
            level=level,
        )
    return straight_line(x, speed)
