"""Bayes factors of one effect more, and of two: exact in a linear model."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from limbcli.diagnosis.explanations.forward_model import Direction, Fitted, Prior, Priors
from limbcli.diagnosis.explanations.linear_evidence import LinearEvidence
from limbcli.diagnosis.explanations.noise import Noise, common, independent
from limbcli.numbers.whitening import Whitener

N = 14
OF_TISSUE = Prior(0.0, 5.0)
SIZES = {"one": {"a": Prior(0.0, 2.0)}, "two": {"b": Prior(1.0, 1.5), "d": Prior(0.0, 3.0)},
         "up": {"e": Prior(0.0, 2.0, 0.0)}}  # fmt: skip


class Linear:
    """y = B x + effects, with the columns of each effect at one or more points, and its null values in B
    x."""

    def __init__(self, rng: np.random.Generator):
        noise = (
            independent("own", rng.uniform(0.5, 1.5, N), source="spec"),
            common("gain", np.ones(N), source="spec"),
        )
        self.covariance, self.base = Noise(noise).covariance, rng.standard_normal((N, 2))
        self.columns = {
            name: [rng.standard_normal((N, len(sizes))) for _ in range(3 if name == "one" else 1)]
            for name, sizes in SIZES.items()
        }
        self.y = 3.0 * rng.standard_normal(N)

    def evidence(self) -> LinearEvidence:
        inverse = np.linalg.inv(self.covariance)
        A = self.base.T @ inverse @ self.base + np.eye(2) / OF_TISSUE.deviation**2
        theta = np.linalg.solve(A, self.base.T @ inverse @ self.y)
        priors = Priors.about(theta, (OF_TISSUE,) * 2)
        fitted = Fitted((), self.base @ theta, self.base, ("c", "m"), {}, priors=priors)
        directions = {
            name: [Direction(each, SIZES[name], f"at {k}") for k, each in enumerate(several)]
            for name, several in self.columns.items()
        }
        return LinearEvidence.about(fitted, self.y, Whitener.of(self.covariance), directions)

    def ln_likelihood(self, *effects: tuple[str, int], y=None) -> float:
        """Marginal, with sizes that are normal about null on both sides."""
        total = self.covariance + OF_TISSUE.deviation**2 * self.base @ self.base.T
        for name, k in effects:
            deviation = np.array([each.deviation for each in SIZES[name].values()])
            columns = self.columns[name][k] * deviation
            total = total + columns @ columns.T
        return float(stats.multivariate_normal(np.zeros(N), total).logpdf(self.y if y is None else y))


@pytest.fixture
def linear(rng) -> Linear:
    return Linear(rng)


def test_the_factor_is_the_ratio_of_the_marginal_likelihoods(linear):
    expected = linear.ln_likelihood(("two", 0)) - linear.ln_likelihood()
    assert linear.evidence().ln_factor("two")[0] == pytest.approx(expected, rel=1e-9)


def test_over_a_grid_it_is_the_mean_and_the_best_point_is_the_likeliest(linear):
    each = np.array([linear.ln_likelihood(("one", k)) for k in range(3)]) - linear.ln_likelihood()
    found = linear.evidence()
    assert found.ln_factor("one")[0] == pytest.approx(np.log(np.mean(np.exp(each))), rel=1e-9)
    assert found.best("one").direction.point == f"at {int(np.argmax(each))}"


def test_of_a_pair_it_is_that_of_both_at_their_best_points_of_the_grid(linear):
    """Two points of three are lost where the third is far better: the factor of the pair is a third of its
    own."""
    pairs = linear.evidence().ln_factors_of_pairs
    assert set(pairs) == {("one", "two"), ("one", "up"), ("two", "up")}
    best = int(np.argmax([linear.ln_likelihood(("one", k)) for k in range(3)]))
    expected = linear.ln_likelihood(("one", best), ("two", 0)) - linear.ln_likelihood() - np.log(3)
    assert pairs["one", "two"] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("pull", [-4.0, 0.0, 4.0])
def test_a_size_that_may_only_grow_gains_up_to_a_factor_of_two_and_may_lose_all(linear, pull):
    """Twice the share of its two-sided posterior on the side where it may be."""
    linear.y = linear.y + pull * linear.columns["up"][0][:, 0]
    added = linear.evidence().best("up")
    mean, deviation = added.sizes(linear.evidence().residual[None])[0, 0], added.covariance[0, 0] ** 0.5
    two_sided = linear.ln_likelihood(("up", 0)) - linear.ln_likelihood()
    expected = two_sided + np.log(2) + stats.norm.logcdf(mean / deviation)
    assert linear.evidence().ln_factor("up")[0] == pytest.approx(expected, rel=1e-9)


def test_draws_of_the_residual_are_judged_as_data(linear, rng):
    """`chance` replaces the data by draws of the noise: the fit's own parameters are projected out of
    them."""
    found, root = linear.evidence(), np.linalg.cholesky(linear.covariance)
    drawn = rng.standard_normal((5, N))
    expected = [
        linear.ln_likelihood(("two", 0), y=root @ each) - linear.ln_likelihood(y=root @ each)
        for each in drawn
    ]
    assert found.ln_factor("two", drawn) == pytest.approx(expected, rel=1e-9)


def test_fits_start_from_the_sizes_that_are_expected_within_their_limits(linear):
    linear.y = linear.y - 8.0 * linear.columns["up"][0][:, 0]
    start = linear.evidence().start(("up",))
    assert start == {"e": 0.0}
    both = linear.evidence().start(("one", "two"))
    assert set(both) == {"a", "b", "d"}
    columns = np.hstack(
        [linear.evidence().best("one").direction.columns, linear.columns["two"][0], linear.base]
    )
    inverse, deviations = np.linalg.inv(linear.covariance), np.array([2.0, 1.5, 3.0, 5.0, 5.0])
    expected = np.linalg.solve(
        columns.T @ inverse @ columns + np.diag(deviations**-2), columns.T @ inverse @ linear.y
    )
    assert list(both.values()) == pytest.approx(expected[:3], rel=1e-9)
