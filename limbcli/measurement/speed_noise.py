"""Uncertainty of a level's mean shear-wave speed: what the case states against what was measured.

Three measured figures can exceed the stated noise: the spread over the pixels of a level (`swe_sd_m_per_s`),
few pixels (`swe_pixels`), and the scatter of the levels about a smooth curve. The larger rules, and a
contradiction is reported.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.errors.problems import Problem
from limbcli.measurement.levels import Levels
from limbcli.measurement.number_table import RawTable, problem
from limbcli.model import Array, IntArray

# Ratios of measured to stated noise beyond which they contradict each other.
_WIDE, _NARROW = 3.0, 0.2  # spread over the pixels; it also holds what the tissue itself varies
_SCATTERED = 2.0  # scatter of the levels: 8 % by chance with three degrees of freedom would be 1.6
_LEAST_SCATTER = 0.03  # of ln speed: a smaller one may be the shape of the curve
_FEWEST_LEVELS, _FEWEST_CURVED = 5, 7  # for a scatter about a line, and about a parabola
_STANDS_OUT, _LEAST_OUT = 4.0, 0.25  # standard deviations, and ln speed, of a level off the others
_SLOWEST, _FASTEST = 0.3, 15.0  # m/s; speeds of single pixels of soft tissue


@dataclass(frozen=True)
class SpeedNoise:
    """Stated standard deviations of ln speed: common to a level's pixels, and of a single pixel."""

    level: float = 0.05
    pixel: float = 0.10


def mean_speed_deviation(levels: Levels, noise: SpeedNoise, *, with_scatter: bool = True) -> Array:
    """Standard deviation of ln of each level's mean speed (n_levels,).

    The larger of stated and measured spread is divided by the root of the number of pixels. If the number
    is unknown, pixel noise is neglected if there is noise common to all pixels and the spread agrees with
    the stated one; otherwise that of a single pixel is used, so that a missing count never makes a reading
    exact.

    with_scatter : also consider the scatter of the levels about a smooth curve, cycle by cycle
    """
    spread = np.nan_to_num(_spread(levels), nan=0.0)
    pixel = np.maximum(noise.pixel, spread)
    silent = (noise.level > 0) & (spread <= _WIDE * noise.pixel)
    unknown = np.where(silent, np.inf, 1.0)
    own = pixel / np.sqrt(
        np.maximum(np.where(np.isfinite(levels.swe_pixels), levels.swe_pixels, unknown), 1.0)
    )
    out = np.asarray(np.hypot(noise.level, own))
    for rows, scatter in _scattered(levels, out) if with_scatter else ():
        out[rows] = np.maximum(out[rows], scatter)
    return out


def check_speed_noise(
    levels: Levels, table: RawTable, path: Path, *, noise: SpeedNoise | None = None
) -> list[Problem]:
    """Impossible spreads and pixel counts, and contradictions between measured and stated noise."""
    stated = noise or SpeedNoise()
    found = [*_impossible(levels, table, path)]
    if found:
        return found
    return [*_spread_problems(levels, stated, table, path), *_scatter_problems(levels, stated, table, path)]


def _spread(levels: Levels) -> Array:
    """Standard deviation over mean, level by level (n_levels,); NaN where it was not measured or is 0."""
    spread = levels.swe_sd_m_per_s / levels.swe_mean_m_per_s
    return np.where(spread > 0, spread, np.nan)


def _impossible(levels: Levels, table: RawTable, path: Path) -> Iterator[Problem]:
    pixels, mean, spread = levels.swe_pixels, levels.swe_mean_m_per_s, levels.swe_sd_m_per_s
    for k in np.flatnonzero(np.isfinite(pixels) & (pixels != np.round(pixels))):
        what = f"swe_pixels is {pixels[k]:g}; a number of pixels is whole"
        fix = "correct it (is it an area?), or leave the cell empty if the number is not known"
        yield problem(what, path, fix, line=table.lines[k])
    # Bhatia & Davis (2000): no distribution between two ends with this mean has a larger variance
    most = np.sqrt(np.maximum((mean - _SLOWEST) * (_FASTEST - mean), 0.0))
    most *= np.sqrt(np.where(pixels >= 2, pixels / np.maximum(pixels - 1, 1), 2.0))
    for k in np.flatnonzero(spread > np.maximum(most, mean)):
        what = (
            f"swe_sd_m_per_s is {spread[k]:g}, but speeds of {_SLOWEST:g} to {_FASTEST:g} m/s with a mean of "
            f"{mean[k]:g} have at most {most[k]:.3g}"
        )
        yield problem(what, path, "is it in m/s, and of this level?", line=table.lines[k])


