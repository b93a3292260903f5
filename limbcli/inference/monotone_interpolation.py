"""Monotone cubic interpolation without overshoot, vectorised over curves, for thousands of short evaluations.

Cubic Hermite interpolation whose slopes at the knots are weighted harmonic means of the adjacent secants (0
where these differ in sign): the same curve as scipy's PchipInterpolator, without its input checks, and with
the derivatives with respect to the values at the knots, which a gradient-based fit needs.

Source: Fritsch & Carlson 1980, SIAM J Numer Anal 17:238, eq. (4.2); Fritsch & Butland 1984, SIAM J Sci Stat
Comput 5:300.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.errors import FitError
from limbcli.model import Array
from limbcli.numbers.compiled import njit


@dataclass(frozen=True, eq=False)
class Sample:
    """A curve evaluated at given places.

    values : (n,)
    slopes : (n,) d value / d place
    weights : (n, n_knots) d value / d knot value
    """

    values: Array
    slopes: Array
    weights: Array


@dataclass(frozen=True, eq=False)
class Monotone:
    """Interpolant: knots (n,) ascending; values and slopes (n,)."""

    knots: Array
    values: Array
    slopes: Array

    @staticmethod
    def through(knots: Array, values: Array) -> Monotone:
        """
        >>> Monotone.through(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0])).slopes
        array([1., 1., 1.])
        """
        knots, values = (np.ascontiguousarray(each, dtype=float) for each in (knots, values))
        slopes = np.empty(len(knots))
        _slopes_of(knots, values, len(knots), slopes)
        return Monotone(knots, values, slopes)

    def with_lines(self, at: Array, first: float, last: float, *, far: float = np.inf) -> Array:
        """Values (n,) of one curve at positions (n,), with linear extrapolation of slopes `first` and `last`.

        far : largest change that the extrapolation may add

        >>> Monotone.through(np.arange(3.0), np.arange(3.0)).with_lines(np.array([-1.0, 0.5, 4.0]), 0.0, 2.0)
        array([0. , 0.5, 6. ])
        """
        out = np.empty(len(at))
        _with_lines(self.knots, self.values, self.slopes, at, first, last, far, out)
        return out

    def read(self, at: Array) -> Sample:
        """One curve with values (n_knots,) at places (n,).

        >>> curve = Monotone.through(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0]))
        >>> curve.read(np.array([1.5])).weights
        array([[-0.125,  0.75 ,  0.375]])
        """
        at = np.ascontiguousarray(at, dtype=float)
        found = Sample(np.empty(len(at)), np.empty(len(at)), np.empty((len(at), len(self.knots))))
        _read(self.knots, self.values, self.slopes, at, found.values, found.slopes, found.weights)
        return found

    def inverse(self, wanted: Array) -> Array:
        """Positions (n,) at which one curve with increasing values takes the values `wanted`.

        Values beyond the range of the curve give the first or last knot.

        >>> Monotone.through(np.arange(4.0), 2 * np.arange(4.0)).inverse(np.array([0.0, 3.0, 9.0])).round(9)
        array([0. , 1.5, 3. ])
        """
        wanted = np.ascontiguousarray(wanted, dtype=float)
        out = np.empty(len(wanted))
        _inverse(self.knots, self.values, self.slopes, wanted, out)
        return out


def pchip_sample(knots: Array, values: Array, places: Array) -> Sample:
    """Evaluate the shape-preserving piecewise cubic through (knots, values) at `places`.

    The same curve as `scipy.interpolate.PchipInterpolator` and MATLAB's `pchip`.

    knots : (n_knots,) strictly increasing, n_knots >= 2
    values : (n_knots,)
    places : (n,) within the knots

    Raises FitError if the knots do not increase, or a place lies outside them.

    >>> sample = pchip_sample(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 4.0]), np.array([0.5, 2.0]))
    >>> sample.values
    array([0.3125, 4.    ])
    """
    _check(knots, values, places)
    return Monotone.through(knots, values).read(places)


def pchip_inverse(knots: Array, values: Array, wanted: Array) -> Array:
    """Places within the knots at which the curve through increasing values equals `wanted`.

    >>> pchip_inverse(np.arange(4.0), 2 * np.arange(4.0), np.array([0.0, 3.0, 9.0])).round(9)
    array([0. , 1.5, 3. ])
    """
    return Monotone.through(knots, values).inverse(wanted)


def _check(knots: Array, values: Array, places: Array) -> None:
    if len(knots) < 2 or len(knots) != len(values) or np.any(knots[1:] <= knots[:-1]):
        raise FitError(
            "the simulated curve's depths do not increase",
            where=f"{len(knots)} points",
            fix="check force-depth.csv of the run: it must contain every depth level once",
        )
    slack = 1e-9 * max(1.0, float(np.abs(knots).max()))
    if np.any(places < knots[0] - slack) or np.any(places > knots[-1] + slack):
        raise FitError(
            f"a measured depth lies outside the simulated {knots[0]:.3f} to {knots[-1]:.3f} mm",
            where=f"measured {places.min():.3f} to {places.max():.3f} mm",
            fix="build the model again so that its load covers the measurement: limbcli build-feb",
        )


def columns_through(knots: Array, values: Array, at: Array) -> Array:
    """Values (n_places, n_columns) of curves through the finite values of each column (n_knots, n_columns).

    Constant before a column's first finite knot, extrapolated linearly beyond the last; NaN for a column with
    fewer than two.

    >>> nan = np.nan
    >>> columns_through(np.arange(3.0), np.array([[0.0, nan], [1.0, 5.0], [2.0, nan]]), np.array([0.5, 3.0]))
    array([[0.5, nan],
           [3. , nan]])
    """
    out = np.full((len(at), values.shape[1]), np.nan)
    if len(at):
        _columns(*(np.ascontiguousarray(each, dtype=float) for each in (knots, values, at)), out)
    return out


@njit
def _hermite(y0, y1, d0, d1, h, t):  # type: ignore[no-untyped-def]
    """Value at fraction t of an interval of length h, from the values and slopes at its ends."""
    s = 1.0 - t
    return s * s * ((1 + 2 * t) * y0 + t * h * d0) + t * t * ((3 - 2 * t) * y1 - s * h * d1)


@njit
def _with_lines(knots, values, slopes, at, first, last, far, out):  # type: ignore[no-untyped-def]
    n = len(knots)
    for i in range(len(at)):
        x = at[i]
        if np.isnan(x):
            out[i] = np.nan
            continue
        inside = min(max(x, knots[0]), knots[n - 1])
        k = 0
        while k < n - 2 and inside >= knots[k + 1]:
            k += 1
        h = knots[k + 1] - knots[k]
        found = _hermite(values[k], values[k + 1], slopes[k], slopes[k + 1], h, (inside - knots[k]) / h)
        beyond = first * min(x - knots[0], 0.0) + last * max(x - knots[n - 1], 0.0)
        out[i] = found + min(max(beyond, -far), far)


@njit
def _inverse(knots, values, slopes, wanted, out):  # type: ignore[no-untyped-def]
    """Newton's method for the fraction t of an interval, kept within a bracket that shrinks."""
    n = len(knots)
    for i in range(len(wanted)):
        k, highest = -1, values[0]
        for j in range(n):
            highest = max(highest, values[j])
            if not highest <= wanted[i]:
                break
            k = j
        k = min(max(k, 0), n - 2)
        h = knots[k + 1] - knots[k]
        d0, d1, rise = slopes[k] * h, slopes[k + 1] * h, values[k + 1] - values[k]
        square, cube = 3 * rise - 2 * d0 - d1, d0 + d1 - 2 * rise
        above = wanted[i] - values[k]
        low, high, t = 0.0, 1.0, min(max(above / rise, 0.0), 1.0) if rise > 0.0 else 0.5
        for _ in range(60):
            left = t * (d0 + t * (square + t * cube)) - above
            if left < 0.0:
                low = t
            else:
                high = t
            steep = d0 + t * (2 * square + 3 * t * cube)
            after = t - left / steep if steep > 0.0 else low
            if not low < after < high:
                after = 0.5 * (low + high)
            step, t = abs(after - t), after
            if step <= 1e-15:
                break
        out[i] = knots[k] + t * h


