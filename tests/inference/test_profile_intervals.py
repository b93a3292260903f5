"""Intervals: they hold the truth at their stated rate, and open where the data are silent."""

import numpy as np
import pytest

from limbcli.errors import SolveError
from limbcli.inference import profile_intervals as interval_module
from limbcli.inference.least_squares import least_squares_fit
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import Residual, SolvedPoints
from limbcli.inference.profile import profile_likelihood
from limbcli.inference.profile_intervals import Stiffness, force_intervals
from limbcli.inference.two_step_fit import CurveMatch, ForceDepth, two_step

pytestmark = pytest.mark.slow

DEPTH = np.linspace(0.0, 10.0, 12)
C = 0.008


def noisy(simulated, truth, kind, seed):
    rng = np.random.default_rng(seed)
    force = simulated.force(DEPTH, C, *truth, kind) + 0.1 * rng.standard_normal(12)
    depth = DEPTH + 0.3 * rng.standard_normal(12)
    depth[0] = 0.0
    c = C * (1 + 0.05 * rng.standard_normal()) ** 2
    return ForceDepth(force, depth, 0.1, 0.3), c


def intervals(simulated, truth, kind, seed, **options):
    data, c = noisy(simulated, truth, kind, seed)
    knots = np.unique(data.depth[data.depth > 0.05])
    memory = SolvedPoints(simulated.curve(knots, c, kind))
    _, second = two_step(CurveMatch(memory, knots, data))
    return force_intervals(
        CurveMatch(memory, knots, data), Stiffness(c, 0.1), second.theta, **options
    ), second


def test_profile_of_a_linear_model_is_its_textbook_interval(rng):
    design = np.column_stack([np.ones(20), np.linspace(0, 1, 20)])
    data = design @ (50.0, 30.0) + rng.standard_normal(20)

    def objective(theta, derivative=True):
        return Residual(data - design @ theta, -design)

    parameters = [FitParameter(n, 40.0, 1e-3, 1e5, "log") for n in ("a", "b")]
    best = least_squares_fit(objective, parameters, tolerance=1e-8)
    deviation = np.sqrt(np.linalg.inv(design.T @ design)[1, 1])
    found = profile_likelihood(objective, parameters, best, 1)
    np.testing.assert_allclose(
        (found.low, found.high), best.theta[1] + 1.95996 * deviation * np.array([-1, 1]), rtol=5e-3
    )
    assert not found.is_open
    assert np.all(np.diff(found.values) > 0)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "truth", "n"), [("tet4", (150.0, 3.0), 12), ("tet10", (100.0, 3.0), 6)])
def test_truth_is_covered_at_the_stated_rate(simulated, kind, truth, n):
    """95 % each: 2 misses among 12 (6) have a chance of 12 (3) %; more would be a fault."""
    inside = np.zeros(2)
    for seed in range(n):
        found, _ = intervals(simulated, truth, kind, seed)
        inside += [
            found.profiles[k].low <= t <= found.profiles[k].high
            for k, t in zip(("f_kappa", "m"), truth, strict=True)
        ]
    assert np.all(inside >= n - 2), inside


def test_the_interval_agrees_with_one_on_the_true_model(simulated):
    """Twin: the emulator of the curves against profiles with as many simulations as it likes."""
    few, _ = intervals(simulated, (150.0, 3.0), "tet4", 0)
    assert few.n_solves <= 1
    assert few.n_freedom == 11 - 2  # loaded levels, less f_kappa and m: c has a reading of its own
    data, c = noisy(simulated, (150.0, 3.0), "tet4", 0)
    knots = np.unique(data.depth[data.depth > 0.05])
    memory = SolvedPoints(simulated.curve(knots, c, "tet4"))
    theta = two_step(CurveMatch(memory, knots, data))[1].theta
    for f_kappa in np.geomspace(30, 500, 7):
        for m in np.geomspace(1.5, 6, 5):
            memory(np.array([f_kappa, m]), (0, 1))
    dense = force_intervals(CurveMatch(memory, knots, data), Stiffness(c, 0.1), theta, max_solves=0)
    for name in ("f_kappa", "m"):
        np.testing.assert_allclose(
            (few.profiles[name].low, few.profiles[name].high),
            (dense.profiles[name].low, dense.profiles[name].high), rtol=0.03,
        )  # fmt: skip


class Direct:
    """In the place of the emulator: every prediction of a profile is a simulation."""

    def __init__(self, curve):
        self._curve = curve

    def __call__(self, theta, wrt=()):
        return self._curve._curve(theta, wrt)

    def deviation(self, theta):
        return np.zeros(len(self(theta).values))

    def distance(self, _theta):
        return 0.0


