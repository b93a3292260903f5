"""How the noise of shear-wave maps is correlated from pixel to pixel: estimated from the maps themselves.

What tissue and load do to a map changes evenly from level to level, noise does not. So half of every level's
neighbours is taken off it (second differences), and off that its mean: what is left is noise. Its
autocovariance, over the pairs of pixels at a distance, is that of white noise that a Gaussian smoothed,
besides a share that was not: r(d) = share exp(-d^2 / (4 s^2)) at d > 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limbcli.measurement.elastography import SweMap
from limbcli.model import Array

_FARTHEST = 6.0  # mm, of the distances that are looked at
_SCALES = np.r_[0.0, np.geomspace(0.3, 4.0, 60)]  # mm, of the smoothing's deviation s
_FEWEST_LEVELS, _FEWEST_PAIRS = 3, 200


@dataclass(frozen=True)
class PixelNoise:
    """deviation : of ln speed at one pixel; smoothing : mm, deviation of the Gaussian that smoothed the noise
    (0: independent pixels); share : of its variance that was smoothed"""

    deviation: float
    smoothing: float = 0.0
    share: float = 0.0

    def correlation(self, distance: Array) -> Array:
        """Of ln speed between pixels at distances (...) mm, 1 at 0."""
        together = np.zeros_like(distance, dtype=float)
        if self.smoothing > 0:
            together = self.share * np.exp(-(distance**2) / (4 * self.smoothing**2))
        return np.where(distance < 1e-9, 1.0, together)


def pixel_noise(maps: Sequence[SweMap], *, usual: float) -> PixelNoise:
    """Estimated from the maps of a site's levels; the `usual` deviation, independent, where they are few.

    >>> rng = np.random.default_rng(7)
    >>> x, z = (each.ravel() for each in np.meshgrid(np.arange(40.0), np.arange(20.0)))
    >>> maps = [SweMap(x, z, np.exp(0.1 * rng.standard_normal(800) + 0.01 * k * z)) for k in range(8)]
    >>> found = pixel_noise(maps, usual=0.2)
    >>> round(found.deviation, 2), found.smoothing * found.share < 0.1
    (0.1, True)
    """
    if len(maps) < _FEWEST_LEVELS:
        return PixelNoise(usual)
    table, lateral, depth = _together(maps)
    left = table[1:-1] - 0.5 * (table[:-2] + table[2:])
    left -= np.nanmedian(left, axis=(1, 2), keepdims=True)
    known = np.isfinite(left)
    if known.sum() < _FEWEST_PAIRS:
        return PixelNoise(usual)
    left = np.where(known, np.clip(left, *_within(left[known])), 0.0)
    variance = float(np.sum(left**2) / known.sum())
    if variance <= 0.0:
        return PixelNoise(usual)
    distances, values, counts = [], [], []
    for i in range(int(_FARTHEST / lateral) + 1):
        for j in range(int(_FARTHEST / depth) + 1):
            if (i, j) == (0, 0) or np.hypot(i * lateral, j * depth) > _FARTHEST:
                continue
            a, b = _shifted(left, i, j)
            ka, kb = _shifted(known, i, j)
            n = int((ka & kb).sum())
            if n >= _FEWEST_PAIRS:
                distances.append(float(np.hypot(i * lateral, j * depth)))
                values.append(float(np.sum(a * b)) / n / variance)
                counts.append(n)
    deviation = float(np.sqrt(variance / 1.5))  # a value and half of its two neighbours
    if not distances:
        return PixelNoise(deviation)
    return PixelNoise(deviation, *_fitted(np.array(distances), np.array(values), np.array(counts)))


def _within(values: Array) -> tuple[float, float]:
    """Where all but outliers lie."""
    spread = 1.4826 * float(np.median(np.abs(values)))
    return -4 * spread, 4 * spread


def _together(maps: Sequence[SweMap]) -> tuple[Array, float, float]:
    """ln speeds (n_levels, n_lateral, n_depth) on the pixels of all maps, NaN where one has none; and their
    pitches (mm)."""
    x = np.unique(np.round(np.concatenate([each.lateral for each in maps]), 3))
    z = np.unique(np.round(np.concatenate([each.depth for each in maps]), 3))
    table = np.full((len(maps), len(x), len(z)), np.nan)
    for level, each in enumerate(maps):
        i, j = np.searchsorted(x, np.round(each.lateral, 3)), np.searchsorted(z, np.round(each.depth, 3))
        table[level, i, j] = np.log(each.speed_m_per_s)
    pitch = [float(np.median(np.diff(each))) if len(each) > 1 else 1.0 for each in (x, z)]
    return table, pitch[0], pitch[1]


def _shifted(table: NDArray[Any], i: int, j: int) -> tuple[NDArray[Any], NDArray[Any]]:
    n, m = table.shape[1:]
    return table[:, : n - i, : m - j], table[:, i:, j:]


def _fitted(distance: Array, value: Array, count: Array) -> tuple[float, float]:
    """Smoothing and share by least squares, a line in the share for each smoothing."""
    best, found = float(np.sum(count * value**2)), (0.0, 0.0)
    for s in _SCALES[1:].tolist():
        shape = np.exp(-(distance**2) / (4 * s**2))
        share = float(np.clip(np.sum(count * shape * value) / np.sum(count * shape**2), 0.0, 1.0))
        left = float(np.sum(count * (value - share * shape) ** 2))
        if left < best:
            best, found = left, (s, share)
    return found