@njit
def _end_slope(h0, h1, m0, m1):  # type: ignore[no-untyped-def]
    """Three-point end slope, limited to avoid overshoot."""
    d = ((2 * h0 + h1) * m0 - h0 * m1) / (h0 + h1)
    if np.sign(d) != np.sign(m0):
        return 0.0
    if np.sign(m0) != np.sign(m1) and abs(d) > 3 * abs(m0):
        return 3 * m0
    return d


@njit
def _slopes_of(x, y, n, out):  # type: ignore[no-untyped-def]
    """Slopes at the first n knots of one curve."""
    if n == 2:
        out[0] = out[1] = (y[1] - y[0]) / (x[1] - x[0])
        return
    for k in range(1, n - 1):
        before, after = x[k] - x[k - 1], x[k + 1] - x[k]
        rise, next_rise = (y[k] - y[k - 1]) / before, (y[k + 1] - y[k]) / after
        if k == 1:
            out[0] = _end_slope(before, after, rise, next_rise)
        if k == n - 2:
            out[n - 1] = _end_slope(after, before, next_rise, rise)
        w1, w2 = 2 * after + before, after + 2 * before
        out[k] = (w1 + w2) / (w1 / rise + w2 / next_rise) if rise * next_rise > 0 else 0.0


@njit
def _end_weights(h0, h1, m0, m1):  # type: ignore[no-untyped-def]
    """Derivatives of `_end_slope` with respect to the two secant slopes."""
    d = ((2 * h0 + h1) * m0 - h0 * m1) / (h0 + h1)
    if d * m0 <= 0.0:
        return 0.0, 0.0
    if m0 * m1 < 0.0 and abs(d) > 3 * abs(m0):
        return 3.0, 0.0
    return (2 * h0 + h1) / (h0 + h1), -h0 / (h0 + h1)


