"""Forces of sites as readings of c, m and f_kappa together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limbcli.stiffness_field import PRIORS, Draws, HypothesisGrid, SiteReading, stiffness_field
from limbcli.stiffness_field.field import _combined
from limbcli.stiffness_field.kernel import Lengths, correlation
from limbcli.stiffness_field.readings import PARAMETERS
from tests.stiffness_field import synthetic as limb

ONE = HypothesisGrid((80.0,), (1.0,), (1.0,), (0.3,), (0.0,))  # a single hypothesis: closed forms hold
PLACES = [(60, 0), (110, 130), (160, 240)]
SLOPES = np.array([[1.0, 0.1, 0.1], [1.0, 0.3, 0.15]])  # of ln force by ln c, m, f_kappa at two depths
AT = np.array([0.0, 3.0])


def linear(logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return AT + SLOPES @ logs, SLOPES


def linear_site(*, noise=0.005, gain=0.0) -> SiteReading:
    """A site that reads c = 10 kPa, and the force of another tissue."""
    forces = np.exp(linear(np.log([0.012, 6.0, 200.0]))[0])
    force = limb.force_reading(linear, forces, noise=noise, gain=gain)
    return replace(limb.site("p1", limb.region(*PLACES[1]), 0.01, 0.1), force=force)


@pytest.fixture(scope="module")
def coordinates():
    return limb.coordinates()


def tissue_of(field, points) -> np.ndarray:
    """ln of the field's c, m and f_kappa, means over points."""
    return np.array([np.log(field.values_of(name, points).value).mean() for name in PARAMETERS])


def test_the_fields_tissue_gives_the_force_of_every_site(coordinates):
    """Three sites of different tissue, far from the prior's m and f_kappa, over the usual hypotheses."""
    tissues = [(0.009, 1.5, 20.0), (0.011, 7.0, 300.0), (0.010, 2.5, 60.0)]
    sites = [
        limb.with_force(limb.site(f"p{k}", limb.region(*where), 0.01, 0.1), np.array(tissue), noise=0.005)
        for k, (where, tissue) in enumerate(zip(PLACES, tissues, strict=True))
    ]
    field = stiffness_field(coordinates, sites)
    alone = stiffness_field(coordinates, [replace(each, force=None) for each in sites])
    for each in sites:
        assert each.force.ratio(tissue_of(field, each.points)) == pytest.approx(1.0, abs=0.02)
    ratios = [each.force.ratio(tissue_of(alone, each.points)) for each in sites]
    assert max(np.abs(np.log(ratios))) > 0.15  # there was something to reproduce


@pytest.mark.slow
def test_between_forces_of_one_place_that_contradict_each_other_the_tissue_stays_possible(coordinates):
    """Three tissues at one place, one with seven times the force of the others: no c, m and f_kappa near what
    is known of them give all, and absurd ones are not taken. What is left of the force is an error of it."""
    tissues = [(0.005, 1.4, 110.0), (0.010, 1.1, 600.0), (0.008, 8.0, 150.0)]
    sites = [
        limb.with_force(limb.site(f"p{k}", limb.region(*PLACES[0]), c, 0.1), np.array([c, m, f]), noise=0.01)
        for k, (c, m, f) in enumerate(tissues)
    ]
    sites[1] = replace(sites[1], force=replace(sites[1].force, fitted=5.0 * sites[1].force.fitted))
    field = stiffness_field(coordinates, sites)
    off = [np.log(each.force.ratio(tissue_of(field, each.points))) for each in sites]
    assert min(off) < 0 < max(off)
    c, m, f_kappa = np.exp(tissue_of(field, sites[0].points))
    assert 0.004 < c < 0.016
    assert 1.0 < m < 15.0
    assert 17.0 < f_kappa < 580.0
    draws = Draws(field, n=20)
    places = coordinates.places(sites[0].points)
    drawn = [sites[0].force.ratio(draws.draw(k).logs(places).mean(axis=0)) for k in range(draws.n)]
    assert np.std(np.log(drawn)) > 0.05


def test_one_force_gives_the_closed_form_and_the_models_errors_only_widen_it(coordinates):
    """A force linear in the logarithms, beside a reading of c: the estimate of least squares with the noise
    alone, and its variance with the model's error as well."""
    noise, gain = 0.02, 0.1
    read = linear_site(noise=noise, gain=gain)
    field = stiffness_field(coordinates, [read], grid=ONE)
    here = coordinates.places(read.points)
    own = 0.09 * correlation(here, here, Lengths(80.0, 1.0, 1.0)).mean()
    prior = np.diag([own + PRIORS[name].deviation ** 2 for name in PARAMETERS])
    mean = np.array([PRIORS[name].mean for name in PARAMETERS])
    rows = np.vstack([[1.0, 0.0, 0.0], SLOPES])
    counted = np.diag([0.1, noise, noise]) ** 2
    told = np.r_[np.log(0.01), np.log(read.force.fitted) - AT]
    weights = prior @ rows.T @ np.linalg.inv(rows @ prior @ rows.T + counted)
    expected = mean + weights @ (told - rows @ mean)
    error = weights @ np.r_[0.0, gain, gain]
    spread = np.diag(prior - weights @ rows @ prior) + error**2
    for k, name in enumerate(PARAMETERS):
        middle, variance = field.mean_over(name, read.points)
        assert middle[0] == pytest.approx(expected[k], abs=2e-3)
        assert variance[0] == pytest.approx(spread[k], rel=5e-3)


def test_draws_give_the_force_within_its_noise_and_the_errors_of_the_model(coordinates):
    for gain, low, high in ((0.0, 0.002, 0.01), (0.1, 0.07, 0.13)):
        read = linear_site(gain=gain)
        draws = Draws(stiffness_field(coordinates, [read], grid=ONE))
        places = coordinates.places(read.points)
        ratios = [np.log(read.force.ratio(draws.draw(k).logs(places).mean(axis=0))) for k in range(draws.n)]
        assert low < np.std(ratios) < high
        assert abs(np.mean(ratios)) < 0.4 * high


def test_combined_hypotheses_keep_the_probabilities_of_each_parameter():
    hypotheses = HypothesisGrid().combinations()
    rng = np.random.default_rng(7)
    shares = [rng.dirichlet(np.ones(len(hypotheses))) for _ in PARAMETERS]
    shares[1][:20] = 0.0
    shares[1] /= shares[1].sum()
    found = _combined(hypotheses, shares)
    for k, each in enumerate(shares):
        for hypothesis, share in zip(hypotheses, each, strict=True):
            total = sum(weight for names, weight in found if names[k] == hypothesis)
            assert total == pytest.approx(share, abs=1e-12)
