"""The joint likelihood, on the cheap limb with a cheap wave speed."""

from dataclasses import replace

import numpy as np
import pytest

from limbcli.errors import FitError, SolveError
from limbcli.inference.joint_fit import C_SPAN, JointProblem, JointTask, held_out_error, joint_fit
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import Prediction, SolvedPoints
from limbcli.inference.site_depth import SiteMeasurement, invert, predict_site

C0 = 0.008
KNOTS = np.linspace(1.0, 11.0, 11)
DEPTH = np.linspace(0.8, 9.6, 11)
LOG_SPEED_0 = float(np.log(np.sqrt(C0 / 2 / 1e-9) / 1e3))
SHAPE = (
    FitParameter("f_kappa", 100.0, 0.01, 1000.0, "log"),
    FitParameter("m", 2.0, 1.0, 100.0, "log", step_factor=2.5),
)


def log_speed(depth, m):
    """Small-on-large in the mean: kinematic slope, curvature by m (unloaded: 0)."""
    strain = depth / 25.0
    return 0.5 * np.log(1 + strain + (m**2 / 6) * strain**2)


def curve(simulated, *, graded_speed=False):
    forces = simulated.curve(KNOTS, C0)

    def answer(theta, wrt=()):
        found = forces(theta, wrt)
        speed = np.exp(LOG_SPEED_0 + log_speed(KNOTS, theta[1]))
        by_m = (speed * log_speed(KNOTS, theta[1] * 1.0001) - speed * log_speed(KNOTS, theta[1])) / (
            1e-4 * theta[1]
        )
        known = np.column_stack([0 * by_m, by_m]) if graded_speed else np.full((len(KNOTS), 2), np.nan)
        return Prediction(np.r_[found.values, speed], np.vstack([found.jacobian, known]))

    return answer


def measurement(simulated, *, c, f_kappa, m, rng=None, name="p1", gain_deviation=0.0, depths=DEPTH):
    force = simulated.force(depths, c, f_kappa, m)
    depth, speeds = depths.copy(), np.r_[0.0, log_speed(depths, m)] + LOG_SPEED_0 + 0.5 * np.log(c / C0)
    forces = np.r_[0.0, force]
    if rng is not None:
        force = force + 0.1 * rng.standard_normal(len(force))
        depth = depth + 0.3 * rng.standard_normal(len(depth))
        speeds = speeds + 0.05 * rng.standard_normal(len(speeds))
        forces = np.r_[0.0, force]
    return SiteMeasurement(
        name, KNOTS, force, depth, 0.1, 0.3, forces, speeds, np.full(len(speeds), 0.05), gain_deviation
    )


def task(simulated, data, shape=SHAPE, **options):
    curves = [SolvedPoints(curve(simulated, **options)) for _ in data]
    for each in curves:
        for theta in ((100.0, 2.0), (100.0, 3.5), (20.0, 2.5)):
            each(np.array(theta[: len(shape)]), tuple(range(len(shape))))
    return JointTask(curves, data, shape, C0, [LOG_SPEED_0] * len(data))


STARTS = [np.array([C0, 100.0, 2.0]), np.array([C0, 20.0, 4.0])]


def test_inversion_undoes_the_curve(simulated):
    knots = np.r_[0.0, KNOTS]
    force = np.r_[0.0, simulated.force(KNOTS, C0, 50.0, 4.0)]
    from limbcli.inference.monotone_interpolation import pchip_sample

    places = np.linspace(0.3, 10.9, 17)
    np.testing.assert_allclose(
        invert(knots, force, pchip_sample(knots, force, places).values), places, atol=1e-9
    )


def test_derivatives_of_depth_and_speed_are_those_of_differences(simulated):
    data = measurement(simulated, c=C0, f_kappa=50.0, m=4.0)
    exact, shape = curve(simulated, graded_speed=True), np.array([30.0, 3.0])

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
        rise = (up.depth - down.depth) / (2 * step)
        np.testing.assert_allclose(base.depth_slope[:, column], rise, rtol=2e-3, atol=2e-4)
        rise = (up.log_speed - down.log_speed) / (2 * step)
        np.testing.assert_allclose(base.log_speed_slope[:, column], rise, rtol=2e-3, atol=2e-4)


@pytest.mark.slow
def test_truth_is_recovered_from_exact_data(simulated):
    data = measurement(simulated, c=0.0095, f_kappa=8.0, m=5.0)
    _, found = joint_fit(task(simulated, [data]), STARTS, max_solves=12)
    assert found.best[0] == pytest.approx(0.0095, rel=0.01)
    assert found.best[2] == pytest.approx(5.0, rel=0.02)
    assert found.chi_square < 0.05


