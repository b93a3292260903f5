"""The evidence of a fit: exact for linear models, against closed forms and quadrature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats

from limbcli.diagnosis.explanations.forward_model import Fitted, Prior, Priors, Scalable
from limbcli.diagnosis.explanations.laplace import posterior
from limbcli.diagnosis.explanations.noise import Noise, NoisePart, common, correlated, independent

N = 12
CONSTANT = -0.5 * N * np.log(2 * np.pi)  # that evidences leave out
INF = np.inf


def noise_of(rng) -> Noise:
    order = np.arange(float(N))
    own = independent("own", rng.uniform(0.5, 1.5, N), source="repeats")
    return Noise((own, correlated("mesh", np.full(N, 0.4), order, correlation=0.8, source="computed")))


def fitted_at(J: np.ndarray, theta: np.ndarray, priors: tuple[Prior, ...], **more) -> Fitted:
    """A linear model, fitted well or badly: theta need not be the best."""
    names = tuple(f"p{k}" for k in range(len(theta)))
    return Fitted((), J @ theta, J, names, {}, priors=Priors.about(theta, priors), **more)


def near(noise: Noise, J: np.ndarray, y: np.ndarray, priors: tuple[Prior, ...], off: float) -> np.ndarray:
    """Parameters near the most probable ones: a step from them to these would gain `off` squared, halved."""
    inverse, precision = np.linalg.inv(noise.covariance), np.diag([each.deviation**-2 for each in priors])
    A = J.T @ inverse @ J + precision
    best = np.linalg.solve(A, J.T @ inverse @ y + precision @ [each.mean for each in priors])
    return best + off * np.linalg.inv(np.linalg.cholesky(A)).T[:, 0]


def ln_evidence(fitted: Fitted, y: np.ndarray, noise: Noise, *args, **more) -> float:
    return posterior(fitted, y, noise, *args, **more).ln_evidence + CONSTANT


def test_with_normal_priors_it_is_the_marginal_likelihood_though_the_fit_ended_a_little_off(rng):
    noise, J = noise_of(rng), rng.standard_normal((N, 3))
    mean, deviation = np.array([1.0, -2.0, 0.0]), np.array([1.0, 2.0, 6.0])
    priors = tuple(Prior(m, d) for m, d in zip(mean, deviation, strict=True))
    y = J @ (mean + deviation * rng.standard_normal(3)) + rng.standard_normal(N)
    covariance = noise.covariance + J @ np.diag(deviation**2) @ J.T
    expected = stats.multivariate_normal(J @ mean, covariance).logpdf(y)
    for off in (0.0, 1.3):
        one = fitted_at(J, near(noise, J, y, priors, off), priors)
        assert ln_evidence(one, y, noise) == pytest.approx(expected, rel=1e-9)
    form = 0.3 * np.eye(N)
    found = ln_evidence(fitted_at(J, near(noise, J, y, priors, 0.0), priors), y, noise, form=form)
    assert found == pytest.approx(stats.multivariate_normal(J @ mean, covariance + form).logpdf(y), rel=1e-9)


def test_errors_of_the_model_alone_are_amplified(rng):
    """Not those of the readings; so are the sizes of scalable ones, and the noise told afterwards."""
    J, priors, times = rng.standard_normal((N, 2)), (Prior(0.0, 1.0), Prior(0.0, 1.0)), rng.uniform(1, 3, N)
    own = independent("own", rng.uniform(0.5, 1.5, N), source="repeats")
    one, other = (
        Noise((own, independent("model: maps", size * np.full(N, 0.4), source="computed")))
        for size in (np.ones(N), times)
    )
    y, scalable = rng.standard_normal(N), [Scalable("model: maps", 0.2, 2.0)]
    best = near(other, J, y, priors, 0.0)
    found = posterior(fitted_at(J, best, priors, amplification=times), y, one, scalable)
    expected = posterior(fitted_at(J, best, priors), y, other, scalable)
    assert found.ln_evidence == pytest.approx(expected.ln_evidence)
    assert found.noise(one).covariance == pytest.approx(expected.noise(other).covariance)


def test_the_posterior_is_that_of_bayes(rng):
    noise, J, priors = noise_of(rng), rng.standard_normal((N, 2)), (Prior(1.0, 2.0), Prior(0.0, 0.5))
    y = 3.0 * rng.standard_normal(N)
    theta = near(noise, J, y, priors, 1.0)
    found = posterior(fitted_at(J, theta, priors), y, noise)
    inverse, precision = np.linalg.inv(noise.covariance), np.diag([0.25, 4.0])
    covariance = np.linalg.inv(J.T @ inverse @ J + precision)
    assert found.covariance == pytest.approx(covariance, rel=1e-9)
    mean = covariance @ (J.T @ inverse @ y + precision @ [1.0, 0.0])
    assert theta + found.step == pytest.approx(mean, rel=1e-9)


@pytest.mark.parametrize("pull", [-6.0, -0.5, 3.0])
def test_a_one_sided_prior_is_integrated_on_its_side_only(rng, pull):
    """Whether the best size lies on its side, at null or far beyond it. Also a uniform prior, of the same
    height as one between these limits has in its middle: 1 over its width. Against quadrature."""
    noise, J = noise_of(rng), rng.standard_normal((N, 1))
    y, whiten = J[:, 0] * pull + rng.standard_normal(N), np.linalg.inv(np.linalg.cholesky(noise.covariance))

    def likelihood(size: float) -> float:
        left = whiten @ (y - J[:, 0] * size)
        return float(np.exp(-0.5 * left @ left - 0.5 * N * np.log(2 * np.pi) + np.log(np.diag(whiten)).sum()))

    best = max(float(J[:, 0] @ whiten.T @ whiten @ y) / float(np.sum((whiten @ J) ** 2)), 0.0)
    half, uniform = Prior(0.0, 6.0, 0.0), Prior.uniform(0.0, 20.0)
    inside = {"limit": 20.0, "points": np.linspace(0.0, 5.0, 11).tolist()}
    of_half = integrate.quad(
        lambda x: likelihood(x) * 2 * stats.norm.pdf(x, 0, 6), 0, 20, points=inside["points"], limit=200
    )[0]
    of_uniform = integrate.quad(lambda x: likelihood(x) / 20, 0, 20, points=inside["points"], limit=200)[0]
    start = np.array([best])
    assert ln_evidence(fitted_at(J, start, (half,)), y, noise) == pytest.approx(np.log(of_half), abs=1e-4)
    assert ln_evidence(fitted_at(J, start, (uniform,)), y, noise) == pytest.approx(
        np.log(of_uniform), abs=0.02
    )


def test_a_parameter_that_the_data_do_not_determine_neither_gains_nor_loses(rng):
    noise, J, y = noise_of(rng), rng.standard_normal((N, 1)), rng.standard_normal(N)
    alone = fitted_at(J, np.zeros(1), (Prior(0.0, 3.0),))
    idle = np.hstack([J, np.zeros((N, 2))])
    for further in (Prior(0.0, 6.0), Prior(0.0, 6.0, 0.0), Prior.uniform(-4.0, 4.0)):
        beside = fitted_at(idle, np.zeros(3), (Prior(0.0, 3.0), further, further))
        expected = ln_evidence(alone, y, noise)
        # a uniform prior is judged as the normal one of the same height, which has 79 % within its limits
        lost = (
            2 * np.log(stats.norm.cdf(0.5 * np.sqrt(2 * np.pi)) * 2 - 1) if further.deviation == INF else 0.0
        )
        assert ln_evidence(beside, y, noise) == pytest.approx(expected + lost, abs=1e-9)


def test_points_of_a_grid_that_fit_as_well_count(rng):
    noise, J, y = noise_of(rng), rng.standard_normal((N, 1)), rng.standard_normal(N)
    one = fitted_at(J, np.zeros(1), (Prior(0.0, 3.0),))
    found = ln_evidence(replace(one, ln_points=-1.5), y, noise)
    assert found == pytest.approx(ln_evidence(one, y, noise) - 1.5)


@pytest.mark.parametrize("true", [0.1, 0.5, 1.0, 3.0])
def test_scalable_errors_have_the_size_of_the_largest_evidence(rng, true):
    """Within 0.02 of the largest over 400 shares: the search ends on a parabola."""
    J, order = rng.standard_normal((N, 1)), np.arange(float(N))
    maps = correlated("maps", np.full(N, 2.0), order, correlation=0.5, source="assumed")
    noise = Noise((independent("own", np.full(N, 0.3), source="repeats"), maps))
    y = np.linalg.cholesky(noise.with_share("maps", true).covariance) @ rng.standard_normal(N)
    one = fitted_at(J, near(noise, J, y, (Prior(0.0, 3.0),), 0.0), (Prior(0.0, 3.0),))
    least, most = 0.05, 4.0
    found = posterior(one, y, noise, [Scalable("maps", least, most), Scalable("not there", 0.1)])
    grid = [posterior(one, y, noise.with_share("maps", share)) for share in np.geomspace(least, most, 400)]
    largest = max(each.ln_evidence for each in grid)
    assert largest - 0.02 < found.ln_evidence < largest + 1e-3
    assert set(found.shares) == {"maps"}
    own = posterior(one, y, found.noise(noise))
    assert own.ln_evidence == pytest.approx(found.ln_evidence)
    assert own.covariance == pytest.approx(found.covariance)


@pytest.mark.parametrize("times", [0.3, 1.0, 4.0])
def test_noise_of_unknown_level_has_that_of_the_largest_evidence(rng, times):
    J, y = rng.standard_normal((N, 2)), times * rng.standard_normal(N)
    noise = Noise((independent("own", np.ones(N), source="assumed"),))
    priors = (Prior(0.0, 3.0), Prior(0.0, 3.0))
    one = fitted_at(J, near(noise, J, y, priors, 0.0), priors)
    found = posterior(one, y, noise, relative=True)
    levels = np.geomspace(0.1, 10.0, 400)
    parts = [Noise((NoisePart("own", level**2 * np.eye(N), "assumed"),)) for level in levels]
    grid = [posterior(one, y, each).ln_evidence for each in parts]
    assert max(grid) - 0.02 < found.ln_evidence < max(grid) + 1e-3
    assert found.level == pytest.approx(levels[int(np.argmax(grid))], rel=0.1)
    assert posterior(one, y, noise).level == 1.0


def test_a_fit_that_a_kink_stopped_is_judged_where_it_stands(rng):
    """Its slopes promise more than a deviation; one that they take further by less is taken there."""
    noise, J = Noise((common("own", np.zeros(N), source="repeats"),
                      independent("own", np.ones(N), source="repeats"))), np.ones((N, 1))  # fmt: skip
    for off, stays in ((1.0, True), (0.3, False)):
        found = posterior(fitted_at(J, np.zeros(1), (Prior.uniform(-9.0, 9.0),)), np.full(N, off), noise)
        assert (abs(float(found.step[0])) < 1e-12) is stays, "a gain of 6, and of 0.5"
