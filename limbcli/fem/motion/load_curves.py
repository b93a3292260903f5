"""Load curves with FEBio's interpolations and extensions (FEBio 4.11; FEBio User Manual 4.0, load curves)."""

from __future__ import annotations

import math

import numpy as np

from limbcli.model import Array, Curve

_MANY_TURNS = 10_000  # number of periods above which their number is divided, not counted
_NEAR = 1e-3  # distance over which FEBio evaluates the end slope of a smooth curve, per length of the curve


def value(curve: Curve, time: float) -> float:
    """The curve's value at a time (s); raises SolveError if a formula has none.

    "step" takes the value of the next point as soon as a point is reached. "smooth" fits a parabola
    through each three consecutive points and blends the two linearly where they overlap.

    >>> value(Curve(((0.0, 0.0), (2.0, 1.0))), 1.0)
    0.5
    >>> value(Curve(((0.0, 0.0), (2.0, 1.0)), extend="extrapolate"), 3.0)
    1.5
    >>> value(Curve(((0.0, 0.0), (1.0, 1.0), (2.0, 4.0)), "smooth"), 1.5)
    2.25
    """
    if curve.formula is not None:
        return float(curve.formula(np.zeros(3), time))
    times = np.array([t for t, _ in curve.points])
    values = np.array([v for _, v in curve.points])
    if len(times) == 1:
        return float(values[0])
    first, last = times[0], times[-1]
    if first <= time <= last:
        return _inside(curve.interpolate, times, values, time)
    if curve.extend == "constant":
        return float(values[0] if time < first else values[-1])
    if curve.extend == "extrapolate":
        return _beyond(curve.interpolate, times, values, time)
    turns, inside = _turns(times, time)
    offset = turns * (values[-1] - values[0]) if curve.extend == "repeat offset" else 0.0
    return float(_inside(curve.interpolate, times, values, inside) + offset)


def _turns(times: Array, time: float) -> tuple[int, float]:
    """(number of periods to the time, the time within the period).

    Periods are taken off one by one, as FEBio does, so that the round-off of a time that ends a period puts
    it on the same side of the jump; the end of a period is its last point.
    """
    first, last = float(times[0]), float(times[-1])
    period, turns = last - first, 0
    if abs(time - first) > _MANY_TURNS * period:
        turns = math.floor((time - first) / period)
        time -= turns * period
    while time > last:
        time, turns = time - period, turns + 1
    while time < first:
        time, turns = time + period, turns - 1
    return turns, min(time, last)


def _inside(kind: str, times: Array, values: Array, time: float) -> float:
    n = len(times) - 1
    if time in (times[0], times[n]):
        return float(values[0] if time == times[0] else values[n])
    k = int(np.searchsorted(times, time, side="right"))  # the next point
    if kind == "step":
        return float(values[k])
    if kind == "linear" or n == 1:
        return _line(times[k - 1 : k + 1], values[k - 1 : k + 1], time)
    parabolas = [
        _parabola(times[j - 1 : j + 2], values[j - 1 : j + 2], time) for j in (k - 1, k) if 1 <= j <= n - 1
    ]
    if len(parabolas) == 1:
        return parabolas[0]
    return _line(times[k - 1 : k + 1], np.array(parabolas), time)


def _beyond(kind: str, times: Array, values: Array, time: float) -> float:
    """Extrapolate the curve linearly; a step curve stays constant."""
    before = time < times[0]
    if kind == "step":
        return float(values[0] if before else values[-1])
    if kind == "linear":
        pair = slice(0, 2) if before else slice(-2, None)
        return _line(times[pair], values[pair], time)
    step = _NEAR * (times[-1] - times[0])
    ends = np.array([times[0], times[0] + step] if before else [times[-1] - step, times[-1]])
    return _line(ends, np.array([_inside(kind, times, values, t) for t in ends]), time)


def _line(times: Array, values: Array, time: float) -> float:
    return float(values[0] + (values[1] - values[0]) * (time - times[0]) / (times[1] - times[0]))


def _parabola(times: Array, values: Array, time: float) -> float:
    (t0, t1, t2), (v0, v1, v2) = times, values
    return float(
        v0 * (time - t1) * (time - t2) / ((t0 - t1) * (t0 - t2))
        + v1 * (time - t0) * (time - t2) / ((t1 - t0) * (t1 - t2))
        + v2 * (time - t0) * (time - t1) / ((t2 - t0) * (t2 - t1))
    )
