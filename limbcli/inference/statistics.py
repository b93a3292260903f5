"""Goodness of fit by the measures that the paper uses."""

from __future__ import annotations

import numpy as np

from limbcli.model import Array


def coefficient_of_determination(measured: Array, simulated: Array) -> float:
    """R2 = 1 - SS_residual / SS_total; NaN where the data do not vary.

    For a monotone curve R2 is near 1 for any monotone model, so it is no evidence of a good fit.

    >>> coefficient_of_determination(np.array([0.0, 2.0, 4.0]), np.array([0.0, 2.0, 4.0]))
    1.0
    >>> coefficient_of_determination(np.array([0.0, 2.0, 4.0]), np.array([0.0, 2.0, 2.0]))
    0.5
    """
    total = float(np.sum((measured - measured.mean()) ** 2))
    return 1.0 - float(np.sum((measured - simulated) ** 2)) / total if total > 0.0 else float("nan")


def root_mean_square(residual: Array) -> float:
    """
    >>> root_mean_square(np.array([0.0, -10.0, 0.0, 0.0]))
    5.0
    """
    return float(np.sqrt(np.mean(residual**2)))
