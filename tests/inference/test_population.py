"""The hierarchical estimate against what is known in closed form, and its coverage."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.inference import population
from limbcli.inference.population import _quantiles, estimate_population, row_modes

MIX = np.array([[1.0, 0.2, 0.0], [0.3, -0.8, 0.4], [0.0, 0.5, 1.0]])
MEAN, SPREAD = np.array([-4.8, -4.2, 1.1]), np.array([[0.09, 0.03, 0], [0.03, 0.16, 0.02], [0, 0.02, 0.06]])
PRIOR = np.array([0.3, 0.4, 0.3])


def linear(theta, slopes):
    values = theta @ MIX.T
    return values, np.broadcast_to(MIX, (*values.shape, 3)) if slopes else np.empty((*values.shape, 0))


def straight(theta, slopes):
    return theta, np.broadcast_to(np.eye(3), (*theta.shape, 3)) if slopes else np.empty((*theta.shape, 0))


def curved(theta, slopes):
    u = theta - MEAN
    values = u + 0.4 * u**2
    return values, (1 + 0.8 * u)[..., None] * np.eye(3) if slopes else np.empty((*values.shape, 0))


def cohort(model, n, sigma, rng):
    theta = rng.multivariate_normal(MEAN, SPREAD, n)
    noise = np.tile(np.diag(np.full(3, sigma**2)), (n, 1, 1))
    return theta, model(theta, False)[0] + rng.normal(0, sigma, (n, 3)), noise


def test_a_row_of_a_linear_model_is_the_conjugate_posterior(rng):
    _theta, seen, noise = cohort(linear, 200, 0.2, rng)
    people, rows = estimate_population(linear, seen, noise, start=MEAN + 0.5, prior_deviation=PRIOR)
    precision = MIX.T @ MIX / 0.2**2 + np.linalg.inv(people.spread)
    right = seen @ MIX / 0.2**2 + np.linalg.inv(people.spread) @ people.mean
    expected = np.linalg.solve(precision, right.T).T
    assert rows.mode == pytest.approx(expected, abs=1e-3)
    assert rows.mean == pytest.approx(expected, abs=0.12)  # 1000 draws
    deviation = np.sqrt(np.diag(np.linalg.inv(precision)))
    assert rows.deviation.mean(axis=0) == pytest.approx(deviation, rel=0.05)
    assert rows.effective.min() > 100


@pytest.mark.slow
def test_population_is_recovered_with_honest_errors(rng):
    _theta, seen, noise = cohort(linear, 400, 0.15, rng)
    people, _rows = estimate_population(linear, seen, noise, start=MEAN - 0.5, prior_deviation=PRIOR)
    assert np.abs(people.mean - MEAN) == pytest.approx(np.zeros(3), abs=4 * people.mean_error.max())
    assert people.deviation == pytest.approx(np.sqrt(np.diag(SPREAD)), rel=0.2)
    # Of n people without any noise the mean's error is deviation / sqrt(n): with noise it is a little more.
    least = np.sqrt(np.diag(SPREAD) / 400)
    assert (people.mean_error > 0.8 * least).all()
    assert (people.mean_error < 2.0 * least).all()


@pytest.mark.parametrize("n", [5, 7, 12])
def test_few_rows_have_the_errors_that_so_many_rows_leave(rng, n):
    _theta, seen, noise = cohort(linear, n, 0.15, rng)
    people, _rows = estimate_population(linear, seen, noise, start=MEAN, prior_deviation=PRIOR)
    back = np.linalg.inv(MIX)
    expected = np.sqrt(np.diag(people.spread + back @ noise[0] @ back.T) / n)  # of a Gaussian's mean
    assert people.mean_error == pytest.approx(expected, rel=0.1)
    # Of n + 3 rows (the prior weighs as three) and a Gaussian without noise: 1 / sqrt(2 (n + 3)).
    least = people.deviation / np.sqrt(2 * (n + 3))
    assert (people.deviation_error > 0.8 * least).all()
    assert (people.deviation_error < 2.0 * least).all()


def test_a_person_seen_four_times_is_not_four_people(rng):
    theta, once, noise = cohort(linear, 20, 0.1, rng)
    several = np.repeat(linear(theta, False)[0], 4, axis=0) + rng.normal(0, 0.1, (80, 3))
    names = np.repeat([f"P{k}" for k in range(20)], 4)
    usual = {"start": MEAN, "prior_deviation": PRIOR}
    of_once, _ = estimate_population(linear, once, noise, **usual)
    noise = np.repeat(noise, 4, axis=0)
    of_several, _ = estimate_population(linear, several, noise, people=names, **usual)
    of_rows, _ = estimate_population(linear, several, noise, people=np.arange(40), **usual)
    assert (of_several.mean_error > 0.75 * of_once.mean_error).all()
    assert (of_several.mean_error > 1.5 * of_rows.mean_error).all()


@pytest.mark.slow
def test_intervals_cover_at_their_rate_where_the_model_is_curved(rng):
    theta, seen, noise = cohort(curved, 400, 0.15, rng)
    _, rows = estimate_population(curved, seen, noise, start=MEAN + 0.2, prior_deviation=PRIOR)
    inside = (theta > rows.low) & (theta < rows.high)
    # 400 rows at 95 %: three deviations of the count are 3.3 %; the draws' own graininess adds some.
    assert inside.mean(axis=0) == pytest.approx(np.full(3, 0.95), abs=0.045)


@pytest.mark.slow
@pytest.mark.parametrize("wider", [0.5, 1.0, 1.5])
def test_intervals_of_five_people_cover_though_the_spread_is_not_that_of_the_prior(rng, wider):
    """Of the mean, of the spread, and of people of whom the readings tell less than the population does."""
    deviation = wider * PRIOR
    inside, own = np.zeros((2, 3)), np.zeros(3)
    for _ in range(40):
        theta = MEAN + deviation * rng.standard_normal((5, 3))
        noise = np.tile(np.diag((1.5 * deviation) ** 2), (5, 1, 1))
        seen = theta + 1.5 * deviation * rng.standard_normal((5, 3))
        few, rows = estimate_population(straight, seen, noise, start=MEAN, prior_deviation=PRIOR)
        for k, (ends, truth) in enumerate(((few.mean_interval, MEAN), (few.deviation_interval, deviation))):
            inside[k] += (ends[0] <= truth) & (truth <= ends[1])
        own += ((rows.low <= theta) & (theta <= rows.high)).sum(axis=0)
    # 40 at 95 %: 85 % and fewer have a probability of 1 %; more may be inside, as the prior holds spreads up.
    assert (inside >= 0.85 * 40).all(), inside / 40
    assert (own >= 0.9 * 200).all(), own / 200


def test_rows_without_information_are_the_population(rng):
    _theta, seen, noise = cohort(linear, 60, 0.1, rng)
    noise[0] *= 1e8
    people, rows = estimate_population(linear, seen, noise, start=MEAN, prior_deviation=PRIOR)
    assert rows.shrinkage[0].min() > 0.8
    assert rows.shrinkage[1:].max() < 0.6
    assert rows.mode[0] == pytest.approx(people.mean, abs=0.02)


def test_one_who_is_unlike_the_others_stands_out(rng):
    _theta, seen, noise = cohort(linear, 80, 0.1, rng)
    seen[5] += 2.5
    _, rows = estimate_population(linear, seen, noise, start=MEAN, prior_deviation=PRIOR)
    assert rows.misfit.argmax() == 5
    assert np.median(np.delete(rows.misfit, 5)) == pytest.approx(2.37, abs=1.0)  # chi-squared, 3 free


@pytest.mark.parametrize("reading", [0.05, 0.2, -0.1])
def test_a_row_that_is_open_to_one_side_is_sampled_there_too(reading):
    """Nothing below 0 is told apart, as beyond an end of the family; against the integral."""

    def clipped(theta, slopes):
        return np.maximum(theta, 0.0), (theta > 0)[..., None] * 1.0

    seen, noise = np.full((200, 1), reading), np.full((200, 1, 1), 0.1**2)
    problem = population._Problem(clipped, seen, noise)
    mean, spread = np.zeros(1), np.eye(1)
    draws = population._standard_draws(200, 1, 7)
    theta, covariance = population.modes(problem, mean, spread, np.full((200, 1), reading))
    found, variance = population._moments(
        *population._sampled(problem, mean, spread, theta, covariance, draws)
    )
    x = np.linspace(-8.0, 8.0, 160001)
    weight = np.exp(-0.5 * x**2 - 0.5 * ((reading - np.maximum(x, 0.0)) / 0.1) ** 2)
    right = np.sum(weight * x) / weight.sum()
    assert found.mean() == pytest.approx(right, abs=0.02)  # 200 rows alike
    assert found.std() < 0.1
    assert variance.mean() == pytest.approx(np.sum(weight * (x - right) ** 2) / weight.sum(), rel=0.05)


def test_rows_do_not_depend_on_each_other_under_a_given_population(rng):
    _theta, seen, noise = cohort(curved, 30, 0.1, rng)
    every = row_modes(curved, seen, noise, MEAN, SPREAD)
    one = row_modes(curved, seen[3:4], noise[3:4], MEAN, SPREAD)
    assert every[3:4] == pytest.approx(one, abs=1e-4)


@pytest.mark.parametrize(("last", "high"), [(0.001, 389.0), (0.1, 399.0)])
def test_an_interval_ends_at_the_largest_draw_where_that_weighs_much(last, high):
    points = np.arange(400.0)[:, None, None]
    weights = np.full((400, 1), (1.0 - last) / 399)
    weights[-1] = last
    assert _quantiles(points, weights, 0.975)[0] == pytest.approx(high, abs=1.0)
    assert _quantiles(points, weights, 0.025)[0] == pytest.approx(10.0, abs=1.0)
