"""Sampling a simulated curve by PCHIP, with the derivative of the sample with respect to the curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.errors import FitError
from limbcli.model import Array


@dataclass(frozen=True, eq=False)
class Sample:
    """A curve read off at given places.

    values : (n,); slopes : (n,) d value / d place;
    weights : (n, n_knots) d value / d knot value.
    """

    values: Array
    slopes: Array
    weights: Array


def pchip_sample(knots: Array, values: Array, places: Array) -> Sample:
    """Shape-preserving piecewise cubic through (knots, values), read at `places`.

    Slopes by Fritsch and Carlson with Brodlie's weighted harmonic mean, as in
    `scipy.interpolate.PchipInterpolator` and MATLAB's `pchip`; here with the exact
    derivative with respect to the knot values, which a gradient-based fit needs.

    Parameters
    ----------
    knots : (n_knots,) strictly increasing, n_knots >= 2
    values : (n_knots,)
    places : (n,) within the knots

    Raises
    ------
    FitError
        If knots do not increase, or a place lies outside them.

    Source: Fritsch and Carlson 1980, SIAM J. Numer. Anal. 17:238, eq. (4.2); Fritsch and Butland 1984.

    >>> sample = pchip_sample(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 4.0]), np.array([0.5, 2.0]))
    >>> sample.values
    array([0.3125, 4.    ])
    """
    _check(knots, values, places)
    h = np.diff(knots)
    secants = np.diff(values) / h
    to_secants = (np.eye(len(knots))[1:] - np.eye(len(knots))[:-1]) / h[:, None]
    tangents, by_secant = _tangents(h, secants)
    by_value = by_secant @ to_secants
    cell = np.clip(np.searchsorted(knots, places, side="right") - 1, 0, len(h) - 1)
    width = h[cell]
    s = (places - knots[cell]) / width
    hermite = (2 * s**3 - 3 * s**2 + 1, 3 * s**2 - 2 * s**3, s**3 - 2 * s**2 + s, s**3 - s**2)
    slope = (6 * s**2 - 6 * s, 6 * s - 6 * s**2, 3 * s**2 - 4 * s + 1, 3 * s**2 - 2 * s)
    eye = np.eye(len(knots))
    weights = (
        hermite[0][:, None] * eye[cell]
        + hermite[1][:, None] * eye[cell + 1]
        + (hermite[2] * width)[:, None] * by_value[cell]
        + (hermite[3] * width)[:, None] * by_value[cell + 1]
    )
    sampled = (
        hermite[0] * values[cell] + hermite[1] * values[cell + 1]
        + width * (hermite[2] * tangents[cell] + hermite[3] * tangents[cell + 1])
    )  # fmt: skip
    sampled_slopes = (
        (slope[0] * values[cell] + slope[1] * values[cell + 1]) / width
        + slope[2] * tangents[cell] + slope[3] * tangents[cell + 1]
    )  # fmt: skip
    return Sample(sampled, sampled_slopes, weights)


def pchip_inverse(knots: Array, values: Array, wanted: Array) -> Array:
    """Places within the knots where the curve through growing values takes the values `wanted`.

    >>> pchip_inverse(np.arange(4.0), 2 * np.arange(4.0), np.array([0.0, 3.0, 9.0])).round(9)
    array([0. , 1.5, 3. ])
    """
    h = np.diff(knots)
    tangents, _ = _tangents(h, np.diff(values) / h)
    growing = np.maximum.accumulate(values)
    cell = np.clip(np.searchsorted(growing, wanted, side="right") - 1, 0, len(h) - 1)
    first, last, width = values[cell], values[cell + 1], h[cell]
    at_first, at_last = tangents[cell] * width, tangents[cell + 1] * width
    square, cube = 3 * (last - first) - 2 * at_first - at_last, at_first + at_last - 2 * (last - first)
    low, high = np.zeros(len(wanted)), np.ones(len(wanted))
    for _ in range(44):
        s = 0.5 * (low + high)
        below = first + s * (at_first + s * (square + s * cube)) < wanted
        low, high = np.where(below, s, low), np.where(below, high, s)
    return np.asarray(knots[cell] + 0.5 * (low + high) * width)


def _tangents(h: Array, secants: Array) -> tuple[Array, Array]:
    """Knot slopes (n,) and their derivative with respect to the secants (n, n - 1)."""
    n = len(h) + 1
    tangents, by_secant = np.zeros(n), np.zeros((n, n - 1))
    if n == 2:
        tangents[:], by_secant[:, 0] = secants[0], 1.0
        return tangents, by_secant
    for k in range(1, n - 1):
        before, after = secants[k - 1], secants[k]
        if before * after <= 0.0:
            continue
        w1, w2 = 2 * h[k] + h[k - 1], h[k] + 2 * h[k - 1]
        tangents[k] = (w1 + w2) / (w1 / before + w2 / after)
        by_secant[k, k - 1] = tangents[k] ** 2 * w1 / ((w1 + w2) * before**2)
        by_secant[k, k] = tangents[k] ** 2 * w2 / ((w1 + w2) * after**2)
    tangents[0], by_secant[0, 0], by_secant[0, 1] = _end(h[0], h[1], secants[0], secants[1])
    tangents[-1], by_secant[-1, -1], by_secant[-1, -2] = _end(h[-1], h[-2], secants[-1], secants[-2])
    return tangents, by_secant


def _end(h0: float, h1: float, first: float, second: float) -> tuple[float, float, float]:
    """Three-point end slope, limited to keep the shape; with its two derivatives."""
    near, far = (2 * h0 + h1) / (h0 + h1), -h0 / (h0 + h1)
    slope = near * first + far * second
    if slope * first <= 0.0:
        return 0.0, 0.0, 0.0
    if first * second < 0.0 and abs(slope) > 3 * abs(first):
        return 3 * first, 3.0, 0.0
    return slope, near, far


def _check(knots: Array, values: Array, places: Array) -> None:
    if len(knots) < 2 or len(knots) != len(values) or np.any(np.diff(knots) <= 0.0):
        raise FitError(
            "the simulated curve's depths do not increase",
            where=f"{len(knots)} points",
            fix="look at force-depth.csv of the run: it must hold every depth level once",
        )
    slack = 1e-9 * max(1.0, float(np.abs(knots).max()))
    if np.any(places < knots[0] - slack) or np.any(places > knots[-1] + slack):
        raise FitError(
            f"a measured depth lies outside the simulated {knots[0]:.3f} to {knots[-1]:.3f} mm",
            where=f"measured {places.min():.3f} to {places.max():.3f} mm",
            fix="build the model again so that its load covers the measurement: limbcli build-feb",
        )
