"""Standard errors, and the plain word per parameter."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.stats import chi2, norm
from scipy.stats import t as student

from limbcli.inference.adaptive import adaptive_profiles
from limbcli.inference.identifiability import NoProfile, correlation, has_influence, log_covariance, verdict
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import Residual
from limbcli.inference.profile import Profile
from limbcli.numbers.interval_limits import THRESHOLD_95, noise_scale, threshold_95
from limbcli.reporting.headline import headline

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


def test_parameters_that_make_up_for_each_other_whole_have_no_standard_error(rng):
    """Their scatter has no bounds; what else the data tell keeps its own."""
    one, other = rng.standard_normal((2, 8))
    covariance = log_covariance(np.column_stack([one, 3.0 * one, other]), np.ones(8))
    assert np.isnan(covariance[:2]).all()
    whole = log_covariance(np.column_stack([one, other]), np.ones(8))
    assert covariance[2, 2] == pytest.approx(whole[1, 1])


def test_every_verdict_has_its_case():
    cases = {
        "identified": verdict(F_KAPPA, 100.0, profile(80.0, 130.0), influence=True),
        "weak": verdict(F_KAPPA, 100.0, profile(60.0, 1000.0, open_high=True), influence=True),
        "at bound": verdict(F_KAPPA, 1000.0, profile(60.0, 1000.0, open_high=True), influence=True),
        "no influence": verdict(F_KAPPA, 100.0, NoProfile(), influence=False),
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


def test_what_the_data_exclude_is_told_also_where_the_parameter_moves_nothing_any_more():
    """Nearly incompressible tissue: a larger f_kappa changes no force, a small one is excluded."""
    above = profile(2.5, 1000.0, open_high=True)
    at_bound = verdict(F_KAPPA, 1000.0, above, influence=False)
    assert at_bound.flag == "at bound"
    assert at_bound.words.endswith("the data exclude only values below 2.5 (95 %).")
    assert verdict(F_KAPPA, 700.0, above, influence=False).flag == "weak"
    assert verdict(F_KAPPA, 700.0, profile(0.01, 1000.0, True, True), influence=False).flag == "no influence"


def test_without_noise_there_is_no_correlation_and_no_warning():
    with np.errstate(all="raise"):
        found = correlation(np.zeros((2, 2)))
    assert np.isnan(found).all()


def test_without_an_interval_the_standard_error_decides_and_without_noise_nothing_does():
    sure = verdict(F_KAPPA, 100.0, NoProfile(log_deviation=0.05), influence=True)
    assert (sure.flag, "standard error 5 %" in sure.words) == ("identified", True)
    assert verdict(F_KAPPA, 100.0, NoProfile(log_deviation=0.5), influence=True).flag == "weak"
    assert verdict(F_KAPPA, 100.0, NoProfile(log_deviation=1e9), influence=True).flag == "weak"
    unknown = verdict(F_KAPPA, 100.0, NoProfile("the case states no noise"), influence=True)
    assert unknown.flag == "weak"
    assert unknown.words == "f_kappa = 100; its uncertainty cannot be determined: the case states no noise."
    bound = verdict(F_KAPPA, 1000.0, NoProfile("the case states no noise"), influence=True)
    assert bound.words.endswith("the case states no noise.")


@pytest.mark.parametrize(("value", "which"), [(0.01, "lower"), (1000.0, "upper")])
def test_a_headline_without_an_interval_names_the_bound(value, which):
    found = verdict(F_KAPPA, value, NoProfile(), influence=True)
    message = headline(value, None, None, found.flag, bound=found.bound, computed=False)
    assert str(message) == f"at the {which} bound of the search"


def test_the_words_of_a_parameter_with_a_unit_are_in_that_unit():
    c = FitParameter("c", 8.0, 0.8, 80.0, "log")
    for low, high, is_open, words in (
        (7.0, 9.0, (False, False), "c is identified: 7 to 9 kPa (95 %)."),
        (4.0, 13.3, (False, False), "values below 4 kPa and above 13.3 kPa (95 %)."),
        (5.0, 80.0, (False, True), "the data exclude only values below 5 kPa (95 %)."),
        (0.8, 80.0, (True, True), "the data exclude no value between 0.8 and 80 kPa."),
    ):
        assert verdict(c, 8.0, profile(low, high, *is_open), influence=True, unit="kPa").words.endswith(words)
    at_bound = verdict(c, 0.8, profile(0.8, 2.0, True, False), influence=True, unit="kPa")
    reported = "c ended on its lower bound 0.8 kPa; the data exclude only values above 2 kPa (95 %)."
    assert at_bound.words == reported


@dataclass
class Straight:
    """y = a + b x, read with a stated deviation; no simulation is needed."""

    y: np.ndarray
    deviation: float
    parameters: list = field(
        default_factory=lambda: [FitParameter(each, 40.0, 1e-3, 1e5, "log") for each in "ab"]
    )
    profiled: tuple = (0, 1)

    def __post_init__(self):
        self.design = np.column_stack([np.ones(len(self.y)), np.linspace(0, 1, len(self.y))])
        self.n_freedom = len(self.y) - 2

    def objective(self):
        return lambda theta, derivative=True: Residual(
            (self.y - self.design @ theta) / self.deviation, -self.design / self.deviation
        )

    def settle(self, theta):
        return False

    def starts(self):
        return [np.array([40.0, 40.0])]


@pytest.mark.parametrize("n", [4, 6, 12])
def test_data_that_scatter_more_than_stated_have_the_textbook_interval_of_an_unknown_noise(n, rng):
    line = Straight(np.zeros(n), 0.1)
    line.y = line.design @ (50.0, 30.0) + rng.standard_normal(n)
    found = adaptive_profiles(line, max_solves=0)
    assert found.scale > 1.0
    (a, b), *_ = np.linalg.lstsq(line.design, line.y)
    variance = np.sum((line.y - line.design @ (a, b)) ** 2) / (n - 2)
    errors = np.sqrt(variance * np.diag(np.linalg.inv(line.design.T @ line.design)))
    for name, value, error in zip("ab", (a, b), errors, strict=True):
        reach = student.ppf(0.975, n - 2) * error
        profile = found.profiles[name]
        assert (profile.low, profile.high) == pytest.approx((value - reach, value + reach), rel=5e-3)


def test_data_that_scatter_as_stated_have_the_interval_of_a_known_noise(rng):
    line = Straight(np.zeros(6), 5.0)
    line.y = line.design @ (50.0, 30.0) + rng.standard_normal(6)
    found = adaptive_profiles(line, max_solves=0)
    assert (found.scale, found.threshold) == (1.0, pytest.approx(THRESHOLD_95, rel=0.02))


@pytest.mark.parametrize(("error", "solved"), [(0.01, 0), (0.05, 2)])
def test_where_the_surrogate_is_sure_nothing_is_simulated_again(error, solved, rng):
    """The best fit and the ends are simulated where they are far from every simulation, unless it is sure."""
    line = Straight(np.zeros(6), 5.0, profiled=(0,))
    line.y = line.design @ (50.0, 30.0) + rng.standard_normal(6)
    line.within_reach, line.uncertainty = lambda theta: theta, lambda theta: error
    simulated = []
    line.distance = lambda theta: min(
        [3.0, *(float(np.abs(np.log(theta / each)).max()) for each in simulated)]
    )
    line.solve = simulated.append
    assert adaptive_profiles(line, max_solves=8).n_solves == solved


@pytest.mark.parametrize("n_freedom", [1, 2, 4, 8, 30])
@pytest.mark.parametrize("larger", [1.0, 1.5, 2.0, 4.0, 9.0, 25.0])
def test_intervals_hold_the_truth_at_their_rate_whatever_the_noise_is(n_freedom, larger):
    """Of a linear model; larger : the noise's variance over that stated. By the quantiles of chi-square."""
    chi_square = larger * chi2.ppf((np.arange(400) + 0.5) / 400, n_freedom)
    reach = [threshold_95(each, n_freedom) * noise_scale(each, n_freedom) for each in chi_square]
    held = np.mean(2 * norm.cdf(np.sqrt(np.array(reach) / larger)) - 1)
    assert 0.93 < held < 0.993


@pytest.mark.parametrize("n_freedom", [1, 2, 10])
def test_a_little_more_scatter_widens_an_interval_a_little(n_freedom):
    chi_square = n_freedom * np.linspace(0.02, 4.0, 400)
    reach = np.sqrt([threshold_95(each, n_freedom) * noise_scale(each, n_freedom) for each in chi_square])
    assert (np.diff(reach) > -1e-9).all()
    assert np.diff(reach).max() < 0.03 * reach.max()
