"""Probabilities of boxes and quantiles of mixtures, against closed forms, scipy's integrals and draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from limbcli.diagnosis.explanations.laplace import Truncated, ln_probability, quantiles

INF = np.inf


def ln_of(mean, covariance, low, high) -> float:
    return float(ln_probability(np.array([mean]), np.asarray(covariance), np.array(low), np.array(high))[0])


@pytest.mark.parametrize(
    ("mean", "low", "high"),
    [
        (0.0, -1.0, 2.0),
        (3.0, 0.0, INF),
        (-30.0, 0.0, INF),
        (30.0, -INF, 0.0),
        (-12.0, 0.0, 0.5),
        (40.0, -1.0, 1.0),
    ],
)
def test_in_one_dimension_it_is_exact_however_far_off_the_limits_are(mean, low, high):
    deviation = 1.7
    ends = np.array([low - mean, high - mean]) / deviation
    a, b = ends if ends.sum() < 0 else -ends[::-1]  # the lower tail, where logarithms are accurate
    expected = stats.norm.logcdf(b) + np.log1p(-np.exp(stats.norm.logcdf(a) - stats.norm.logcdf(b)))
    assert ln_of([mean], [[deviation**2]], [low], [high]) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("correlation", [-0.8, -0.3, 0.0, 0.5, 0.9])
def test_the_quadrant_of_two_is_that_of_sheppard(correlation):
    """1/4 + asin(rho) / (2 pi). One limit after the other is approximate: 3 % at a correlation of 0.9,
    which is 0.03 of a ln evidence; of -0.8, where a fifteenth of the probability is left, 0.2."""
    covariance = [[1.0, 2.0 * correlation], [2.0 * correlation, 4.0]]
    expected = np.log(0.25 + np.arcsin(correlation) / (2 * np.pi))
    found = ln_of([0.0, 0.0], covariance, [0.0, 0.0], [INF, INF])
    assert found == pytest.approx(
        expected, abs=1e-12 if correlation == 0 else 0.2 if correlation < -0.5 else 0.04
    )


def test_random_boxes_of_up_to_four_dimensions(rng):
    """Within 0.15, a factor of 1.2 on probabilities that differ by factors of ten between explanations;
    scipy's own are good to 1e-5 of the whole, so that boxes with less than 0.001 are left out."""
    compared = 0
    while compared < 40:
        p = int(rng.integers(2, 5))
        root = rng.standard_normal((p, p)) + 1.5 * np.eye(p)
        covariance, mean = root @ root.T, rng.standard_normal(p)
        low = np.where(rng.random(p) < 0.5, -INF, rng.uniform(-3, 0, p))
        high = np.where(rng.random(p) < 0.5, INF, rng.uniform(1, 4, p))
        expected = stats.multivariate_normal(mean, covariance, seed=1).cdf(high, lower_limit=low)
        if expected > 1e-3:
            compared += 1
            assert ln_of(mean, covariance, low, high) == pytest.approx(np.log(expected), abs=0.15)


def test_many_means_at_once_are_as_one_by_one_where_the_covariance_is_that_of_independent_ones(rng):
    means, covariance = rng.standard_normal((50, 3)), np.diag([1.0, 4.0, 0.25])
    low, high = np.array([0.0, -INF, -0.5]), np.array([INF, 1.0, INF])
    found = ln_probability(means, covariance, low, high)
    assert found == pytest.approx([ln_of(mean, covariance, low, high) for mean in means], abs=1e-12)


def test_quantiles_of_a_mixture_are_those_of_its_draws(rng):
    """400,000 draws know a quantile at 2.5 % to 0.4 % of the spread of the mixture, here 0.02."""
    several = [Truncated(0.5, 1.0, 1.0, 0.0), Truncated(0.3, -2.0, 0.5), Truncated(0.2, 6.0, 2.0, -INF, 5.0)]
    drawn = []
    for each in several:
        ends = [(end - each.mean) / each.deviation for end in (each.low, each.high)]
        n = round(400_000 * each.weight)
        drawn.append(stats.truncnorm.rvs(*ends, each.mean, each.deviation, size=n, random_state=rng))
    shares = (0.025, 0.3, 0.5, 0.975)
    assert quantiles(several, shares) == pytest.approx(np.quantile(np.concatenate(drawn), shares), abs=0.02)


def test_weights_count_by_their_ratio():
    one = [Truncated(w, m, 1.0) for w, m in ((2.0, 0.0), (6.0, 9.0))]
    other = [Truncated(w, m, 1.0) for w, m in ((0.25, 0.0), (0.75, 9.0))]
    assert quantiles(one, (0.1, 0.9)) == pytest.approx(quantiles(other, (0.1, 0.9)))
    assert quantiles(one, (0.125,)) == pytest.approx([0.0], abs=0.01)  # half of the first's share


@pytest.mark.parametrize("far", [5.0, 20.0])
def test_a_size_whose_mean_lies_far_beyond_its_limit_has_quantiles_just_inside(far):
    """Half of the tail's small probability; the grid has 0.002 deviations between its points."""
    expected = stats.norm.isf(0.5 * stats.norm.sf(far)) - far
    assert quantiles([Truncated(1.0, -far, 1.0, 0.0)], (0.5,)) == pytest.approx([expected], rel=2e-3)