@njit
def _add_slope_weights(x, y, slope, k, times, out):  # type: ignore[no-untyped-def]
    """out (n,) += times the derivative of the slope at knot k with respect to the values at all knots."""
    n = len(x)
    if n == 2:
        out[0] -= times / (x[1] - x[0])
        out[1] += times / (x[1] - x[0])
        return
    # a, b: derivatives with respect to the secants before and after, each divided by its interval
    if 0 < k < n - 1:
        middle, before, after = k, x[k] - x[k - 1], x[k + 1] - x[k]
        rise, next_rise = (y[k] - y[k - 1]) / before, (y[k + 1] - y[k]) / after
        w1, w2 = 2 * after + before, after + 2 * before
        part = slope[k] ** 2 / (w1 + w2)  # 0 where a secant is
        a = part * w1 / ((rise if rise != 0.0 else 1.0) ** 2 * before)
        b = part * w2 / ((next_rise if next_rise != 0.0 else 1.0) ** 2 * after)
    else:
        middle = 1 if k == 0 else n - 2
        before, after = x[middle] - x[middle - 1], x[middle + 1] - x[middle]
        rise, next_rise = (y[middle] - y[middle - 1]) / before, (y[middle + 1] - y[middle]) / after
        if k == 0:
            near, far = _end_weights(before, after, rise, next_rise)
            a, b = near / before, far / after
        else:
            near, far = _end_weights(after, before, next_rise, rise)
            a, b = far / before, near / after
    out[middle - 1] -= times * a
    out[middle] += times * (a - b)
    out[middle + 1] += times * b


@njit
def _read(knots, values, slopes, at, value, rate, weights):  # type: ignore[no-untyped-def]
    n = len(knots)
    for i in range(len(at)):
        k = 0
        while k < n - 2 and at[i] >= knots[k + 1]:
            k += 1
        h = knots[k + 1] - knots[k]
        t = (at[i] - knots[k]) / h
        s = 1.0 - t
        y0, y1, d0, d1 = values[k], values[k + 1], slopes[k], slopes[k + 1]
        value[i] = _hermite(y0, y1, d0, d1, h, t)
        rate[i] = 6 * t * s * ((y1 - y0) / h) + s * (1 - 3 * t) * d0 + t * (3 * t - 2) * d1
        row = weights[i]
        row[:] = 0.0
        low = s * s * (1 + 2 * t)
        row[k], row[k + 1] = low, 1.0 - low
        _add_slope_weights(knots, values, slopes, k, s * s * t * h, row)
        _add_slope_weights(knots, values, slopes, k + 1, -t * t * s * h, row)


@njit
def _columns(knots, values, at, out):  # type: ignore[no-untyped-def]
    x, y, slope = np.empty(len(knots)), np.empty(len(knots)), np.empty(len(knots))
    for c in range(values.shape[1]):
        n = 0
        for k in range(len(knots)):
            if np.isfinite(values[k, c]):
                x[n], y[n] = knots[k], values[k, c]
                n += 1
        if n < 2:
            continue
        _slopes_of(x, y, n, slope)
        _with_lines(x[:n], y[:n], slope, at, 0.0, slope[n - 1], np.inf, out[:, c])
