"""A doubt of the model's shape as covariance: exact against the closed form, never a gain in sureness."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.inference.geometry_uncertainty import at_depths, shifts, whitened
from limbcli.inference.residual import Residual


def test_whitening_gives_the_likelihood_of_the_full_covariance(rng):
    n = 6
    values, jacobian = rng.normal(size=n + 1), rng.normal(size=(n + 1, 2))
    deviation, spread = rng.uniform(0.5, 2.0, n), rng.normal(size=(n, 2))
    white = whitened(lambda *_: Residual(values, jacobian), deviation, spread)(np.zeros(2), True)
    raw = values[:n] * deviation
    covariance = np.diag(deviation**2) + spread @ spread.T
    assert white.cost == pytest.approx(raw @ np.linalg.solve(covariance, raw) + values[n] ** 2)
    slope = (jacobian[:n] * deviation[:, None]).T @ np.linalg.solve(covariance, raw)
    assert white.jacobian.T @ white.values == pytest.approx(slope + jacobian[n] * values[n])


def test_a_mode_like_a_parameter_moves_that_parameter_alone(rng):
    columns = rng.normal(size=(8, 2))
    moved = np.stack([0.3 * columns[:, 1], columns[:, 0] - columns[:, 1]], axis=1)
    assert shifts(columns, moved) == pytest.approx(np.array([[0.0, 0.3], [1.0, -1.0]]))


def test_modes_are_read_at_the_measured_depths():
    assert at_depths(np.array([[0.0, 2.0]]), np.array([1.0, 2.0]), np.array([1.5, 9.0])).ravel() == (
        pytest.approx([1.0, 2.0])
    )
