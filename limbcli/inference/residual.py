"""Objectives: the residuals that a fit minimises."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from limbcli.inference.prediction import Predictor
from limbcli.model import Array


@dataclass(frozen=True, eq=False)
class Residual:
    """values (n,), and jacobian (n, n_parameters) d value / d theta, or None."""

    values: Array
    jacobian: Array | None = None

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.values @ self.values)


Objective = Callable[[Array, bool], Residual]


def force_residual(predict: Predictor, measured: Array, *, deviation: Array | None = None) -> Objective:
    """F_exp - F_sim at the measured depths: the paper's objective, unweighted.

    deviation : (n,) standard deviation of each residual; if given, the residual is divided by it
    """
    weight = np.ones_like(measured) if deviation is None else 1.0 / deviation

    def objective(theta: Array, derivative: bool = True) -> Residual:
        prediction = predict(theta, derivative=derivative)
        jacobian = prediction.jacobian
        return Residual(
            weight * (measured - prediction.values),
            None if jacobian is None else -weight[:, None] * jacobian,
        )

    return objective


def with_prior(objective: Objective, index: int, *, mean: float, log_deviation: float) -> Objective:
    """The objective extended by a prior residual: ln(theta_index / mean) / log_deviation."""

    def extended(theta: Array, derivative: bool = True) -> Residual:
        base = objective(theta, derivative)
        values = np.append(base.values, np.log(theta[index] / mean) / log_deviation)
        if base.jacobian is None:
            return Residual(values)
        row = np.zeros((1, len(theta)))
        row[0, index] = 1.0 / (theta[index] * log_deviation)
        return Residual(values, np.vstack([base.jacobian, row]))

    return extended