@pytest.mark.parametrize(
    ("kind", "truth", "open_high"),
    [("tet4", (40.0, 8.0), False), ("tet10", (0.5, 6.0), True), ("tet10", (900.0, 1.2), True)],
)
def test_few_simulations_find_the_ends_of_the_full_profile(simulated, monkeypatch, kind, truth, open_high):
    """Identifiable, open towards incompressible, and on a bound; within a twentieth of the interval."""
    few, _ = intervals(simulated, truth, kind, 1)
    monkeypatch.setattr(interval_module, "Emulator", Direct)
    full, _ = intervals(simulated, truth, kind, 1, max_solves=0)
    assert few.n_solves <= 6
    assert full.profiles["f_kappa"].open_high == open_high
    for name, profile in full.profiles.items():
        width = np.log(profile.high / profile.low)
        found = few.profiles[name]
        assert (found.open_low, found.open_high) == (profile.open_low, profile.open_high)
        ends = np.log([found.low / profile.low, found.high / profile.high])
        assert np.abs(ends).max() < 0.05 * width, (name, ends, width)


def test_what_is_not_identifiable_stays_open_and_the_estimate_is_inside(simulated):
    found, second = intervals(simulated, (300.0, 3.0), "tet10", 1)
    profile = found.profiles["f_kappa"]
    assert profile.open_high
    assert profile.high == pytest.approx(1000.0)
    for k, name in enumerate(("f_kappa", "m")):
        assert found.profiles[name].low <= second.theta[k] <= found.profiles[name].high


def test_an_uncertain_stiffness_widens_the_interval(simulated):
    data, c = noisy(simulated, (150.0, 3.0), "tet4", 0)
    knots = np.unique(data.depth[data.depth > 0.05])
    memory = SolvedPoints(simulated.curve(knots, c, "tet4"))
    theta = two_step(CurveMatch(memory, knots, data))[1].theta
    known = force_intervals(CurveMatch(memory, knots, data), Stiffness(c, 0.0), theta).profiles["f_kappa"]
    guessed = force_intervals(CurveMatch(memory, knots, data), Stiffness(c, 0.2), theta).profiles["f_kappa"]
    assert np.log(guessed.high / guessed.low) > 1.3 * np.log(known.high / known.low)


@pytest.mark.parametrize(("share", "like"), [(1.0, 0.2), (0.25, 0.05)])
def test_a_share_of_c_that_is_the_same_at_all_depths_is_a_c_known_better(simulated, share, like):
    """Beside layers that keep their stiffness less of c reaches the force, so less of its doubt does."""
    data, c = noisy(simulated, (150.0, 3.0), "tet4", 0)
    knots = np.unique(data.depth[data.depth > 0.05])
    memory = SolvedPoints(simulated.curve(knots, c, "tet4"))
    theta = two_step(CurveMatch(memory, knots, data))[1].theta
    shared = Stiffness(c, 0.2, share=np.full(len(knots), share))
    found = force_intervals(CurveMatch(memory, knots, data), shared, theta).profiles["f_kappa"]
    expected = force_intervals(CurveMatch(memory, knots, data), Stiffness(c, like), theta).profiles["f_kappa"]
    np.testing.assert_allclose(np.log(found.low), np.log(expected.low), atol=0.05)
    np.testing.assert_allclose(np.log(found.high), np.log(expected.high), atol=0.05)


def test_a_simulation_that_fails_is_reported_and_stops_the_interval(simulated):
    data, c = noisy(simulated, (150.0, 3.0), "tet4", 0)
    knots = np.unique(data.depth[data.depth > 0.05])
    exact = simulated.curve(knots, c, "tet4")
    walk = SolvedPoints(exact)
    theta = two_step(CurveMatch(walk, knots, data))[1].theta

    def fragile(at, wrt=()):
        if at[0] > 1.1 * theta[0]:
            raise SolveError("stopped", where="here", fix="none")
        return exact(at, wrt)

    memory = SolvedPoints(fragile)
    for at, _ in walk.solved:
        if at[0] <= 1.1 * theta[0]:
            memory(at, (0, 1))
    found = force_intervals(CurveMatch(memory, knots, data), Stiffness(c, 0.1), theta)
    assert found.unsolved
    assert found.profiles["f_kappa"].high < 1.6 * theta[0]
    assert found.profiles["f_kappa"].open_high
