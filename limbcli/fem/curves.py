"""Load curves with FEBio's interpolations and extensions."""

from __future__ import annotations

import numpy as np

from limbcli.model import Curve


def value(curve: Curve, time: float) -> float:
    """The curve's value at a time (s).

    "step" holds each value until the next point has passed: FEBio gives at a point
    the value of that point. "smooth" is a cubic with zero slope at the points.

    >>> value(Curve(((0.0, 0.0), (2.0, 1.0))), 1.0)
    0.5
    >>> value(Curve(((0.0, 0.0), (2.0, 1.0)), extend="extrapolate"), 3.0)
    1.5
    """
    times = np.array([t for t, _ in curve.points])
    values = np.array([v for _, v in curve.points])
    if len(times) == 1:
        return float(values[0])
    first, last = times[0], times[-1]
    period, rise = last - first, values[-1] - values[0]
    offset = 0.0
    if time < first or time > last:
        if curve.extend == "constant":
            return float(values[0] if time < first else values[-1])
        if curve.extend == "extrapolate":
            pair = slice(0, 2) if time < first else slice(-2, None)
            (t0, t1), (v0, v1) = times[pair], values[pair]
            return float(v0 + (v1 - v0) * (time - t0) / (t1 - t0))
        turns = np.floor((time - first) / period)
        offset = turns * rise if curve.extend == "repeat offset" else 0.0
        time = time - turns * period
    return float(_inside(curve.interpolate, times, values, time) + offset)


def _inside(kind: str, times: np.ndarray, values: np.ndarray, time: float) -> float:
    k = int(np.clip(np.searchsorted(times, time, side="left") - 1, 0, len(times) - 2))
    x = (time - times[k]) / (times[k + 1] - times[k])
    if kind == "step":
        return float(values[k] if x <= 0 else values[k + 1])
    if kind == "smooth":
        x = x * x * (3.0 - 2.0 * x)
    return float(values[k] + x * (values[k + 1] - values[k]))
