"""Layers in the joint likelihood: derivatives, whitening, and what they are worth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limbcli.inference.joint_fit import JointProblem, JointTask
from limbcli.inference.prediction import Prediction, SolvedPoints
from limbcli.inference.site_depth import NO_LAYERS, LayerData, predict_site
from tests.inference.test_joint_fit import C0, KNOTS, LOG_SPEED_0, SHAPE, STARTS, curve, measurement

REST = np.array([1.5, 7.0])
DEVIATION = 0.1


def borders(m):
    """mm below the skin (n_knots, 2): the skin's hardly thins, the fat's by a law of m."""
    d = KNOTS / 25.0
    return np.column_stack([1.5 * (1 - 0.2 * d), 7.0 * (1 - (0.6 + 0.05 * m) * d)])


def layered(simulated, *, speeds=True):
    plain = curve(simulated, graded_speed=True)

    def answer(theta, wrt=()):
        found = plain(theta, wrt)
        n = len(KNOTS) * (2 if speeds else 1)
        by_m = (borders(theta[1] + 1e-4) - borders(theta[1] - 1e-4)).ravel() / 2e-4
        by = np.column_stack([0 * by_m, by_m])
        return Prediction(
            np.r_[found.values[:n], borders(theta[1]).ravel()], np.vstack([found.jacobian[:n], by])
        )

    return answer


def with_layers(data, m, noise=None):
    force = np.tile(data.force[2::2], 2)
    layer = np.repeat([0, 1], len(force) // 2)
    depth = np.tile(np.linspace(0.8, 9.6, 11)[2::2], 2)
    at = [np.interp(depth, np.r_[0, KNOTS], np.r_[REST[j], borders(m)[:, j]]) for j in (0, 1)]
    thickness = np.where(layer == 0, at[0], at[1] - at[0])
    if noise is not None:
        thickness = thickness + DEVIATION * noise.standard_normal(len(thickness))
    covariance = DEVIATION**2 * (np.eye(len(force)) + 0.5 * (layer[:, None] == layer[None]))
    return replace(data, layers=LayerData(force, layer, thickness, covariance, REST))


def test_layers_are_the_same_beside_speeds_that_were_left_out(simulated):
    """As a fold leaves out the only level that has one: the curve holds speeds all the same."""
    data = with_layers(measurement(simulated, c=C0, f_kappa=50.0, m=4.0), 4.0)
    none = np.zeros(0)
    without = replace(data, speed_force=none, log_speed=none, speed_deviation=none)
    memory = SolvedPoints(layered(simulated))
    for start in STARTS:
        memory(start[1:], (0, 1))
    tasks = [JointTask([memory], [each], SHAPE, C0, [LOG_SPEED_0]) for each in (data, without)]
    problems = [JointProblem(each, STARTS) for each in tasks]
    seen = [each.blocks[0].predict(STARTS[0]) for each in problems]
    np.testing.assert_array_equal(seen[1].layers, seen[0].layers)
    np.testing.assert_array_equal(seen[1].layers_slope, seen[0].layers_slope)
    assert problems[1].uncertainty(STARTS[0]) <= problems[0].uncertainty(STARTS[0])


@pytest.mark.parametrize("speeds", [True, False])
def test_derivatives_of_layers_are_those_of_differences(simulated, speeds):
    data = with_layers(measurement(simulated, c=C0, f_kappa=50.0, m=4.0), 4.0)
    if not speeds:
        none = np.zeros(0)
        data = replace(data, speed_force=none, log_speed=none, speed_deviation=none)
    exact, shape = layered(simulated, speeds=speeds), np.array([30.0, 3.0])

    def at(c_ratio=1.1, gain=0.97, shape=shape):
        answer = exact(shape, (0, 1))
        return predict_site(answer, data, shape, c_ratio=c_ratio, gain=gain, log_speed_0=LOG_SPEED_0)

    step, base = 1e-5, at()
    moves = [
        (at(c_ratio=1.1 * np.exp(s)) for s in (step, -step)),
        (at(gain=0.97 * np.exp(s)) for s in (step, -step)),
        (at(shape=shape * np.exp([s, 0])) for s in (step, -step)),
        (at(shape=shape * np.exp([0, s])) for s in (step, -step)),
    ]
    for column, (up, down) in enumerate(moves):
        rise = (up.layers - down.layers) / (2 * step)
        assert np.abs(rise).max() > 1e-3
        np.testing.assert_allclose(base.layers_slope[:, column], rise, rtol=2e-3, atol=2e-4)


def test_residuals_of_the_joint_objective_have_the_derivatives_of_differences(simulated):
    data = with_layers(measurement(simulated, c=C0, f_kappa=50.0, m=4.0), 4.0, np.random.default_rng(7))
    memory = SolvedPoints(layered(simulated))
    for theta in ((100.0, 2.0), (100.0, 3.5), (20.0, 2.5)):
        memory(np.array(theta), (0, 1))
    problem = JointProblem(JointTask([memory], [data], SHAPE, C0, [LOG_SPEED_0]), STARTS)
    objective, theta = problem.objective(), np.array([1.1 * C0, 60.0, 3.0])
    exact = objective(theta)
    n = len(data.layers)
    assert len(exact.values) == len(data.force) + len(data.log_speed) + n
    for k in range(3):
        step = 1e-6 * theta[k] * np.eye(3)[k]
        rise = (objective(theta + step).values - objective(theta - step).values) / (2 * step[k])
        scale = np.abs(rise[-n:]).max()
        np.testing.assert_allclose(exact.jacobian[-n:, k], rise[-n:], atol=5e-3 * scale)


def test_whitened_residuals_have_the_covariance_they_were_given():
    rng = np.random.default_rng(7)
    root = rng.standard_normal((4, 4))
    data = LayerData(np.ones(4), np.zeros(4, int), np.ones(4), root @ root.T + np.eye(4), REST)
    drawn = np.linalg.cholesky(data.covariance) @ rng.standard_normal((4, 20_000))
    np.testing.assert_allclose(np.cov(data.whitened(drawn)), np.eye(4), atol=0.05)
    assert len(NO_LAYERS.whitened(np.zeros(0))) == 0


def test_left_out_levels_take_their_layers_along(simulated):
    data = with_layers(measurement(simulated, c=C0, f_kappa=50.0, m=4.0), 4.0)
    left = np.isin(np.arange(len(data.force)), [2, 4])
    fewer = data.without(left).layers
    assert len(fewer) == len(data.layers) - 4
    assert not np.isin(data.force[[2, 4]], fewer.force).any()
    np.testing.assert_allclose(fewer.covariance[0, :3], [1.5e-2, 0.5e-2, 0.5e-2])
