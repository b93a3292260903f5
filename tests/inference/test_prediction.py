"""Differences, memory, and reading a curve at measured depths."""

import numpy as np
import pytest

from limbcli.errors import SolveError
from limbcli.inference.prediction import Differences, SolvedPoints, sampled
from limbcli.inference.two_step_fit import CurveMatch

KNOTS = np.linspace(1.0, 10.0, 10)


def test_differences_approach_the_derivative(simulated):
    exact = simulated.curve(KNOTS, 0.008)(np.array([20.0, 3.0]), (0, 1)).jacobian
    wrapped = Differences(
        lambda theta: simulated.force(KNOTS, 0.008, *theta), upper=(1000.0, 100.0), relative_step=1e-5
    )
    np.testing.assert_allclose(wrapped(np.array([20.0, 3.0]), (0, 1)).jacobian, exact, rtol=1e-3, atol=1e-9)


def test_differences_run_side_by_side_and_only_what_is_asked(simulated):
    batches = []

    def run_all(evaluate, thetas):
        batches.append(list(thetas))
        return map(evaluate, batches[-1])

    wrapped = Differences(
        lambda theta: simulated.force(KNOTS, 0.008, *theta), upper=(1000.0, 100.0), run_all=run_all
    )
    answer = wrapped(np.array([20.0, 3.0]), (0,))
    assert [len(each) for each in batches] == [2]
    assert np.isfinite(answer.jacobian[:, 0]).all()
    assert np.isnan(answer.jacobian[:, 1]).all()
    wrapped(np.array([20.0, 3.0]), (0, 1))
    assert [len(each) for each in batches] == [2, 2], "the base point is not run again"
    assert wrapped.n_solves == 4


def test_differences_stay_inside_the_upper_bound(simulated):
    tried = []

    def evaluate(theta):
        tried.append(theta.copy())
        return simulated.force(KNOTS, 0.008, *theta)

    wrapped = Differences(evaluate, upper=(1000.0, 100.0))
    assert wrapped(np.array([1000.0, 3.0]), (0,)).jacobian[0, 0] > 0
    assert np.max(tried) <= 1000.0


def test_a_shift_without_answer_is_made_the_other_way(simulated):
    def fragile(theta):
        if theta[1] > 3.0:
            raise SolveError("stopped", where="here", fix="none")
        return simulated.force(KNOTS, 0.008, *theta)

    exact = simulated.curve(KNOTS, 0.008)(np.array([20.0, 3.0]), (0, 1)).jacobian
    wrapped = Differences(fragile, upper=(1000.0, 100.0), relative_step=1e-4)
    np.testing.assert_allclose(wrapped(np.array([20.0, 3.0]), (0, 1)).jacobian, exact, rtol=1e-2, atol=1e-8)
    with pytest.raises(SolveError):
        wrapped(np.array([20.0, 3.5]))


def test_memory_never_solves_the_same_twice(simulated):
    memory = SolvedPoints(simulated.curve(KNOTS, 0.008))
    for theta in ((20.0, 3.0), (30.0, 3.0), (20.0, 3.0)):
        memory(np.array(theta), (0, 1))
    assert memory.n_solves == 2
    assert [tuple(theta) for theta, _ in memory.solved] == [(20.0, 3.0), (30.0, 3.0)]


def test_sampled_derivative_follows_the_chain_rule(simulated, rng):
    depths = np.r_[-0.2, 0.0, rng.uniform(0.1, 10.0, 8)]
    memory = SolvedPoints(simulated.curve(KNOTS, 0.008))
    predict = sampled(memory, KNOTS, depths, free=(1,), fixed=np.array([20.0, 2.0]))
    step = 1e-5
    up, down = (predict(np.array([3.0 + s * step]), derivative=False).values for s in (1, -1))
    answer = predict(np.array([3.0]))
    np.testing.assert_allclose(answer.jacobian[:, 0], (up - down) / (2 * step), rtol=1e-5, atol=1e-9)
    assert np.all(answer.values[:2] == 0.0), "no force before first touch"


def test_slopes_are_those_of_the_curve(simulated):
    match = CurveMatch(SolvedPoints(simulated.curve(KNOTS, 0.008)), KNOTS, None)
    depth, step = np.array([4.0, 7.0]), 1e-4
    rise = simulated.force(depth + step, 0.008, 20.0, 3.0) - simulated.force(depth - step, 0.008, 20.0, 3.0)
    found = match.sample(np.array([20.0, 3.0]), depth)
    np.testing.assert_allclose(found.slopes, rise / (2 * step), rtol=0.02)
