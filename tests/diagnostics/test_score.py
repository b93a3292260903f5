"""Score statistics against closed forms and their own null distributions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from limbcli.diagnostics.model.forward_model import Direction
from limbcli.diagnostics.model.linear import LinearFit
from limbcli.diagnostics.statistical_tests.multiple_testing import score_family
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
        family = score_family(state, trials, rng=np.random.default_rng(7), relative=relative, n_draws=800)
        below += family.smallest < 0.05
    assert below / 150 <= 0.05 + 2.5 * np.sqrt(0.05 * 0.95 / 150)


@pytest.mark.slow
def test_readings_with_long_tails_raise_no_more_false_alarms(rng):
    """Two-sided exponential errors of the stated deviation: what normal draws would flag at 1 % too often."""
    n, J = 24, np.ones((24, 1))
    parts = [Trial(str(k), (Direction(np.eye(n)[:, 6 * k : 6 * k + 6], (0,) * 6),)) for k in range(4)]
    errors = rng.laplace(size=(400, n)) / np.sqrt(2)
    states = [LinearFit.of(each, J) for each in errors]
    p = [score_family(s, parts, rng=np.random.default_rng(7), n_draws=2000).smallest for s in states]
    assert np.mean(np.array(p) < 0.01) < 0.02
    assert np.mean(np.array(p) < 0.05) < 0.05 + 2 * np.sqrt(0.05 * 0.95 / len(p))
