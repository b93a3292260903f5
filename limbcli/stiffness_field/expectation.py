"""Expectation propagation: normal approximations of likelihoods that are not normal.

Each likelihood is replaced by a normal one (a reading with its variance), such that the posterior's mean and
variance at that reading are those with the likelihood itself, given all the others. Here every likelihood is
log-concave, so that the variances are positive and the iteration settles.

Source: Minka 2001, UAI 17:362; Rasmussen and Williams 2006, section 3.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.model import Array
from limbcli.stiffness_field.likelihood import Bound, Known

_SWEEPS, _STILL = 50, 1e-6
_LEAST_PRECISION = 1e-9  # of a likelihood that says nothing where the posterior lies


@dataclass(frozen=True, eq=False)
class NormalReadings:
    """Readings (n,) and variances (n,) that stand for the likelihoods; ln of their sizes in the evidence."""

    values: Array
    variance: Array
    log_size: float


def normal_readings(likelihoods: Sequence[Known | Bound], mean: Array, covariance: Array) -> NormalReadings:
    """Readings that stand for the likelihoods of n jointly normal quantities: mean (n,), covariance
    (n, n)."""
    n = len(likelihoods)
    precision, shift = np.full(n, _LEAST_PRECISION), np.full(n, _LEAST_PRECISION) * mean
    after_mean, after = mean.copy(), covariance.copy()
    sizes = np.zeros(n)
    for _ in range(_SWEEPS):
        before = after_mean.copy()
        for k, likelihood in enumerate(likelihoods):
            own = 1.0 / max(1.0 / after[k, k] - precision[k], 1e-12)
            without = own * (after_mean[k] / after[k, k] - shift[k])
            sizes[k], first, second = likelihood.moments(float(without), float(own))
            new = max(1.0 / second - 1.0 / own, _LEAST_PRECISION)
            change, precision[k] = new - precision[k], new
            shift_change, shift[k] = -shift[k], first * (new + 1.0 / own) - without / own
            shift_change += shift[k]
            column = after[:, k].copy()
            after_mean = after_mean + column * (shift_change - change * after_mean[k]) / (
                1.0 + change * column[k]
            )
            after = after - np.outer(column, column) * change / (1.0 + change * column[k])
        if np.max(np.abs(after_mean - before), initial=0.0) < _STILL:
            break
    values, variance = shift / precision, 1.0 / precision
    for k in range(n):
        own = 1.0 / max(1.0 / after[k, k] - precision[k], 1e-12)
        without = own * (after_mean[k] / after[k, k] - shift[k])
        size, _, _ = likelihoods[k].moments(float(without), float(own))
        spread = own + variance[k]
        sizes[k] = size + 0.5 * ((without - values[k]) ** 2 / spread + np.log(2.0 * np.pi * spread))
    return NormalReadings(values, variance, float(sizes.sum()))
