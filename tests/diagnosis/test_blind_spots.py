"""What stays unseen and what it costs, in two data of which a fitted parameter takes one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limbcli.diagnosis.explanations.conclusions import BlindSpot, blind_spot
from limbcli.diagnosis.explanations.forward_model import Direction, Fitted, Prior, Priors
from limbcli.diagnosis.explanations.laplace import posterior
from limbcli.diagnosis.explanations.linear_evidence import Added, LinearEvidence
from limbcli.diagnosis.explanations.noise import Noise, independent
from limbcli.numbers.whitening import Whitener

LN_FACTOR = 2.0
WIDE = 1e4  # of the parameter's prior: the data alone decide


def linear(typical: float, sign: int = 0) -> tuple[Added, Fitted, Noise, Whitener]:
    """A parameter (a logarithm) that moves the first datum by 2; an effect that moves them by 0.6 and 0.8."""
    noise = Noise((independent("own", np.ones(2), source="spec"),))
    whiten, prior = Whitener.of(noise.covariance), Prior(0.0, WIDE)
    fitted = Fitted(
        (), np.zeros(2), np.array([[2.0], [0.0]]), ("c",), {}, priors=Priors.about(np.zeros(1), (prior,))
    )
    prior_of_size = Prior(0.0, 1.5 * typical, 0.0 if sign else -np.inf)
    direction = Direction(np.array([[0.6], [0.8]]), {"size": prior_of_size}, "at 3")
    found = LinearEvidence.about(fitted, np.zeros(2), whiten, {"x": [direction]})
    return found.best("x"), fitted, noise, whiten


def spot(typical: float, sign: int = 0) -> BlindSpot:
    added, fitted, noise, whiten = linear(typical, sign)
    nothing = posterior(fitted, np.zeros(2), noise)
    return blind_spot("x", added, np.array([typical]), nothing, whiten, ln_factor=LN_FACTOR)


def test_the_fitted_parameters_take_over_their_part_of_the_effect():
    found = spot(0.5)
    assert found.point == "at 3"
    assert found.visible_fraction == pytest.approx(0.8)
    assert found.bias_sd["c"] == pytest.approx(0.6 * 0.5)  # of 1/2, which is one deviation
    assert found.bias_percent["c"] == pytest.approx(100 * (np.exp(0.15) - 1))


@pytest.mark.parametrize("sign", [0, 1])
def test_the_size_that_can_be_detected_has_its_bayes_factor_four_times_of_five(sign, rng):
    """Data with the effect at this size; 40,000 draws know 80 % to 0.2 %. A size on one side only has half
    the prior to search, but for its limit at null, which takes 1 % here."""
    added = linear(4.0, sign)[0]
    size = 4.0 * spot(4.0, sign).detectable_times_typical
    residual = size * added.columns[:, 0] + rng.standard_normal((40_000, 2))
    assert np.mean(added.ln_factor(residual) > LN_FACTOR) == pytest.approx(0.8, abs=0.015)


def test_what_matters_is_unseen_and_moves_a_parameter_by_more_than_its_deviation():
    assert [spot(size).matters for size in (1.0, 3.0, 6.0)] == [False, True, False]  # too small, both, seen
    assert replace(spot(3.0), bias_sd={"c": -1.8}).matters


def test_what_the_fitted_parameters_reproduce_whole_is_never_detected():
    added, fitted, noise, whiten = linear(3.0)
    along = replace(added, columns=np.array([[1.0], [0.0]]), seen=np.zeros((2, 1)))
    nothing = posterior(fitted, np.zeros(2), noise)
    found = blind_spot("x", along, np.array([3.0]), nothing, whiten, ln_factor=LN_FACTOR)
    assert (found.visible_fraction, found.detectable_times_typical) == (0.0, np.inf)
