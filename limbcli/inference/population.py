"""Hierarchical (mixed-effects) estimate: each row has its own parameters, drawn from one population.

    y_i = g_i(theta_i) + noise,  noise ~ N(0, R_i),  theta_i ~ N(mean, spread)

y_i are the readings of a row, g_i is the model of that row, and theta_i are the logarithms of its parameters.
The population's mean and spread (covariance) maximise the likelihood times a weak inverse-Wishart prior on
the spread. The prior weighs as much as a few rows and keeps the spread from collapsing where the data hardly
inform a parameter. The maximum is found by expectation-maximisation: first with Laplace's approximation of
each row's posterior, then with importance sampling from wider t distributions centred on the row's mode and
on the population mean, which remains valid where the posterior is not Gaussian. The effective number of draws
shows whether the sampling can be trusted.

Standard errors come from the curvature of the posterior: the information of the complete data, minus the
information lost because the rows' parameters are not observed. Rows of one person are not independent; where
a person has several rows, the errors are at least those from the scatter of the scores summed by person. With
few people the uncertainty is larger than that of a Gaussian with this error: intervals of a mean use
Student's t with n_people - 1 degrees of freedom, and the upper end of a deviation uses chi-square. A row's
interval includes the uncertainty of the population mean, in the proportion in which the row's estimate
depends on that mean (Morris 1983, J Am Stat Assoc 78:47).

Source: Dempster, Laird and Rubin 1977, J R Stat Soc B 39:1; Gelman et al. 2013, Bayesian Data Analysis,
sections 10.4 (importance sampling) and 13.6 (EM for a hierarchical model); Louis 1982, J R Stat Soc B 44:226
(the curvature); Liang and Zeger 1986, Biometrika 73:13 (rows of one person).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtri, ndtri, stdtrit

from limbcli.model import Array

Model = Callable[[Array, bool], tuple[Array, Array]]
"""(theta (..., n, p), whether to compute derivatives) -> readings (..., n, q), derivatives (..., n, q, p)."""

DRAWS = 1000  # importance samples per row
_PRIOR_ROWS = 3.0  # weight of the prior on the spread, as a number of rows
_FREEDOM = 6.0  # degrees of freedom of the t proposal distribution
_WIDER = 1.15  # scale of the proposal relative to the Gaussian it replaces
_MOST_ROUNDS, _SAMPLED_ROUNDS = 150, 15  # largest number of EM rounds: Laplace, then importance sampling
_STILL = 1e-3  # convergence: change of the mean in one round, in standard deviations of the population
_STEPS, _STEPS_BETWEEN = 40, 4  # Gauss-Newton iterations: in the first and last round, and in those between
_HALVINGS = 8  # largest number of halvings of one step
_LARGEST_STEP = 1.0  # limit of a Gauss-Newton step in each parameter, in ln
_LOW, _HIGH = 0.025, 0.975  # quantiles at the ends of a 95 % interval
_LEAST_INFORMATION = 0.01  # lower limit of an eigenvalue of the information, in rows; less is sampling noise


@dataclass(frozen=True, eq=False)
class Population:
    """Estimated population.

    mean : (p,)
    spread : (p, p) covariance
    mean_error, deviation_error : (p,) standard errors of the means and of the standard deviations
    """

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
        reach = stdtrit(self.n_people - 1, _HIGH) * self.mean_error
        return self.mean - reach, self.mean + reach

    @property
    def deviation_interval(self) -> tuple[Array, Array]:
        """95 % interval of the standard deviations: low, high (p,). Above by chi-square, with the degrees of
        freedom of the standard error, or as many as the prior's rows; below by the Gaussian error, as there
        the prior keeps the spread from falling."""
        free = np.maximum(0.5 * (self.deviation / self.deviation_error) ** 2, _PRIOR_ROWS)
        low = self.deviation - ndtri(_HIGH) * self.deviation_error
        return np.maximum(low, 0.0), self.deviation * np.sqrt(free / chdtri(free, 1.0 - _LOW))


@dataclass(frozen=True, eq=False)
class Rows:
    """Posterior of each row under the estimated population; mean, deviation, mode : (n, p).

    low, high : ends of the 95 % interval, including the uncertainty of the population mean (n, p)
    effective : effective number of draws (n,); shrinkage : posterior over population variance (n, p), 1 where
        the data do not inform the parameter
    misfit : squared Mahalanobis distance (n,) of the readings from those of the population mean, by
        population and noise together; chi-square with as many degrees of freedom as readings
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

    model: Model
    readings: Array
    noise: Array

    @cached_property
    def weights(self) -> Array:
        return _inverse(self.noise)


def estimate_population(
    model: Model, readings: Array, noise: Array, *, start: Array, prior_deviation: Array,
    people: Array | None = None, seed: int = 7,
) -> tuple[Population, Rows]:  # fmt: skip
    """Mean and spread of a population, and the posterior of each row.

    readings : (n, q)
    noise : (n, q, q) covariances
    start : (p,) initial guess of the mean
    prior_deviation : (p,) standard deviation that the weak prior on the spread expects
    people : (n,) the person of each row; None: each row belongs to a different person
    """
    problem = _Problem(model, readings, noise)
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
    """Most likely parameters (n, p) of each row under a given population."""
    problem = _Problem(model, readings, noise)
    return modes(problem, mean, spread, np.tile(mean, (len(readings), 1)))[0]


