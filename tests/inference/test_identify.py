"""The two steps, on a cheap limb."""

import numpy as np
import pytest

from limbcli.errors import FitError
from limbcli.inference.prediction import Differences, SolvedPoints
from limbcli.inference.two_step_fit import CurveMatch, ForceDepth, sensitivities, two_step
from limbcli.progress import Progress

DEPTH = np.linspace(0.0, 10.0, 12)
C = 0.008


def measurement(simulated, truth, kind, rng=None):
    force, depth = simulated.force(DEPTH, C, *truth, kind), DEPTH.copy()
    if rng is not None:
        force, depth = force + 0.1 * rng.standard_normal(12), depth + 0.3 * rng.standard_normal(12)
        depth[0] = 0.0
    return ForceDepth(force, depth, 0.1, 0.3)


@pytest.mark.parametrize("kind", ["tet4", "tet10"])
@pytest.mark.parametrize("truth", [(150.0, 3.0), (8.0, 6.0), (650.0, 1.2)])
def test_parameters_are_recovered_from_exact_data(simulated, kind, truth):
    data = measurement(simulated, truth, kind)
    first, second = two_step(CurveMatch(SolvedPoints(simulated.curve(DEPTH[1:], C, kind)), DEPTH[1:], data))
    assert first.theta[1] == 2.0
    assert first.fit.parameters[0].start == 100.0
    np.testing.assert_allclose(second.theta, truth, rtol=0.01)
    assert second.r2 > 0.99999
    assert second.rmse < 0.01
    assert second.fit.cost <= first.fit.cost


@pytest.mark.slow
def test_differences_lead_to_the_same_answer(simulated):
    data = measurement(simulated, (150.0, 3.0), "tet4")
    curve = Differences(lambda theta: simulated.force(DEPTH[1:], C, *theta, "tet4"), upper=(1000.0, 100.0))
    memory = SolvedPoints(curve)
    _, second = two_step(CurveMatch(memory, DEPTH[1:], data))
    np.testing.assert_allclose(second.theta, (150.0, 3.0), rtol=0.01)
    assert memory.n_solves == curve.n_solves


def test_data_stiffer_than_any_parameters_end_on_the_bounds(simulated):
    data = measurement(simulated, (100.0, 1.0), "tet10")
    soft = ForceDepth(0.5 * data.force, data.depth, 0.1, 0.3)
    _, second = two_step(CurveMatch(SolvedPoints(simulated.curve(DEPTH[1:], C)), DEPTH[1:], soft))
    assert second.fit.parameters[0].at_bound(second.theta[0]) == "low"
    assert second.fit.parameters[1].at_bound(second.theta[1]) == "low"


def test_progress_tells_every_iteration(simulated):
    seen = []
    progress = Progress(lambda kind, facts: seen.append((kind, facts["parameters"])))
    data = measurement(simulated, (150.0, 3.0), "tet4")
    first, second = two_step(
        CurveMatch(SolvedPoints(simulated.curve(DEPTH[1:], C, "tet4")), DEPTH[1:], data), progress=progress
    )
    assert len(seen) == first.fit.n_iterations + second.fit.n_iterations
    assert set(seen[-1][1]) == {"f_kappa", "m"}


def test_too_few_levels_are_an_error(simulated):
    data = ForceDepth(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0]), 0.1, 0.3)
    with pytest.raises(FitError, match="at least three"):
        two_step(CurveMatch(SolvedPoints(simulated.curve(DEPTH[1:], C)), DEPTH[1:], data))


def test_sensitivities_are_those_of_the_logs(simulated):
    data = measurement(simulated, (150.0, 3.0), "tet4")
    memory = SolvedPoints(simulated.curve(DEPTH[1:], C, "tet4"))
    theta = np.array([150.0, 3.0])
    answer = sensitivities(CurveMatch(memory, DEPTH[1:], data), theta)
    up = simulated.force(DEPTH[1:], C, 150.0 * 1.001, 3.0, "tet4")
    np.testing.assert_allclose(answer.jacobian[:, 0], (up - answer.values) / np.log(1.001), rtol=1e-2)
