"""Curves through points that do not overshoot, many beside each other, for thousands of short evaluations.

Cubic Hermite pieces whose slopes at the knots are weighted harmonic means of the neighbours' (0 where these
differ in sign): the same curve as scipy's PchipInterpolator, without its checks of every input.
Source: Fritsch & Butland 1984, SIAM J Sci Stat Comput 5:300.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.model import Array, IntArray


@dataclass(frozen=True, eq=False)
class Monotone:
    """knots (n,) rising; values and slopes (n, ...)."""

    knots: Array
    values: Array
    slopes: Array

    @staticmethod
    def through(knots: Array, values: Array) -> Monotone:
        """
        >>> curve = Monotone.through(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0]))
        >>> float(curve(0.5)), float(curve.slope(1.5))
        (0.5, 1.0)
        """
        return Monotone(knots, values, _slopes(knots, values))

    def __call__(self, at: Array | float) -> Array:
        """Values (*at.shape, ...); beyond the ends the last piece goes on."""
        k, t, h = self._piece(at)
        y0, y1, d0, d1 = self.values[k], self.values[k + 1], self.slopes[k], self.slopes[k + 1]
        s = 1.0 - t
        return np.asarray(s * s * ((1 + 2 * t) * y0 + t * h * d0) + t * t * ((3 - 2 * t) * y1 - s * h * d1))

    def slope(self, at: Array | float) -> Array:
        """Derivative (*at.shape, ...)."""
        k, t, h = self._piece(at)
        y0, y1, d0, d1 = self.values[k], self.values[k + 1], self.slopes[k], self.slopes[k + 1]
        rise = (y1 - y0) / h
        return np.asarray(6 * t * (1 - t) * rise + (1 - t) * (1 - 3 * t) * d0 + t * (3 * t - 2) * d1)

    def _piece(self, at: Array | float) -> tuple[IntArray, Array, Array]:
        at = np.asarray(at, dtype=float)
        k = np.clip(np.searchsorted(self.knots, at, side="right") - 1, 0, len(self.knots) - 2)
        h = np.asarray(self.knots[k + 1] - self.knots[k])
        t = np.asarray((at - self.knots[k]) / h)
        more = (1,) * (self.values.ndim - 1)
        return k, np.reshape(t, t.shape + more), np.reshape(h, h.shape + more)


def _slopes(knots: Array, values: Array) -> Array:
    h = np.reshape(np.diff(knots), (-1,) + (1,) * (values.ndim - 1))
    rise = np.diff(values, axis=0) / h
    if len(knots) == 2:
        return np.concatenate([rise, rise])
    before, after = rise[:-1], rise[1:]
    w1, w2 = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
    same = before * after > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (w1 + w2) / (w1 / before + w2 / after)
    inner = np.where(same, mean, 0.0)
    first, last = _end(h[0], h[1], rise[0], rise[1]), _end(h[-1], h[-2], rise[-1], rise[-2])
    return np.concatenate([first[None], inner, last[None]])


def _end(h0: Array, h1: Array, m0: Array, m1: Array) -> Array:
    """Slope at an end by three points, kept from overshooting."""
    d = ((2 * h0 + h1) * m0 - h0 * m1) / (h0 + h1)
    d = np.where(np.sign(d) != np.sign(m0), 0.0, d)
    return np.where((np.sign(m0) != np.sign(m1)) & (np.abs(d) > 3 * np.abs(m0)), 3 * m0, d)
