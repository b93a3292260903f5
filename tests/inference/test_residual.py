"""Objectives: values and derivatives belong together."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.inference.prediction import Prediction
from limbcli.inference.residual import force_residual, with_prior


def predict(theta: np.ndarray, *, derivative: bool = True) -> Prediction:
    depth = np.array([1.0, 2.0, 4.0])
    jacobian = np.column_stack([depth**2, 2 * theta[1] * depth])
    return Prediction(theta[0] * depth**2 + theta[1] ** 2 * depth, jacobian if derivative else None)


@pytest.mark.parametrize("deviation", [None, np.array([0.1, 0.2, 0.5])])
def test_jacobian_is_the_derivative_of_the_values(deviation, rng):
    objective = force_residual(predict, rng.normal(5, 1, 3), deviation=deviation)
    objective = with_prior(objective, 1, mean=2.0, log_deviation=0.3)
    theta = rng.uniform(1, 3, 2)
    found = objective(theta, True)
    for k in range(2):
        step = np.zeros(2)
        step[k] = 1e-6
        difference = (objective(theta + step, False).values - objective(theta - step, False).values) / 2e-6
        np.testing.assert_allclose(found.jacobian[:, k], difference, rtol=1e-7, atol=1e-8)


def test_a_prior_counts_deviations_of_the_logarithm_from_its_mean():
    objective = with_prior(force_residual(predict, np.zeros(3)), 1, mean=2.0, log_deviation=0.3)
    reported = [objective(np.array([1.0, theta]), False).values[-1] for theta in (2.0, 2.0 * np.exp(0.6))]
    assert reported == pytest.approx([0.0, 2.0])


def test_measured_forces_that_are_too_large_give_positive_residuals():
    residual = force_residual(predict, np.full(3, 100.0))(np.ones(2), False)
    assert (residual.values > 0).all()
