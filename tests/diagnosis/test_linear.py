"""What a fit leaves, where data alone decide and where a prior or a bound held it: against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.diagnosis.explanations.noise import LinearFit
from limbcli.numbers.whitening import Whitener


def _held(rng, weight: float, *, n: int = 14, free: int = 2, held: int = 2):
    """Residual and Jacobian of least squares whose last parameters a prior of this weight draws to 0."""
    J = rng.standard_normal((n, free + held))
    y = J @ np.r_[np.ones(free), np.full(held, 8.0)] + rng.standard_normal(n)
    prior = np.diag([0.0] * free + [weight] * held)
    theta = np.linalg.solve(J.T @ J + prior, J.T @ y)
    return y - J @ theta, J


def test_free_parameters_leave_what_least_squares_leave(rng):
    residual, J = _held(rng, 0.0)
    for as_it_stands in (False, True):
        state = LinearFit.of(residual, J, as_it_stands=as_it_stands)
        assert state.chi2 == pytest.approx(residual @ residual, rel=1e-12)
        assert state.nu == 10


@pytest.mark.parametrize("weight", [10.0, 1e4])
def test_a_fit_that_a_prior_holds_is_judged_where_it_stands(rng, weight):
    residual, J = _held(rng, weight)
    state = LinearFit.of(residual, J, as_it_stands=True)
    assert LinearFit.of(residual, J).chi2 < 0.9 * state.chi2  # where no prior would be
    assert state.chi2 == pytest.approx(residual @ residual, rel=1e-12)
    assert state.nu == 11
    assert np.abs(state.project(J[:, :2])).max() < 1e-12  # what data decide alone is followed as before


def test_on_average_a_direction_that_is_just_not_followed_costs_as_much_as_it_counts():
    """One deviation of chi2 for one degree of freedom, at the threshold."""
    J = np.eye(6)[:, :2]
    below = LinearFit.of(np.array([0.0, 0.999, 2.0, 0, 0, 0]), J, as_it_stands=True)
    above = LinearFit.of(np.array([0.0, 1.001, 2.0, 0, 0, 0]), J, as_it_stands=True)
    assert above.chi2 - below.chi2 == pytest.approx(above.nu - below.nu, abs=0.01)


def test_at_a_corner_of_the_model_its_slopes_reach_nothing():
    """Slopes of -1 and 2 beside it: it is the least there is, and the central one of 0.5 leads nowhere."""
    residual = np.array([3.0, 1.0])
    state = LinearFit.of(residual, np.array([[0.5], [0.0]]), as_it_stands=True)
    assert (state.chi2, state.nu) == (pytest.approx(10.0), 2)
    assert LinearFit.of(residual, np.array([[0.5], [0.0]])).chi2 == pytest.approx(1.0)


def test_what_is_no_number_is_not_whitened() -> None:
    """A prediction without an answer must stop a test, not pass it."""
    with pytest.raises(ValueError, match="NaN"):
        Whitener.of(np.eye(3))(np.array([1.0, np.nan, 2.0]))