def modes(
    problem: _Problem, mean: Array, spread: Array, start: Array, *, steps: int = _STEPS
) -> tuple[Array, Array]:
    """Most likely parameters (n, p) of each row under a given population, and their covariance (n, p, p):
    Gauss-Newton iterations, in which a step that increases the cost is halved."""
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
    """Negative log of likelihood times prior, up to a constant: (..., n), from values (..., n, q)."""
    missed, apart = problem.readings - values, theta - mean
    fit = np.einsum("...ni,nij,...nj->...n", missed, problem.weights, missed)
    return np.asarray(0.5 * (fit + np.einsum("...ni,ij,...nj->...n", apart, precision, apart)))


def _quadratic(
    problem: _Problem, values: Array, slopes: Array, theta: Array, mean: Array, precision: Array
) -> tuple[Array, Array]:
    weighted = np.einsum("nqp,nqr->npr", slopes, problem.weights)
    hessian = weighted @ slopes + precision
    missed = problem.readings - values
    gradient = -np.einsum("npr,nr->np", weighted, missed) + (theta - mean) @ precision
    return hessian, gradient


def _maximised(theta: Array, covariance: Array, prior: Array) -> tuple[Array, Array]:
    """Population mean and spread of the largest expected log posterior (M step), from each row's moments."""
    mean = theta.mean(axis=0)
    apart = theta - mean
    total = covariance.sum(axis=0) + apart.T @ apart + prior
    return mean, total / (len(theta) + _PRIOR_ROWS)


def _standard_draws(n: int, p: int, seed: int) -> Array:
    """Draws (DRAWS, n, p) from a standard t distribution, in antithetic pairs."""
    rng = np.random.default_rng(seed)
    half = rng.standard_normal((DRAWS // 2, n, p))
    half /= np.sqrt(rng.chisquare(_FREEDOM, (DRAWS // 2, n, 1)) / _FREEDOM)
    return np.concatenate([half, -half])


def _sampled(
    problem: _Problem, mean: Array, spread: Array, theta: Array, covariance: Array, draws: Array
) -> tuple[Array, Array]:
    """Importance sampling: points (DRAWS, n, p) and weights (DRAWS, n) that sum to 1 over the draws.

    Half of the points are drawn around each row's mode, half from the population: where the readings bound a
    parameter on one side only, most of its posterior lies far from the mode.
    """
    near, far = (np.asarray(_WIDER * np.linalg.cholesky(each), float) for each in (covariance, spread))
    points = np.concatenate([theta + np.einsum("nij,dnj->dni", near, draws[::2]), mean + draws[1::2] @ far.T])
    values, _ = problem.model(points, False)
    logs = -_cost(problem, values, points, mean, _inverse(spread))
    logs -= np.logaddexp(_log_density(points - theta, near), _log_density(points - mean, far))
    logs -= logs.max(axis=0)
    weights = np.exp(logs)
    return points, weights / weights.sum(axis=0)


def _log_density(apart: Array, root: Array) -> Array:
    """Log density (d, n) of the t proposal distribution, up to a constant; root : Cholesky factor (p, p) or
    (n, p, p)."""
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
    """Standard errors (2 p,) of means and deviations, in the population's, at fixed correlations."""
    deviation = np.sqrt(np.diag(spread))
    apart, like = (points - mean) / deviation, spread / np.outer(deviation, deviation)
    precision = _inverse(like)
    pulled = apart @ precision
    scores = np.concatenate([pulled, apart * pulled - 1.0], axis=2)  # complete data, by draw and row
    own = np.einsum("dn,dni->ni", weights, scores)
    lost = np.einsum("dn,dni,dnj->ij", weights, scores - own, scores - own)
    # information matrix (2 p, 2 p) of the complete data (rows whose parameters are observed), including the
    # prior on the spread
    p = len(precision)
    summed = np.einsum("dn,dni->i", weights, apart)
    squares = np.einsum("dn,dni,dnj->ij", weights, apart, apart) + (prior / np.outer(deviation, deviation))
    complete = np.empty((2 * p, 2 * p))
    complete[:p, :p] = apart.shape[1] * precision
    complete[:p, p:] = precision * summed + np.diag(precision @ summed)
    complete[p:, :p] = complete[:p, p:].T
    complete[p:, p:] = squares * precision + np.diag(np.diag(precision @ squares))
    information, ways = np.linalg.eigh(complete - lost)
    errors = (ways / np.maximum(information, _LEAST_INFORMATION)) @ ways.T
    variance = np.diag(errors)
    if people is not None and len(set(people.tolist())) < len(people):
        _, number = np.unique(people.astype(str), return_inverse=True)
        together = np.zeros((number.max() + 1, own.shape[1]))
        np.add.at(together, number, own - own.mean(axis=0))
        scatter = together.T @ together * len(together) / max(len(together) - 1, 1)
        variance = np.maximum(variance, np.diag(errors @ scatter @ errors))
    return np.asarray(np.sqrt(variance))


def _rows(
    problem: _Problem, population: Population, mode: Array, points: Array, weights: Array, seed: int
) -> Rows:
    middle, covariance = _moments(points, weights)
    # Fraction of a shift of the population mean by which the row's estimate shifts.
    taken = covariance @ _inverse(population.spread)
    rng = np.random.default_rng([seed, 1])
    mean_errors = np.asarray(rng.standard_t(population.n_people - 1, points.shape) * population.mean_error)
    shifted = points + np.einsum("nij,dnj->dni", taken, mean_errors)
    low, high = (_quantiles(shifted, weights, q) for q in (_LOW, _HIGH))
    variance = np.einsum("nii->ni", covariance)
    shrinkage = np.clip(variance / np.diag(population.spread), 0.0, 1.0)
    misfit = _misfit(problem, population.mean, population.spread)
    effective = 1.0 / np.sum(weights**2, axis=0)
    return Rows(middle, np.sqrt(variance), low, high, mode, effective, shrinkage, misfit)


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
