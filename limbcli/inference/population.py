"""A hierarchical estimate: every row has parameters of its own, drawn from one population.

    y_i = g_i(theta_i) + noise,  noise ~ N(0, R_i),  theta_i ~ N(mean, spread)

y_i are a row's readings, g_i the model of that row, theta_i logarithms of its parameters. The population's
mean and spread are those of greatest likelihood but for a weak inverse-Wishart prior on the spread, which
keeps it from collapsing where a parameter is hardly seen (it weighs as much as a few rows). They are found by
expectation-maximisation: first with Laplace's approximation of every row's distribution, then with
importance sampling from wider t distributions round it and round the population, which is right where the
row's distribution is not Gaussian. The effective number of draws says whether the sampling can be trusted.

Standard errors come from the curvature of the likelihood with the prior: the information of complete rows,
less what is lost as their parameters are not seen. Rows of one person are not independent: where there are
any, errors are no smaller than by the scatter of the people's own scores. Few people leave more uncertainty
than a Gaussian of that error has: a mean is that of Student's t for as many people less one, the upper end
of a deviation that of chi-square. What a row takes from the mean, it takes with the mean's uncertainty
(Morris 1983, J Am Stat Assoc 78:47).

Source: Dempster, Laird and Rubin 1977, J R Stat Soc B 39:1; Gelman et al. 2013, Bayesian Data Analysis,
sections 10.4 (importance sampling) and 13.6 (EM for a hierarchical model); Louis 1982, J R Stat Soc B 44:226
(the curvature); Liang and Zeger 1986, Biometrika 73:13 (rows that belong together).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm
from scipy.stats import t as student_t

from limbcli.model import Array

Model = Callable[[Array, bool], tuple[Array, Array]]
"""theta (..., n, p), whether derivatives are wanted -> readings (..., n, q), derivatives (..., n, q, p)."""

DRAWS = 1000
_PRIOR_ROWS = 3.0  # rows that the prior on the spread weighs as much as
_FREEDOM = 6.0  # of the t distribution that is drawn from
_WIDER = 1.15
_MOST_ROUNDS, _SAMPLED_ROUNDS = 150, 15
_STILL = 1e-3
_STEPS, _STEPS_BETWEEN = 40, 4  # of Newton's method: at the ends, and between two rounds
_HALVINGS = 8
_LARGEST_STEP = 1.0
_LOW, _HIGH = 0.025, 0.975  # of a 95 % interval
_LEAST_TOLD = 0.01  # rows' worth of information: less is the draws' graininess


@dataclass(frozen=True, eq=False)
class Population:
    """mean (p,), spread (p, p) covariance; standard errors of the means and of the deviations (p,)."""

    mean: Array
    spread: Array
    mean_error: Array
    deviation_error: Array
    n_people: int
    rounds: int

    @property
    def deviation(self) -> Array:
        return np.asarray(np.sqrt(np.diag(self.spread)))

    @property
    def mean_interval(self) -> tuple[Array, Array]:
        """95 % interval of the means: low, high (p,)."""
        reach = student_t.ppf(_HIGH, self.n_people - 1) * self.mean_error
        return self.mean - reach, self.mean + reach

    @property
    def deviation_interval(self) -> tuple[Array, Array]:
        """95 % interval of the deviations: low, high (p,).

        Upwards by chi-square with as many degrees of freedom as give this error, and no fewer than the rows
        that the prior weighs as much as; downwards by the error itself, as below the prior's deviation it is
        the prior that holds the spread up.
        """
        free = np.maximum(0.5 * (self.deviation / self.deviation_error) ** 2, _PRIOR_ROWS)
        low = self.deviation - norm.ppf(_HIGH) * self.deviation_error
        return np.maximum(low, 0.0), self.deviation * np.sqrt(free / chi2.ppf(_LOW, free))


@dataclass(frozen=True, eq=False)
class Rows:
    """Of every row: posterior mean and deviation under the population found (n, p), low and high of the 95 %
    interval with the uncertainty of the population's mean (n, p), the mode (n, p), effective draws (n,), and
    how much of the population's variance was left unlearnt (n, p), 0 to 1.

    misfit (n,): distance of the readings from those of the population's middle, squared, in deviations of
    both population and noise; as many degrees of freedom as readings.
    """

    mean: Array
    deviation: Array
    low: Array
    high: Array
    mode: Array
    effective: Array
    shrinkage: Array
    misfit: Array


@dataclass(frozen=True, eq=False)
class _Problem:
    """readings (n, q), noise covariances (n, q, q) with their inverses, and the model."""

    readings: Array
    noise: Array
    weights: Array
    model: Model


def estimate_population(
    model: Model,
    readings: Array,
    noise: Array,
    *,
    start: Array,
    prior_deviation: Array,
    people: Array | None = None,
    seed: int = 7,
) -> tuple[Population, Rows]:
    """Mean and spread of a population, and every row's own estimate.

    readings (n, q); noise (n, q, q), covariances; start (p,) a first mean; prior_deviation (p,) the deviation
    that the weak prior on the spread expects; people (n,) whose each row is, None: each of somebody else.
    """
    problem = _Problem(readings, noise, _inverse(noise), model)
    prior = _PRIOR_ROWS * np.diag(prior_deviation**2)
    mean, spread = start.astype(float), np.diag(prior_deviation**2)
    theta = np.tile(mean, (len(readings), 1))
    rounds = 0
    for rounds in range(1, _MOST_ROUNDS + 1):
        theta, covariance = modes(
            problem, mean, spread, theta, steps=_STEPS if rounds == 1 else _STEPS_BETWEEN
        )
        before = mean
        mean, spread = _maximised(theta, covariance, prior)
        if np.max(np.abs(mean - before) / np.sqrt(np.diag(spread))) < _STILL:
            break
    draws = _standard_draws(len(readings), len(mean), seed)
    for _ in range(_SAMPLED_ROUNDS):
        theta, covariance = modes(problem, mean, spread, theta, steps=_STEPS_BETWEEN)
        points, weights = _sampled(problem, mean, spread, theta, covariance, draws)
        before = mean
        mean, spread = _maximised(*_moments(points, weights), prior)
        rounds += 1
        if np.max(np.abs(mean - before) / np.sqrt(np.diag(spread))) < 3 * _STILL:
            break
    theta, covariance = modes(problem, mean, spread, theta)
    points, weights = _sampled(problem, mean, spread, theta, covariance, draws)
    errors = _errors(points, weights, mean, spread, prior, people)
    by_mean, by_deviation = np.split(errors, 2) * np.sqrt(np.diag(spread))
    n_people = len(readings) if people is None else len(set(people.tolist()))
    population = Population(mean, spread, by_mean, by_deviation, n_people, rounds)
    return population, _rows(problem, population, theta, points, weights, seed)


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def row_modes(model: Model, readings: Array, noise: Array, mean: Array, spread: Array) -> Array:
    """The most likely parameters (n, p) of every row under a population that is given."""
    problem = _Problem(readings, noise, _inverse(noise), model)
    return modes(problem, mean, spread, np.tile(mean, (len(readings), 1)))[0]


def modes(
    problem: _Problem, mean: Array, spread: Array, start: Array, *, steps: int = _STEPS
) -> tuple[Array, Array]:
    """The most likely parameters (n, p) of every row under a population, and their covariance (n, p, p).

    Gauss-Newton with steps cut in half where they climb.
    """
    precision = _inverse(spread)
    theta = start.copy()
    values, slopes = problem.model(theta, True)
    cost = _cost(problem, values, theta, mean, precision)
    for _ in range(steps):
        hessian, gradient = _quadratic(problem, values, slopes, theta, mean, precision)
        step = np.clip(-np.linalg.solve(hessian, gradient[..., None])[..., 0], -_LARGEST_STEP, _LARGEST_STEP)
        pace = np.ones(len(theta))
        for _ in range(_HALVINGS):
            tried = theta + pace[:, None] * step
            tried_values, _ = problem.model(tried, False)
            new = _cost(problem, tried_values, tried, mean, precision)
            worse = new > cost + 1e-12
            if not worse.any():
                break
            pace[worse] *= 0.5
        better = new <= cost + 1e-12
        moved = float(np.max(np.abs(pace[:, None] * step)[better], initial=0.0))
        theta = np.where(better[:, None], tried, theta)
        values, slopes = problem.model(theta, True)
        cost = _cost(problem, values, theta, mean, precision)
        if moved < 1e-5:
            break
    hessian, _ = _quadratic(problem, values, slopes, theta, mean, precision)
    return theta, _inverse(hessian)


def _cost(problem: _Problem, values: Array, theta: Array, mean: Array, precision: Array) -> Array:
    """Minus the logarithm of likelihood times prior, but for a constant: (...,)."""
    missed, apart = problem.readings - values, theta - mean
    fit = np.einsum("ni,nij,nj->n", missed, problem.weights, missed)
    return np.asarray(0.5 * (fit + np.einsum("ni,ij,nj->n", apart, precision, apart)))


def _quadratic(
    problem: _Problem, values: Array, slopes: Array, theta: Array, mean: Array, precision: Array
) -> tuple[Array, Array]:
    weighted = np.einsum("nqp,nqr->npr", slopes, problem.weights)
    hessian = weighted @ slopes + precision
    missed = problem.readings - values
    gradient = -np.einsum("npr,nr->np", weighted, missed) + (theta - mean) @ precision
    return hessian, gradient


def _maximised(theta: Array, covariance: Array, prior: Array) -> tuple[Array, Array]:
    """Mean and spread from every row's mean and covariance."""
    mean = theta.mean(axis=0)
    apart = theta - mean
    total = covariance.sum(axis=0) + apart.T @ apart + prior
    return mean, total / (len(theta) + _PRIOR_ROWS)