@pytest.mark.slow
def test_speeds_and_a_second_site_narrow_the_interval(simulated):
    rng = np.random.default_rng(7)
    one = measurement(simulated, c=C0, f_kappa=50.0, m=4.0, rng=rng, name="p1")
    two = measurement(simulated, c=C0, f_kappa=50.0, m=4.0, rng=rng, name="p2")
    nothing = np.zeros(0)
    silent = SiteMeasurement("p1", KNOTS, one.force, one.depth, 0.1, 0.3, nothing, nothing, nothing)

    def width(data, **options):
        made = task(simulated, data)
        made = JointTask(made.curves, data, SHAPE, C0, made.log_speed_0, **options)
        _, found = joint_fit(made, STARTS, max_solves=2)
        return np.log(found.profiles["m"].high / found.profiles["m"].low)

    without, with_speeds, both = width([silent], c_deviation=0.1), width([one]), width([one, two])
    assert both < with_speeds < without


@pytest.mark.slow
def test_what_cannot_be_seen_stays_open(simulated):
    data = measurement(simulated, c=C0, f_kappa=300.0, m=4.0, rng=np.random.default_rng(7))
    _, found = joint_fit(task(simulated, [data]), STARTS, max_solves=6)
    assert found.profiles["f_kappa"].open_high
    assert not found.profiles["m"].open_high


@pytest.mark.slow
def test_an_uncertain_gain_widens_what_the_force_says(simulated):
    rng = np.random.default_rng(7)
    sure = measurement(simulated, c=C0, f_kappa=4.0, m=4.0, rng=rng)
    unsure = SiteMeasurement(**{**vars(sure), "gain_deviation": 0.2})
    lows = []
    for data in (sure, unsure):
        _, found = joint_fit(task(simulated, [data]), STARTS, max_solves=2)
        lows.append(found.profiles["f_kappa"].low)
    assert lows[1] < 0.8 * lows[0]


@pytest.mark.slow
def test_held_out_levels_prefer_the_law_that_made_the_data(simulated):
    data = measurement(simulated, c=C0, f_kappa=50.0, m=7.0, rng=np.random.default_rng(7))
    full, best = joint_fit(task(simulated, [data]), STARTS, max_solves=2)
    whole = curve(simulated)

    def only_f_kappa(theta, wrt=()):
        found = whole(np.array([theta[0], 2.0]), (0, 1))
        return Prediction(found.values, found.jacobian[:, :1])

    memory = SolvedPoints(only_f_kappa)
    for value in (100.0, 20.0, 4.0):
        memory(np.array([value]), (0,))
    stiff = JointTask([memory], [data], SHAPE[:1], C0, [LOG_SPEED_0])
    poor, poor_best = joint_fit(stiff, [each[:2] for each in STARTS], max_solves=2)
    assert held_out_error(full, best)[0] < 0.8 * held_out_error(poor, poor_best)[0]


def test_too_few_levels_are_an_error(simulated):
    data = measurement(simulated, c=C0, f_kappa=50.0, m=4.0, depths=np.array([2.0, 4.0]))
    with pytest.raises(FitError, match="2 loaded levels for 3 parameters"):
        joint_fit(task(simulated, [data]), STARTS)


@pytest.mark.slow
def test_truth_is_covered_at_the_stated_rate(simulated):
    """95 % each: 2 misses of 4 have a chance of 1.4 %. `tests/benchmarks/joint_coverage.py` draws more."""
    truth = {"c": C0, "f_kappa": 50.0, "m": 4.0}
    inside = dict.fromkeys(truth, 0)
    for seed in range(4):
        data = measurement(simulated, **truth, rng=np.random.default_rng(seed))
        _, found = joint_fit(task(simulated, [data]), STARTS, max_solves=2)
        for name, value in truth.items():
            inside[name] += found.profiles[name].low <= value <= found.profiles[name].high
    assert min(inside.values()) >= 3, inside


def test_problem_counts_its_freedom(simulated):
    data = measurement(simulated, c=C0, f_kappa=50.0, m=4.0)
    problem = JointProblem(task(simulated, [data]), STARTS)
    assert problem.n_freedom == 11 + 12 - 3


@pytest.mark.slow
def test_depths_are_weighed_by_the_slopes_of_the_fit(simulated, monkeypatch):
    """Where the noise is that of force, a start that is twice as stiff would weigh first depths fourfold."""
    force = simulated.force
    monkeypatch.setattr(simulated, "force", lambda *each: force(*each[:4], "tet4"))
    data = replace(
        measurement(simulated, c=C0, f_kappa=1.0, m=4.0), force_deviation=0.1, depth_deviation=0.02
    )
    data = replace(
        data, depth=data.depth + 0.1 / np.gradient(data.force, data.depth) * (-1.0) ** np.arange(11)
    )
    problem, found = joint_fit(task(simulated, [data]), STARTS, max_solves=2)
    weights = data.weights_at(problem.blocks[0].predict(found.best).stiffness)
    first = data.weights_at(problem.blocks[0].predict(STARTS[0]).stiffness)
    assert (weights / first).max() > 1.5
    missed = (data.depth - problem.blocks[0].predict(found.best).depth) / weights
    speeds = (data.log_speed - problem.blocks[0].predict(found.best).log_speed) / data.speed_deviation
    assert found.chi_square == pytest.approx(missed @ missed + speeds @ speeds, rel=0.05)
    assert not problem.settle(found.best)


