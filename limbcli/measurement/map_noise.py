"""Estimate the pixel-to-pixel correlation of the noise of shear-wave maps from the maps themselves.

The effect of tissue and load on a map varies smoothly from level to level and from place to place; noise does
not. Therefore half the sum of the neighbouring levels is subtracted from every level (second differences),
and within blocks of some 10 mm a fitted quadratic surface. The remainder is noise: independent between
pixels, or with a fraction of its variance smoothed by a Gaussian, r(d) = share exp(-d^2 / (4 s^2)) at d > 0,
if that is far more likely.

Source: restricted likelihood, Patterson & Thompson 1971, Biometrika 58:545.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from limbcli.measurement.elastography import SweMap
from limbcli.model import Array

# Side length of a block (mm), and fraction of its pixels that must be present; the next pair is tried if
# there are few such blocks.
_BLOCKS = ((10.0, 1.0), (6.0, 1.0), (6.0, 0.5))
# largest number of blocks if some have gaps, since each pattern of gaps needs its own matrix
_MOST_BLOCKS = 60
_MOST, _FEWEST = 14, 4  # largest and smallest number of pixels along a block
_DEGREE = 2
_SCALES = np.geomspace(0.3, 3.0, 47)  # mm, trial standard deviations s of the smoothing
_MOST_SHARE = 0.9999  # values are rounded, so that part of every pixel's noise is independent
_FEWEST_LEVELS, _FEWEST_BLOCKS = 3, 10
_GAIN = 9.2  # required decrease of the deviance, two parameters: p 0.01
# Adjacent second differences are correlated by -2/3, the next but one by 1/6; for independent ones,
# differences of the deviance would be smaller by this factor.
_TOGETHER = 1 + 2 * ((2 / 3) ** 2 + (1 / 6) ** 2)


@dataclass(frozen=True)
class PixelNoise:
    """Noise of a shear-wave map.

    deviation : standard deviation of ln speed at one pixel
    smoothing : mm, standard deviation of the Gaussian that smoothed the noise (0: independent pixels)
    share : fraction of the noise variance that was smoothed
    """

    deviation: float
    smoothing: float = 0.0
    share: float = 0.0

    def correlation(self, distance: Array) -> Array:
        """Correlation of ln speed between pixels at distances (...) mm; 1 at 0."""
        together = np.zeros_like(distance, dtype=float)
        if self.smoothing > 0:
            together = self.share * np.exp(-(distance**2) / (4 * self.smoothing**2))
        return np.where(distance < 1e-9, 1.0, together)


def pixel_noise(maps: Sequence[SweMap], *, usual: float) -> PixelNoise:
    """Estimate the noise from the maps of a site's levels.

    With too few maps or pixels, the noise is independent with the `usual` standard deviation.

    >>> rng = np.random.default_rng(7)
    >>> x, z = (each.ravel() for each in np.meshgrid(np.arange(40.0), np.arange(20.0)))
    >>> maps = [SweMap(x, z, np.exp(0.1 * rng.standard_normal(800) + 0.01 * k * z)) for k in range(8)]
    >>> found = pixel_noise(maps, usual=0.2)
    >>> round(found.deviation, 2), found.smoothing
    (0.1, 0.0)
    """
    maps = [each for each in maps if len(each)]
    if len(maps) < _FEWEST_LEVELS:
        return PixelNoise(usual)
    table, pitch = _together(maps)
    left = table[1:-1] - 0.5 * (table[:-2] + table[2:])
    left -= np.nanmedian(left, axis=(1, 2), keepdims=True)
    known = np.isfinite(left)
    if not known.any():
        return PixelNoise(usual)
    outlier = 4 * 1.4826 * float(np.median(np.abs(left[known])))
    left = np.where(known, np.clip(left, -outlier, outlier), np.nan)
    # variance factor of a value minus half of its two neighbours
    deviation = float(np.sqrt(np.nanmean(left**2) / 1.5))
    if deviation <= 0.0:
        return PixelNoise(usual)
    for side, share in _BLOCKS:
        values, apart, surfaces = _in_blocks(left, pitch, side)
        values = values[np.isfinite(values).mean(axis=1) >= share]
        if len(values) >= _FEWEST_BLOCKS and np.nanmax(values) > np.nanmin(values):
            return PixelNoise(deviation, *_likeliest(_rough_parts(values, apart, surfaces)))
    return PixelNoise(deviation)


def _together(maps: Sequence[SweMap]) -> tuple[Array, tuple[float, float]]:
    """ln speeds (n_levels, n_lateral, n_depth) on the pixels of all maps, and the pixel pitches (mm).

    NaN where a map has no pixel.
    """
    x = np.unique(np.round(np.concatenate([each.lateral for each in maps]), 3))
    z = np.unique(np.round(np.concatenate([each.depth for each in maps]), 3))
    table = np.full((len(maps), len(x), len(z)), np.nan)
    for level, each in enumerate(maps):
        i, j = np.searchsorted(x, np.round(each.lateral, 3)), np.searchsorted(z, np.round(each.depth, 3))
        table[level, i, j] = np.log(each.speed_m_per_s)
    pitch = [float(np.median(np.diff(each))) if len(each) > 1 else 1.0 for each in (x, z)]
    return table, (pitch[0], pitch[1])


def _in_blocks(left: Array, pitch: tuple[float, float], side: float) -> tuple[Array, Array, Array]:
    """Square blocks about `side` mm wide.

    Returns values (n_blocks, n_pixels), NaN where there is no pixel; squared distances (n_pixels, n_pixels)
    mm2; quadratic surfaces (n_pixels, n). In fine maps a block takes every second, third, ... pixel in each
    direction, with one block for each offset.
    """
    counts, steps = [], []
    for size, apart in zip(left.shape[1:], pitch, strict=True):
        along = min(max(round(side / apart), _FEWEST), size)
        steps.append(-(-along // _MOST))
        counts.append(along // steps[-1])
    n_pixels = counts[0] * counts[1]
    if min(counts) < _FEWEST:
        return np.zeros((0, n_pixels)), np.zeros((n_pixels, n_pixels)), np.ones((n_pixels, 1))
    found = [
        left[:, i0 : i0 + counts[0] * steps[0] : steps[0], j0 : j0 + counts[1] * steps[1] : steps[1]]
        for i0 in _starts(left.shape[1], counts[0], steps[0])
        for j0 in _starts(left.shape[2], counts[1], steps[1])
    ]
    values = np.concatenate([each.reshape(len(left), -1) for each in found])
    at = [np.arange(n) * step * apart for n, step, apart in zip(counts, steps, pitch, strict=True)]
    x, z = (each.ravel() for each in np.meshgrid(*at, indexing="ij"))
    apart = np.subtract.outer(x, x) ** 2 + np.subtract.outer(z, z) ** 2
    u, v = (2 * each / each.max() - 1 for each in (x, z))
    powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
    return values, apart, np.column_stack([u**i * v**j for i, j in powers])


def _starts(size: int, count: int, step: int) -> NDArray[Any]:
    """First pixels of the blocks along one side, such that no two blocks share a pixel."""
    blocks = np.arange(size // (count * step)) * count * step
    return np.asarray((blocks[:, None] + np.arange(step)).ravel())


@dataclass(frozen=True, eq=False)
class _RoughPart:
    """Residuals of smooth surfaces in blocks with the same available pixels.

    values (n_blocks, n), along an orthonormal basis (n_pixels, n); apart (n_pixels, n_pixels) : squared
    distances, mm2
    """

    values: Array
    apart: Array
    basis: Array


def _rough_parts(values: Array, apart: Array, surfaces: Array) -> list[_RoughPart]:
    """Group blocks by their available pixels.

    If any have gaps, only `_MOST_BLOCKS` evenly chosen blocks are used.
    """
    known = np.isfinite(values)
    if not known.all():
        chosen = np.unique(np.linspace(0, len(values) - 1, _MOST_BLOCKS).round().astype(np.int64))
        values, known = values[chosen], known[chosen]
    found = []
    for there in np.unique(known, axis=0):
        alike = (known == there).all(axis=1)
        basis = np.linalg.qr(surfaces[there], mode="complete")[0][:, surfaces.shape[1] :]
        found.append(_RoughPart(values[alike][:, there] @ basis, apart[np.ix_(there, there)], basis))
    return found


def _likeliest(parts: Sequence[_RoughPart]) -> tuple[float, float]:
    """Smoothing and share by maximum restricted likelihood, with the noise variance profiled out."""
    blocks = np.concatenate([np.full(part.values.shape[1], len(part.values)) for part in parts])
    n = int(blocks.sum())
    alone = n * float(np.log(sum(float((part.values**2).sum()) for part in parts) / n))
    best, found = alone, (0.0, 0.0)
    for s in _SCALES.tolist():
        decomposed = [
            np.linalg.eigh(part.basis.T @ np.exp(-part.apart / (4 * s**2)) @ part.basis) for part in parts
        ]
        own = np.concatenate([each for each, _ in decomposed])
        pairs = zip(parts, decomposed, strict=True)
        power = np.concatenate([((part.values @ vectors) ** 2).sum(axis=0) for part, (_, vectors) in pairs])

        def deviance(share: float, own: Array = own, power: Array = power) -> float:
            each = 1 - share + share * np.maximum(own, 0.0)
            return float(blocks @ np.log(each) + n * np.log((power / each).sum() / n))

        share = float(minimize_scalar(deviance, bounds=(0.0, _MOST_SHARE), method="bounded").x)
        if deviance(share) < best:
            best, found = deviance(share), (s, share)
    return found if (alone - best) / _TOGETHER > _GAIN else (0.0, 0.0)