def _standard_draws(n: int, p: int, seed: int) -> Array:
    """(DRAWS, n, p) of a standard t distribution, in pairs of opposite sign."""
    rng = np.random.default_rng(seed)
    half = rng.standard_normal((DRAWS // 2, n, p))
    half /= np.sqrt(rng.chisquare(_FREEDOM, (DRAWS // 2, n, 1)) / _FREEDOM)
    return np.concatenate([half, -half])


def _sampled(
    problem: _Problem, mean: Array, spread: Array, theta: Array, covariance: Array, draws: Array
) -> tuple[Array, Array]:
    """Points (DRAWS, n, p) and weights (DRAWS, n) that sum to 1 over the draws.

    Half of the points lie round every row's mode, half are of the population: where readings leave a row open
    to one side, most of what it may be lies far from its mode.
    """
    near, far = (np.asarray(_WIDER * np.linalg.cholesky(each), float) for each in (covariance, spread))
    points = np.concatenate([theta + np.einsum("nij,dnj->dni", near, draws[::2]), mean + draws[1::2] @ far.T])
    values, _ = problem.model(points, False)
    precision = _inverse(spread)
    missed, apart = problem.readings - values, points - mean
    logs = -0.5 * np.einsum("dni,nij,dnj->dn", missed, problem.weights, missed)
    logs -= 0.5 * np.einsum("dni,ij,dnj->dn", apart, precision, apart)
    logs -= np.logaddexp(_log_density(points - theta, near), _log_density(apart, far))
    logs -= logs.max(axis=0)
    weights = np.exp(logs)
    return points, weights / weights.sum(axis=0)


def _log_density(apart: Array, root: Array) -> Array:
    """Of the t distribution that is drawn from, (d, n), but for a constant; root (p, p), or (n, p, p)."""
    p = apart.shape[-1]
    standard = (_inverse(root) @ apart[..., None])[..., 0]
    size = np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(axis=-1)
    return np.asarray(-size - 0.5 * (_FREEDOM + p) * np.log1p(np.sum(standard**2, axis=-1) / _FREEDOM))


def _moments(points: Array, weights: Array) -> tuple[Array, Array]:
    mean = np.einsum("dn,dni->ni", weights, points)
    apart = points - mean
    return mean, np.einsum("dn,dni,dnj->nij", weights, apart, apart)


def _errors(
    points: Array, weights: Array, mean: Array, spread: Array, prior: Array, people: Array | None
) -> Array:
    """Standard errors (2 p,) of means and of deviations, in deviations of the population; with the
    correlations held."""
    deviation = np.sqrt(np.diag(spread))
    apart, like = (points - mean) / deviation, spread / np.outer(deviation, deviation)
    precision = _inverse(like)
    pulled = apart @ precision
    scores = np.concatenate([pulled, apart * pulled - 1.0], axis=2)  # of complete data, by draw and row
    own = np.einsum("dn,dni->ni", weights, scores)
    lost = np.einsum("dn,dni,dnj->ij", weights, scores - own, scores - own)
    complete = _complete_information(apart, weights, precision, prior / np.outer(deviation, deviation))
    information, ways = np.linalg.eigh(complete - lost)
    errors = (ways / np.maximum(information, _LEAST_TOLD)) @ ways.T
    variance = np.diag(errors)
    if people is not None and len(set(people.tolist())) < len(people):
        _, number = np.unique(people.astype(str), return_inverse=True)
        together = np.zeros((number.max() + 1, own.shape[1]))
        np.add.at(together, number, own - own.mean(axis=0))
        scatter = together.T @ together * len(together) / max(len(together) - 1, 1)
        variance = np.maximum(variance, np.diag(errors @ scatter @ errors))
    return np.asarray(np.sqrt(variance))


def _complete_information(apart: Array, weights: Array, precision: Array, prior: Array) -> Array:
    """(2 p, 2 p) of rows whose parameters were seen, and of the prior on the spread."""
    p = len(precision)
    summed = np.einsum("dn,dni->i", weights, apart)
    squares = np.einsum("dn,dni,dnj->ij", weights, apart, apart) + prior
    out = np.empty((2 * p, 2 * p))
    out[:p, :p] = apart.shape[1] * precision
    out[:p, p:] = precision * summed + np.diag(precision @ summed)
    out[p:, :p] = out[:p, p:].T
    out[p:, p:] = squares * precision + np.diag(np.diag(precision @ squares))
    return out


def _rows(
    problem: _Problem, population: Population, mode: Array, points: Array, weights: Array, seed: int
) -> Rows:
    middle, covariance = _moments(points, weights)
    taken = covariance @ _inverse(population.spread)  # of a shift of the population's mean
    mean_errors = _mean_errors(population, points.shape, seed)
    shifted = points + np.einsum("nij,dnj->dni", taken, mean_errors)
    low, high = (_quantiles(shifted, weights, q) for q in (_LOW, _HIGH))
    variance = np.einsum("nii->ni", covariance)
    return Rows(
        middle,
        np.sqrt(variance),
        low,
        high,
        mode,
        1.0 / np.sum(weights**2, axis=0),
        np.clip(variance / np.diag(population.spread), 0.0, 1.0),
        _misfit(problem, population.mean, population.spread),
    )


def _mean_errors(population: Population, shape: tuple[int, ...], seed: int) -> Array:
    """Draws (DRAWS, n, p) of how far off the population's mean is; a row of it for each row."""
    rng = np.random.default_rng([seed, 1])
    return np.asarray(rng.standard_t(population.n_people - 1, shape) * population.mean_error)


def _quantiles(points: Array, weights: Array, q: float) -> Array:
    order = np.argsort(points, axis=0)
    places = np.take_along_axis(points, order, axis=0)
    shares = np.take_along_axis(np.broadcast_to(weights[:, :, None], points.shape), order, axis=0)
    reached = np.cumsum(shares, axis=0) - 0.5 * shares
    first = np.minimum(np.sum(reached < q, axis=0), len(points) - 1)
    return np.asarray(np.take_along_axis(places, first[None], axis=0)[0])


def _misfit(problem: _Problem, mean: Array, spread: Array) -> Array:
    n = len(problem.readings)
    values, slopes = problem.model(np.tile(mean, (n, 1)), True)
    expected = slopes @ spread @ slopes.transpose(0, 2, 1) + problem.noise
    missed = problem.readings - values
    return np.asarray(np.einsum("ni,ni->n", missed, np.linalg.solve(expected, missed[..., None])[..., 0]))