def beside_layers(theta, wrt=()):
    """A curve of (c / c0, f_kappa, m) whose force goes with c by a share that grows with depth."""
    ratio, f_kappa, m = theta
    share = 0.2 + 0.04 * KNOTS
    force = 0.4 * KNOTS**1.4 * ratio**share * f_kappa**0.1 * np.exp(0.02 * m * KNOTS)
    speed = np.exp(LOG_SPEED_0 + 0.5 * np.log(ratio) + log_speed(KNOTS * (1 + 0.1 * np.log(ratio)), m))
    by_force = force[:, None] * np.column_stack([share / ratio, 0.1 / f_kappa + 0 * KNOTS, 0.02 * KNOTS])
    return Prediction(np.r_[force, speed], np.vstack([by_force, np.full((len(KNOTS), 3), np.nan)]))


def beside_layers_task(true_ratio=1.25):
    truth = beside_layers([true_ratio, 50.0, 4.0]).values
    force, speed = np.split(truth, 2)
    data = SiteMeasurement(
        "p1", KNOTS, force, KNOTS, 0.02, 0.03, np.r_[0.0, force],
        np.r_[LOG_SPEED_0 + 0.5 * np.log(true_ratio), np.log(speed)], np.full(1 + len(KNOTS), 0.02), 1e-4,
    )  # fmt: skip
    memory = SolvedPoints(beside_layers)
    for place in ((1.0, 100.0, 2.0), (2.0, 100.0, 2.0), (1.0, 10.0, 2.0), (1.0, 100.0, 4.0)):
        memory(np.array(place), (0, 1, 2))
    return JointTask([memory], [data], SHAPE, C0, [LOG_SPEED_0], None, [True])


def assert_slopes_are_exact(problem: JointProblem) -> np.ndarray:
    """Of the residuals, against central differences, at the theta that is returned."""
    theta, residual = np.array([1.1 * C0, 60.0, 3.0, 1.01]), problem.objective()
    exact = residual(theta, True).jacobian
    for k in range(len(theta)):
        up, down = theta.copy(), theta.copy()
        up[k], down[k] = theta[k] * (1 + 1e-5), theta[k] * (1 - 1e-5)
        rise = (residual(up, False).values - residual(down, False).values) / (2e-5 * theta[k])
        np.testing.assert_allclose(exact[:, k], rise, rtol=1e-3, atol=1e-3 * abs(rise).max(), err_msg=str(k))
    return theta


def test_beside_layers_slopes_by_c_are_those_of_the_curve():
    problem = JointProblem(beside_layers_task(), STARTS)
    assert_slopes_are_exact(problem)


def test_one_site_beside_layers_and_one_without_share_c(simulated):
    """c of the one costs simulations, that of the other none."""
    one, other = (
        beside_layers_task(),
        task(simulated, [measurement(simulated, c=1.25 * C0, f_kappa=50.0, m=4.0)]),
    )
    both = JointTask(
        [*one.curves, *other.curves], [*one.data, *other.data], SHAPE, C0, [LOG_SPEED_0] * 2, None,
        [True, False],
    )  # fmt: skip
    problem = JointProblem(both, STARTS)
    theta = assert_slopes_are_exact(problem)
    problem.solve(theta)
    assert [len(each.solved[-1][0]) for each in both.curves] == [3, 2]


@pytest.mark.slow
def test_beside_layers_c_is_simulated_where_it_is_fitted():
    made = beside_layers_task()
    problem, found = joint_fit(made, STARTS, max_solves=6)
    np.testing.assert_allclose(found.best[:3], [1.25 * C0, 50.0, 4.0], rtol=0.01)
    solved = np.array([theta[0] for theta, _ in made.curves[0].solved])
    assert np.abs(np.log(solved / 1.25)).min() < 0.05
    far = problem.within_reach(np.array([9.0 * C0, 50.0, 4.0, 1.0]))
    assert far[0] == pytest.approx(2 * solved.max() * C0), "a step at a time"


@pytest.mark.slow
def test_nothing_is_found_beyond_what_could_be_simulated(simulated):
    """The truth (m 8) is near where no simulation converges; c, which needs none, asks first."""
    plain = curve(simulated)

    def limited(theta, wrt=()):
        if theta[1] > 8.2:
            raise SolveError("no answer", where="the cheap limb", fix="none")
        return plain(theta, wrt)

    memory = SolvedPoints(limited)
    for start in STARTS:
        memory(start[1:], (0, 1))
    data = measurement(simulated, c=C0, f_kappa=50.0, m=8.0)
    task = JointTask([memory], [data], SHAPE, C0, [LOG_SPEED_0])
    problem, found = joint_fit(task, STARTS, max_solves=3)
    largest = max(theta[1] for theta, _ in memory.solved)
    assert found.unsolved
    assert found.best[2] == pytest.approx(largest, rel=1e-3)
    assert found.profiles["m"].open_high
    assert (problem.parameters[0].low, problem.parameters[0].high) == (C0 / C_SPAN, C0 * C_SPAN)
