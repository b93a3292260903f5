"""Score statistics against closed forms and their own null distributions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.forward_model import Direction
from limbcli.diagnostics.model.linear import LinearFit
from limbcli.diagnostics.model.noise import ErrorDraws
from limbcli.diagnostics.statistical_tests.localisation_tests import PREFIX
from limbcli.diagnostics.statistical_tests.multiple_testing import _TestSpace, score_family
from limbcli.diagnostics.statistical_tests.score import Trial, cone_projection, cosine, score, statistics


def _state(rng, n=20, p=2):
    return LinearFit.of(rng.standard_normal(n), rng.standard_normal((n, p)))


def test_two_sided_score_is_chi2(rng):
    state = _state(rng)
    trial = Trial("x", (Direction(rng.standard_normal((20, 2)), (0, 0)),))
    draws = state.project(rng.standard_normal((20_000, 20)).T).T
    found = statistics(state, trial, draws)
    assert stats.kstest(found, "chi2", args=(2,)).pvalue > 1e-3


def test_one_sided_score_is_half_zero_half_chi2(rng):
    state = _state(rng)
    trial = Trial("x", (Direction(rng.standard_normal((20, 1)), (1,)),))
    draws = state.project(rng.standard_normal((20_000, 20)).T).T
    found = statistics(state, trial, draws)
    assert np.mean(found == 0) == pytest.approx(0.5, abs=0.02)
    assert np.quantile(found, 0.95) == pytest.approx(stats.chi2.ppf(0.9, 1), rel=0.06)


def test_cone_projection_agrees_with_non_negative_least_squares(rng):
    from scipy.optimize import nnls

    A, draws = rng.standard_normal((12, 3)), rng.standard_normal((50, 12))
    value, eta = cone_projection(A, (1, 1, 1), draws)
    for draw, v, e in zip(draws, value, eta, strict=True):
        x, norm = nnls(A, draw)
        assert v == pytest.approx(draw @ draw - norm**2, abs=1e-9)
        assert e == pytest.approx(x, abs=1e-8)


def test_directions_inside_the_fitted_span_score_nothing(rng):
    state = _state(rng)
    inside = Direction(state.jacobian @ np.array([[1.0], [-2.0]]), (0,))
    assert score(state, Trial("x", (inside,))).statistic == 0.0


def test_estimate_is_the_effect_put_in(rng):
    J, h = rng.standard_normal((20, 2)), rng.standard_normal((20, 1))
    state = LinearFit.of(3.0 * h[:, 0] + J @ [1.0, 2.0], J)
    assert score(state, Trial("x", (Direction(h, (0,)),))).eta == pytest.approx([3.0])


def test_opposite_one_sided_directions_do_not_look_alike(rng):
    state, h = _state(rng), rng.standard_normal((20, 1))
    assert cosine(state, Direction(h, (1,)), Direction(-h, (1,))) == pytest.approx(-1.0)
    assert cosine(state, Direction(h, (0,)), Direction(-h, (0,))) == pytest.approx(1.0)


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.slow
def test_family_is_calibrated(rng, relative):
    """The smallest adjusted p of a family with grids and signs falls below 5 % in 5 % of null data."""
    n, J = 18, rng.standard_normal((18, 2))
    trials = [
        Trial(
            str(k),
            tuple(Direction(rng.standard_normal((n, 1 + k % 2)), (k % 2,) * (1 + k % 2)) for _ in range(3)),
        )
        for k in range(6)
    ]
    below = 0
    for _ in range(150):
        state = LinearFit.of((3.0 if relative else 1.0) * rng.standard_normal(n), J)
        family = score_family(state, trials, ErrorDraws((7,), n, 800), relative=relative)
        below += family.smallest < 0.05
    assert below / 150 <= 0.05 + 2.5 * np.sqrt(0.05 * 0.95 / 150)


def test_parts_of_the_data_do_not_count_where_effects_are_told_apart(rng):
    """Adjusted over the effects alone, p is the same whatever else is tested, and smaller than over all."""
    n, J = 30, rng.standard_normal((30, 2))
    state = LinearFit.of(rng.standard_normal(n), J)
    effects = [Trial(f"effect {k}", (Direction(rng.standard_normal((n, 1)), (0,)),)) for k in range(5)]
    parts = [Trial(f"{PREFIX}{k}", (Direction(np.eye(n)[:, 6 * k : 6 * k + 6], (0,) * 6),)) for k in range(5)]
    alone, together = (
        score_family(state, each, ErrorDraws((7,), n, 2000)) for each in (effects, effects + parts)
    )
    for few, all_ in zip(alone.tests, together.tests, strict=False):
        assert all_.p_among == few.p_among
        assert all_.p <= all_.p_among < all_.p_adjusted
    assert together.tests[-1].p_among <= together.tests[-1].p_adjusted
    expected = 1 - (1 - together.tests[0].p) ** 5  # five directions that are nearly independent
    assert together.tests[0].p_among == pytest.approx(expected, abs=0.06)


@pytest.mark.slow
def test_readings_with_long_tails_raise_no_more_false_alarms(rng):
    """Two-sided exponential errors of the stated deviation: what normal draws would flag at 1 % too often."""
    n, J = 24, np.ones((24, 1))
    parts = [Trial(str(k), (Direction(np.eye(n)[:, 6 * k : 6 * k + 6], (0,) * 6),)) for k in range(4)]
    errors = rng.laplace(size=(400, n)) / np.sqrt(2)
    states = [LinearFit.of(each, J) for each in errors]
    draws = ErrorDraws((7,), n, 2000)
    p = [score_family(s, parts, draws).smallest for s in states]
    assert np.mean(np.array(p) < 0.01) < 0.02
    assert np.mean(np.array(p) < 0.05) < 0.05 + 2 * np.sqrt(0.05 * 0.95 / len(p))


def _near(rng):
    """One test whose p is near 0.05, whatever few draws say: three of 200 data, their chi2 at 5 %."""
    n = 200
    shape = np.linalg.qr(rng.standard_normal((n, n)))[0]
    residual = shape[:, :3] @ np.array([2.0, 1.5, 1.23]) + shape[:, 4:].sum(axis=1)
    state = LinearFit.of(residual, shape[:, 3:4])
    return state, [Trial("near", (Direction(shape[:, :3], (0, 0, 0)),))]


@pytest.mark.parametrize("relative", [False, True])
def test_where_a_p_is_near_what_decides_more_errors_are_drawn(rng, relative):
    state, trials = _near(rng)
    drawn: list[int] = []

    class Counted(ErrorDraws):
        def batch(self, k):
            drawn.append(k)
            return super().batch(k)

    clear = score_family(state, trials, Counted((7,), 200, 100), relative=relative, decisive=(0.999,))
    assert drawn == [0]
    rough = clear.tests[0].p
    drawn.clear()
    found = score_family(state, trials, Counted((7,), 200, 100), relative=relative, decisive=(rough,))
    assert drawn == list(range(thresholds.MOST_BATCHES))
    assert found.tests[0].p == pytest.approx(rough, abs=0.15)


@pytest.mark.slow
def test_more_draws_lessen_what_a_p_owes_to_them(rng, monkeypatch):
    """Over seeds, p of 16 times as many draws scatters a quarter as much."""
    monkeypatch.setattr(thresholds, "CLEAR_SD", 1e9)
    state, trials = _near(rng)
    p = np.array(
        [
            [
                score_family(state, trials, ErrorDraws((seed,), 200, 400), decisive=each).tests[0].p
                for each in ((), (0.05,))
            ]
            for seed in range(25)
        ]
    )
    few, many = p.std(axis=0)
    assert p.mean(axis=0) == pytest.approx(0.053, abs=0.012)
    assert 0.1 * few < many < 0.45 * few


def test_statistics_in_the_span_of_the_columns_are_those_of_the_data(rng):
    n, J = 30, rng.standard_normal((30, 2))
    state = LinearFit.of(rng.standard_normal(n), J)
    trials = [
        Trial(
            "a",
            (Direction(rng.standard_normal((n, 2)), (1, 0)), Direction(rng.standard_normal((n, 1)), (1,))),
        ),
        Trial("b", (Direction(rng.standard_normal((n, 3)), (0, 0, 0)),)),
    ]
    errors = ErrorDraws((3,), n, 50).batch(0)
    found = _TestSpace.of(state, trials, relative=False).statistics(errors)
    draws = state.project(errors.T.astype(float)).T
    for k, trial in enumerate(trials):
        assert found[:, k] == pytest.approx(statistics(state, trial, draws), rel=1e-4, abs=1e-5)
    assert found[:, -1] == pytest.approx(np.sum(draws**2, axis=1), rel=1e-5)
