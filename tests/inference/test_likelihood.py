"""Blocks of the likelihood: covariance, priors, and what is simulated where blocks share a curve."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from limbcli.inference.likelihood import ForceBlock, Likelihood, Place
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.surrogate import Emulator

C0, KNOTS = 0.008, np.linspace(1.0, 10.0, 8)
THETA = np.array([1.1 * C0, 40.0, 3.0, 1.02])
NAMES = ("c", "f_kappa", "m", "gain")


def memory_of(simulated) -> SolvedPoints:
    memory = SolvedPoints(simulated.curve(KNOTS, C0))
    for place in ([100.0, 2.0], [20.0, 4.0], [50.0, 3.0]):
        memory(np.array(place), (0, 1))
    return memory


def block_of(emulator: Emulator, covariance: np.ndarray, shift: float = 0.0) -> ForceBlock:
    place = Place.of(
        4, c0=C0, shape=(), gain=3, offset=np.array([0.0, shift]), factors=np.eye(4)[[1, 2]]
    )  # fmt: skip
    force = np.linspace(1.0, 12.0, 5)
    return ForceBlock(emulator, place, KNOTS, np.linspace(1.5, 9.0, 5), force, covariance, np.full(5, 0.6))


def likelihood_of(blocks: list[ForceBlock]) -> Likelihood:
    parameters = [
        FitParameter(name, start, start / 10, start * 10, "log")
        for name, start in zip(NAMES, THETA, strict=True)
    ]
    priors = [(0, C0, 0.2), (3, 1.0, 0.05)]
    return Likelihood(parameters, blocks, [THETA], profiled=(1, 2), priors=priors, n_shape=2)


@pytest.fixture
def covariance(rng: np.random.Generator) -> np.ndarray:
    spread = rng.normal(size=(5, 2))
    return np.diag(rng.uniform(0.5, 2.0, 5)) + spread @ spread.T


def test_the_cost_is_that_of_the_full_covariance_and_the_priors(simulated, covariance):
    emulator = Emulator(memory_of(simulated))
    plain = block_of(emulator, np.eye(5)).residual(THETA)[0]
    found = likelihood_of([block_of(emulator, covariance)]).objective()(THETA, True)
    priors = (np.log(1.1) / 0.2) ** 2 + (np.log(1.02) / 0.05) ** 2
    assert found.cost == pytest.approx(plain @ np.linalg.solve(covariance, plain) + priors)


def test_slopes_are_those_of_differences(simulated, covariance):
    residual = likelihood_of([block_of(Emulator(memory_of(simulated)), covariance)]).objective()
    exact = residual(THETA, True).jacobian
    for k in range(4):
        up, down = THETA.copy(), THETA.copy()
        up[k], down[k] = THETA[k] * (1 + 1e-5), THETA[k] * (1 - 1e-5)
        rise = (residual(up, True).values - residual(down, True).values) / (2e-5 * THETA[k])
        np.testing.assert_allclose(
            exact[:, k], rise, rtol=1e-4, atol=1e-6 * abs(rise).max(), err_msg=NAMES[k]
        )


def test_only_parameters_of_the_curve_are_simulated_and_only_free_ones_count(simulated):
    problem = likelihood_of([block_of(Emulator(memory_of(simulated)), np.eye(5))])
    assert (problem.simulated, problem.n_freedom) == ((1, 2), 5 - 2)


def test_of_blocks_on_one_curve_the_sure_ones_are_not_simulated_again(simulated):
    memory = memory_of(simulated)
    emulator = Emulator(memory)
    near, far = block_of(emulator, 1e6 * np.eye(5)), block_of(emulator, 1e-6 * np.eye(5), shift=0.9)
    problem, before = likelihood_of([near, far]), len(memory.solved)
    problem.solve(THETA)
    assert len(memory.solved) == before + 1
    np.testing.assert_allclose(memory.solved[-1][0], [40.0, 3.0 * np.exp(0.9)])


def test_a_simulation_is_at_most_one_step_factor_beyond_the_solved_points(simulated):
    problem = likelihood_of([block_of(Emulator(memory_of(simulated)), np.eye(5))])
    near = problem.within_reach(np.array([C0, 5000.0, 1e-3, 1.0]))
    np.testing.assert_allclose(near, [C0, 1000.0, 0.2, 1.0])


def test_a_parameter_that_enters_by_its_reciprocal_is_not_taken_for_c(simulated):
    """As the stretch of a state does: simulations step outwards in the law's shape, c keeps its value."""
    reciprocal = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0]])
    place = Place.of(4, c0=C0, shape=(), offset=np.log([1.0, 3.0]), factors=reciprocal)
    plain = block_of(Emulator(memory_of(simulated)), np.eye(5))
    problem = likelihood_of([dataclasses.replace(plain, place=place)])
    far = THETA * [1.0, 1e3, 1.0, 1.0]
    near = problem.within_reach(far)
    assert near[1] < far[1]
    assert near[[0, 2, 3]].tolist() == far[[0, 2, 3]].tolist()
