"""Objectives: values and derivatives belong together."""

from __future__ import annotations

import numpy as np

from limbcli.inference.prediction import Prediction, force_residual


def predict(theta: np.ndarray, *, derivative: bool = True) -> Prediction:
    depth = np.array([1.0, 2.0, 4.0])
    jacobian = np.column_stack([depth**2, 2 * theta[1] * depth])
    return Prediction(theta[0] * depth**2 + theta[1] ** 2 * depth, jacobian if derivative else None)


def test_jacobian_is_the_derivative_of_the_values(rng):
    objective = force_residual(predict, rng.normal(5, 1, 3))
    theta = rng.uniform(1, 3, 2)
    found = objective(theta, True)
    for k in range(2):
        step = np.zeros(2)
        step[k] = 1e-6
        difference = (objective(theta + step, False).values - objective(theta - step, False).values) / 2e-6
        np.testing.assert_allclose(found.jacobian[:, k], difference, rtol=1e-7, atol=1e-8)


def test_measured_forces_that_are_too_large_give_positive_residuals():
    residual = force_residual(predict, np.full(3, 100.0))(np.ones(2), False)
    assert (residual.values > 0).all()
