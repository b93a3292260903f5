"""Objectives: the residuals that a fit minimises."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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


def force_residual(predict: Predictor, measured: Array) -> Objective:
    """F_exp - F_sim at the measured depths: the paper's objective, unweighted."""

    def objective(theta: Array, derivative: bool = True) -> Residual:
        prediction = predict(theta, derivative=derivative)
        jacobian = prediction.jacobian
        return Residual(measured - prediction.values, None if jacobian is None else -jacobian)

    return objective
