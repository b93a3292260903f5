"""The residuals that a fit minimises, and its goodness by the measures that the paper uses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from limbcli.inference.prediction import Prediction, Predictor
from limbcli.model import Array


class Residual(Prediction):
    """Predicted minus measured values, or the reverse."""

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.values @ self.values)


Objective = Callable[[Array, bool], Residual]


def force_residual(predict: Predictor, measured: Array) -> Objective:
    """F_exp - F_sim at the measured depths: the paper's objective, unweighted."""

    def objective(theta: Array, derivative: bool = True) -> Residual:
        prediction = predict(theta, derivative=derivative)
        jacobian = prediction.jacobian
        return Residual(measured - prediction.values, None if jacobian is None else -jacobian)

    return objective


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
