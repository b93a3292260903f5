"""Standard errors, and the plain word per parameter."""

import numpy as np

from limbcli.inference.identifiability import correlation, has_influence, log_covariance, verdict
from limbcli.inference.parameter import FitParameter
from limbcli.inference.profile import Profile

F_KAPPA = FitParameter("f_kappa", 100.0, 0.01, 1000.0)


def profile(low, high, open_low=False, open_high=False):
    empty = np.zeros(0)
    return Profile("f_kappa", empty, empty, empty, low, high, open_low, open_high, empty)


def test_covariance_is_the_scatter_of_repeated_fits(rng):
    design = rng.standard_normal((12, 2))
    variance = rng.uniform(0.2, 3.0, 12)
    held = rng.standard_normal(12)
    stated = log_covariance(design, variance, nuisance=held, nuisance_deviation=0.7)
    noise = (
        rng.standard_normal((40000, 12)) * np.sqrt(variance) + 0.7 * rng.standard_normal((40000, 1)) * held
    )
    fits = noise @ np.linalg.pinv(design).T
    np.testing.assert_allclose(np.cov(fits.T), stated, rtol=0.05, atol=0.02)


def test_a_parameter_without_influence_has_no_standard_error(rng):
    design = np.column_stack([rng.standard_normal(8), np.zeros(8)])
    covariance = log_covariance(design, np.ones(8))
    assert np.isfinite(covariance[0, 0])
    assert np.isnan(covariance[1]).all()
    assert list(has_influence(design, np.ones(8))) == [True, False]


def test_every_verdict_has_its_case():
    cases = {
        "identified": verdict(F_KAPPA, 100.0, profile(80.0, 130.0), influence=True),
        "weak": verdict(F_KAPPA, 100.0, profile(60.0, 1000.0, open_high=True), influence=True),
        "at bound": verdict(F_KAPPA, 1000.0, profile(60.0, 1000.0, open_high=True), influence=True),
        "no influence": verdict(F_KAPPA, 100.0, None, influence=False),
        "trades off with m": verdict(
            F_KAPPA, 100.0, profile(20.0, 400.0), influence=True, correlations=[("c", 0.2), ("m", -0.99)]
        ),
    }
    for flag, found in cases.items():
        assert found.flag == flag
    assert "not identifiable from these data" in cases["weak"].words
    assert "exclude only values below 60" in cases["weak"].words
    wide = verdict(F_KAPPA, 100.0, profile(0.01, 1000.0, True, True), influence=True)
    assert wide.flag == "weak"
    assert "exclude no value" in wide.words


def test_without_noise_there_is_no_correlation_and_no_warning():
    with np.errstate(all="raise"):
        found = correlation(np.zeros((2, 2)))
    assert np.isnan(found).all()


def test_without_an_interval_the_standard_error_decides_and_without_noise_nothing_does():
    sure = verdict(F_KAPPA, 100.0, None, influence=True, log_deviation=0.05)
    assert (sure.flag, "standard error 5 %" in sure.words) == ("identified", True)
    assert verdict(F_KAPPA, 100.0, None, influence=True, log_deviation=0.5).flag == "weak"
    assert verdict(F_KAPPA, 100.0, None, influence=True, log_deviation=1e9).flag == "weak"
    unknown = verdict(F_KAPPA, 100.0, None, influence=True, why_no_profile="the case states no noise")
    assert unknown.flag == "weak"
    assert unknown.words == "f_kappa = 100; how sure that is cannot be determined: the case states no noise."
    bound = verdict(F_KAPPA, 1000.0, None, influence=True, why_no_profile="the case states no noise")
    assert bound.words.endswith("the case states no noise.")
