"""Probability that a normal distribution gives to a box, and quantiles of mixtures of truncated ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, ndtr

from limbcli.model import Array

_FAR = 8.0  # standard deviations beyond which a limit does not matter
_GRID = 2001  # points of a numerical quantile


def ln_probability(mean: Array, covariance: Array, low: Array, high: Array) -> Array:
    """ln of the probability of the box, (n,), for each of the means (n, p).

    One limit after the other, with mean and variance of the truncated distribution carried on; exact in one
    dimension and for independent ones.

    Source: Mendell & Elston 1974, Biometrics 30:41.

    >>> round(float(ln_probability(np.zeros((1, 1)), np.eye(1), np.zeros(1), np.full(1, np.inf))[0]), 4)
    -0.6931
    """
    mean, covariance = np.array(mean, dtype=float), np.array(covariance, dtype=float)
    total = np.zeros(len(mean))
    for k in range(mean.shape[1]):
        deviation = np.sqrt(max(covariance[k, k], 1e-300))
        if np.all(low[k] - mean[:, k] < -_FAR * deviation) and np.all(
            high[k] - mean[:, k] > _FAR * deviation
        ):
            continue
        a, b = (low[k] - mean[:, k]) / deviation, (high[k] - mean[:, k]) / deviation
        ln_p = _ln_between(a, b)
        total += ln_p
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            at_a, at_b = (
                np.where(np.isfinite(x), np.exp(-0.5 * x**2 - ln_p) / np.sqrt(2 * np.pi), 0.0) for x in (a, b)
            )
            first = at_a - at_b
            lost = first**2 - np.nan_to_num(a * at_a) + np.nan_to_num(b * at_b)
        onto = covariance[:, k] / deviation
        later = slice(k + 1, None)
        mean[:, later] += first[:, None] * onto[later]
        # one covariance for all: that of the mean loss, exact for a single mean
        covariance[later, later] -= float(np.clip(np.mean(lost), 0.0, 1.0)) * np.outer(
            onto[later], onto[later]
        )
    return total


def _ln_between(a: Array, b: Array) -> Array:
    """ln(Phi(b) - Phi(a)), accurate in either tail."""
    flip = a + b > 0
    low, high = np.where(flip, -b, a), np.where(flip, -a, b)
    upper, lower = log_ndtr(high), log_ndtr(low)
    return upper + np.log1p(-np.exp(np.minimum(lower - upper, -1e-12)))


@dataclass(frozen=True)
class Truncated:
    """A normal distribution between two limits, with a weight."""

    weight: float
    mean: float
    deviation: float
    low: float = -np.inf
    high: float = np.inf


def quantiles(several: Sequence[Truncated], shares: Sequence[float]) -> list[float]:
    """Quantiles of a mixture.

    >>> [round(x, 2) for x in quantiles([Truncated(1.0, 1.0, 1.0)], (0.025, 0.5))]
    [-0.96, 1.0]
    """
    x, total = _distribution(several)
    return [float(np.interp(share, total, x)) for share in shares]


def shortest(several: Sequence[Truncated], share: float) -> tuple[float, float]:
    """The shortest interval of a mixture with this probability: it begins at a limit that is most probable.

    >>> low, high = shortest([Truncated(1.0, -1.0, 1.0, low=0.0)], 0.95)
    >>> low, round(high, 2)
    (0.0, 1.41)
    """
    x, total = _distribution(several)
    below = np.linspace(0.0, 1.0 - share, _GRID)
    low, high = np.interp(below, total, x), np.interp(below + share, total, x)
    low[0], high[-1] = (
        x[max(int(np.searchsorted(total, 0.0, side="right")) - 1, 0)],
        x[np.searchsorted(total, 1.0)],
    )
    best = int(np.argmin(high - low))
    return float(low[best]), float(high[best])


def _distribution(several: Sequence[Truncated]) -> tuple[Array, Array]:
    """Values, and the probability of what is below them."""
    ends = [
        (max(each.low, min(each.mean, each.high) - _FAR * each.deviation),
         min(each.high, max(each.mean, each.low) + _FAR * each.deviation)) for each in several
    ]  # fmt: skip
    # finely where each of them is narrow
    x = np.unique(np.concatenate([np.linspace(low, high, _GRID) for low, high in ends]))
    total = np.zeros(len(x))
    for each in several:
        a, b, at = ((end - each.mean) / each.deviation for end in (each.low, each.high, x))
        inside = np.clip(at, a, b)
        if a > 0:  # of the small numbers, not their differences from 1
            share = (ndtr(-a) - ndtr(-inside)) / max(ndtr(-a) - ndtr(-b), 1e-300)
        else:
            share = (ndtr(inside) - ndtr(a)) / max(ndtr(b) - ndtr(a), 1e-300)
        total += each.weight * share
    return x, total / max(total[-1], 1e-300)