def _spread_problems(levels: Levels, noise: SpeedNoise, table: RawTable, path: Path) -> Iterator[Problem]:
    spread, pixels = levels.swe_sd_m_per_s / levels.swe_mean_m_per_s, levels.swe_pixels
    zero = np.flatnonzero((levels.swe_sd_m_per_s == 0) & ~(pixels == 1))
    if len(zero):
        what = f"swe_sd_m_per_s is 0 {_levels(zero)}: pixels of tissue are never all equal"
        fix = "leave the cell empty if it was not measured; the noise of [site.noise] is used"
        yield problem(what, path, fix, line=table.lines[zero[0]], warning=True)
    single = np.flatnonzero((levels.swe_sd_m_per_s > 0) & (pixels == 1))
    if len(single):
        what = f"swe_sd_m_per_s is given {_levels(single)} for a single pixel, which has no spread"
        fix = "correct swe_pixels, or leave it empty if the number is not known"
        yield problem(what, path, fix, line=table.lines[single[0]], warning=True)
    wide = np.flatnonzero(spread > _WIDE * noise.pixel)
    if len(wide) and noise.pixel > 0:
        k = int(wide[np.argmax(spread[wide])])
        what = (
            f"swe_sd_m_per_s is up to {spread[k]:.0%} of the mean {_levels(wide)}, "
            f"{spread[k] / noise.pixel:.1f} times swe_pixel_fraction ({noise.pixel:g})"
        )
        fix = (
            "the larger is used for the interval of c; check the region of interest (other tissue, pixels "
            "without a signal), or state the noise of a pixel in [site.noise]"
        )
        yield problem(what, path, fix, line=table.lines[k], warning=True)
    narrow = np.flatnonzero((spread > 0) & (spread < _NARROW * noise.pixel))
    if len(narrow):
        k = int(narrow[np.argmin(spread[narrow])])
        what = (
            f"swe_sd_m_per_s is only {spread[k]:.2g} of the mean {_levels(narrow)}, "
            f"{spread[k] / noise.pixel:.2g} times swe_pixel_fraction ({noise.pixel:g})"
        )
        fix = "the stated noise is used; is it a standard error, or in another unit?"
        yield problem(what, path, fix, line=table.lines[k], warning=True)


def _scatter_problems(levels: Levels, noise: SpeedNoise, table: RawTable, path: Path) -> Iterator[Problem]:
    stated = mean_speed_deviation(levels, noise, with_scatter=False)
    for rows in _curves(levels):
        for k, apart in _standing_out(levels, rows, stated):
            way = "above" if apart > 0 else "below"
            what = (
                f"swe_mean_m_per_s is {levels.swe_mean_m_per_s[k]:g}, {np.exp(abs(apart)):.2g} times {way} "
                "what the other levels give"
            )
            fix = "check this reading or leave its cells empty"
            fix += "; c comes from the speed of the first level" if k == 0 else ""
            yield problem(what, path, fix, line=table.lines[k], warning=True)
    for rows, scatter in _scattered(levels, stated):
        usual = float(np.median(stated[rows]))
        what = f"the speeds of the levels scatter by {scatter:.0%} about a smooth curve" + (
            f", {scatter / usual:.1f} times their stated noise ({usual:.1%})" if usual > 0 else ""
        )
        fix = "the larger is used for the interval of c; check the readings, or state swe_level_fraction"
        yield problem(what, path, fix, line=table.lines[rows[0]], warning=True)


def _scattered(levels: Levels, stated: Array) -> Iterator[tuple[IntArray, float]]:
    """Levels of each loading and their scatter (of ln speed), where it exceeds the stated deviations."""
    for rows in _curves(levels):
        curve, force = np.log(levels.swe_mean_m_per_s[rows]), levels.force[rows]
        left, n_free = _residual(force, curve)
        scatter = float(np.sqrt(np.sum(left**2) / n_free))
        if scatter > _LEAST_SCATTER and scatter > _SCATTERED * float(np.median(stated[rows])):
            yield rows, scatter


def _standing_out(levels: Levels, rows: IntArray, stated: Array) -> Iterator[tuple[int, float]]:
    """Levels far from a curve through all others of their loading: (row, difference of ln speed)."""
    curve, force = np.log(levels.swe_mean_m_per_s[rows]), levels.force[rows]
    for k, row in enumerate(rows):
        others = np.arange(len(rows)) != k
        degree = 1 if k in (0, len(rows) - 1) else _degree(len(rows) - 1)
        polynomial = np.polynomial.Polynomial.fit(force[others], curve[others], degree)
        left = curve[others] - polynomial(force[others])
        usual = max(float(np.sqrt(np.mean(left**2))), float(stated[row]))
        apart = float(curve[k] - polynomial(force[k]))
        if abs(apart) > max(_STANDS_OUT * usual, _LEAST_OUT):
            yield int(row), apart


def _curves(levels: Levels) -> Iterator[IntArray]:
    """Rows of each loading with enough speeds at different forces for a scatter."""
    seen = levels.loading & (np.nan_to_num(levels.swe_mean_m_per_s) > 0)
    for cycle in levels.cycles:
        rows = np.flatnonzero(seen & (levels.cycle == cycle))
        if len(np.unique(levels.force[rows])) >= _FEWEST_LEVELS:
            yield rows


def _residual(force: Array, curve: Array) -> tuple[Array, int]:
    degree = _degree(len(force))
    polynomial = np.polynomial.Polynomial.fit(force, curve, degree)
    return curve - polynomial(force), len(force) - degree - 1


def _degree(n: int) -> int:
    return 2 if n >= _FEWEST_CURVED else 1


def _levels(rows: IntArray) -> str:
    """
    >>> _levels(np.array([3])), _levels(np.array([0, 1]))
    ('at level 3', 'at 2 levels')
    """
    return f"at level {rows[0]}" if len(rows) == 1 else f"at {len(rows)} levels"
