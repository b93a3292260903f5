"""Intervals of effects' sizes: to first order, and in the words in which they are told."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.diagnostics.conclusions.effect_sizes import RefittedSizes, refitted_sizes, sizes_95
from limbcli.diagnostics.engine import diagnose
from limbcli.diagnostics.model.forward_model import Direction, Facts, Fitted
from limbcli.diagnostics.model.linear import LinearFit
from limbcli.diagnostics.model.noise import ErrorDraws
from limbcli.diagnostics.statistical_tests.multiple_testing import score_family
from limbcli.diagnostics.statistical_tests.score import Trial
from limbcli.effects import EFFECTS
from limbcli.stages.diagnosis.forward_model.fit_parameters import Slot
from limbcli.stages.diagnosis.sizes import reported_sizes
from tests.diagnostics import toy

KNOWN = {each.name: each for each in EFFECTS if each.kind != "numerical"}
SLOTS = {name: [Slot(p.name, p) for p in each.sizes] for name, each in KNOWN.items()}


def found(size: float, deviation: float = 1.0):
    """The interval of one effect, size hidden in it, beside a constant that is fitted."""
    n = 40
    t = np.linspace(-1.0, 1.0, n)
    rng = np.random.default_rng(3)
    residual = size * t + deviation * rng.standard_normal(n)
    state = LinearFit.of(residual / deviation, np.ones((n, 1)))
    trial = Trial("force-zero", (Direction(t[:, None] / deviation, (0,), names=("force_zero_n",)),))
    family = score_family(state, [trial], ErrorDraws((3,), n, 200))
    known = {"force-zero": Facts("force-zero", "", "measurement")}
    return sizes_95(state, family, known, {"force-zero": trial})["force-zero"]["force_zero_n"], t


@pytest.mark.parametrize("size", [0.0, 2.0])
def test_the_interval_is_that_of_least_squares(size):
    (low, high), t = found(size)
    assert high - low == pytest.approx(2 * 1.96 / np.sqrt(np.sum((t - t.mean()) ** 2)), rel=1e-6)
    assert low < size < high


def test_where_the_noise_is_as_stated_the_data_do_not_widen_it():
    """Data scatter by a tenth more than stated, which may be chance: intervals are the stated noise's."""
    case = toy.make(np.random.default_rng(3), sd=1.15)
    found = diagnose(case, seed=7, n_draws=300, propose=False, max_effects=1)
    assert not found.relative
    assert found.shrink[0].chi2_per_nu > 1.1
    inverse = np.linalg.inv(case.data.noise.covariance)
    for name in ("offset", "bias", "hump", "wave"):
        columns = np.column_stack([toy.BASE, toy.SIGNATURES[name][0][1]])
        deviation = np.sqrt(np.linalg.inv(columns.T @ inverse @ columns)[-1, -1])
        assert np.ptp(found.sizes[name][name]) == pytest.approx(2 * 1.96 * deviation, rel=1e-3)


N_PLACES, N_DATA = 20, 60
BALLS = np.linalg.qr(np.random.default_rng(1).standard_normal((N_DATA, N_PLACES)))[0] * 5.0


def of_places(residual, columns=BALLS, **more):
    """The interval of an effect whose place is one of many, each with a column (n, n_places)."""
    places = tuple(
        Direction(each[:, None], (0,), f"at {k}", ("ln_ratio",)) for k, each in enumerate(columns.T)
    )
    trial = Trial("inclusion", places)
    state = LinearFit.of(residual, np.ones((N_DATA, 1)))
    family = score_family(state, [trial], ErrorDraws((3,), N_DATA, 500))
    known = {"inclusion": Facts("inclusion", "", "tissue", {"ln_ratio": 1.0})}
    return sizes_95(state, family, known, {"inclusion": trial}, **more)["inclusion"]["ln_ratio"]


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.0, 0.4, 2.0])
def test_where_the_place_is_not_known_the_size_is_inside_at_its_rate(rng, size):
    """Of the place that happens to explain most, the interval alone holds nothing there 4 times of 10."""
    inside = []
    for _ in range(80):
        low, high = of_places(size * BALLS[:, 3] + rng.standard_normal(N_DATA))
        inside.append(low <= size <= high)
    assert np.mean(inside) >= 0.87  # 0.95 less three deviations


def test_a_place_where_no_plausible_size_shows_leaves_nothing_open(rng):
    columns, residual = BALLS.copy(), rng.standard_normal(N_DATA)
    columns[:, 7:] *= 1e-3  # deviations of 200
    low, high = of_places(residual, columns)
    assert -1.0 < low < high < 1.0
    assert of_places(residual, 1e-3 * BALLS)[1] > 100.0


def test_sizes_are_widened_as_intervals_of_the_tissue_are(rng):
    residual = rng.standard_normal(N_DATA)
    (low, high), wider = (of_places(residual, BALLS[:, :1], widening=w) for w in (1.0, 1.35))
    assert np.ptp(wider) == pytest.approx(1.35 * (high - low))


def test_sizes_are_told_by_their_usual_names_and_units():
    given = {
        "swe-guided-wave": {"guided_1e4_per_hz2": (0.1, 0.4)},
        "inclusion": {"log_inclusion_ratio": (-0.5, 1.0)},
        "contraction": {"active_stress_per_c": (-0.1, 0.3)},
        "adipose-layer": {"log_fat_softness": (0.5, 1.2)},
    }
    estimates = reported_sizes(SLOTS, given, 8.0)
    assert estimates["swe-guided-wave"]["f_c_hz"] == pytest.approx((100 / 0.4**0.5, 100 / 0.1**0.5))
    assert estimates["inclusion"]["stiffness_ratio"] == pytest.approx((np.exp(-0.5), np.e))
    assert estimates["contraction"]["t0_kpa"] == pytest.approx((0.0, 2.4))
    assert estimates["adipose-layer"]["stiffness_ratio"] == pytest.approx((np.exp(-1.2), np.exp(-0.5)))


def test_what_the_data_leave_open_has_no_end():
    estimates = reported_sizes(SLOTS, {"depth-zero": {"depth_zero_mm": (-9.0, 1.0)}}, 8.0)
    assert estimates["depth-zero"]["d0_mm"] == (None, 1.0)
    assert estimates["tilt"]["about_long_axis_deg"] == (None, None)
    assert estimates["friction"]["coefficient"] == (0.0, None)
    assert estimates["swe-guided-wave"]["f_c_hz"][1] is None


def test_where_an_effect_levels_off_its_interval_grows():
    """Friction of 0.5 changes hardly more than 0.3; to first order both look like 0.15."""
    mu = next(p for p in KNOWN["friction"].parameters)
    for value in (0.02, 0.2, 0.9):
        assert mu.from_proportional(mu.proportional(value)) == pytest.approx(value)
    ends = tuple(mu.proportional(each) for each in (0.1, 0.5))
    estimates = reported_sizes(SLOTS, {"friction": {"friction_coefficient": ends}}, 8.0)
    assert estimates["friction"]["coefficient"] == pytest.approx((0.1, 0.5))
    assert ends[1] < 0.2
    open_above = {"friction": {"friction_coefficient": (-0.05, 0.3)}}
    assert reported_sizes(SLOTS, open_above, 8.0)["friction"]["coefficient"] == (0.0, None)


def test_of_a_refit_the_interval_is_that_of_least_squares_there(rng):
    """c and m beside it, of which m stood on its bound; what the data do not tell has no end."""
    jacobian = np.column_stack([rng.standard_normal((30, 2)), np.zeros(30)])
    values = {"c_kpa": 7.0, "m": 20.0, "tilt_about_short_axis_deg": 6.0, "tilt_about_long_axis_deg": 0.5}
    fitted = Fitted(("tilt",), np.zeros(30), jacobian, ("c",), values, tuple(values)[2:])
    found = refitted_sizes(fitted, jacobian, 4.0, np.zeros((30, 30)))
    deviation = 2.0 * np.sqrt(np.linalg.inv(jacobian[:, :2].T @ jacobian[:, :2])[1, 1])
    low, high = found.intervals["tilt_about_short_axis_deg"]
    assert (low, high) == pytest.approx((6.0 - 1.96 * deviation, 6.0 + 1.96 * deviation))
    assert found.intervals["tilt_about_long_axis_deg"] == (-np.inf, np.inf)
    reported = reported_sizes(SLOTS, {}, 8.0, {"tilt": found})["tilt"]
    assert reported["about_short_axis_deg"] == pytest.approx((low, high))
    assert reported["about_long_axis_deg"] == (None, None)


def test_an_error_of_the_form_widens_what_a_refit_tells_by_its_own_size(rng):
    """By a fifth of the effect, alike in all data: a fifth of its size."""
    column = rng.standard_normal(30)
    values = {"c_kpa": 7.0, "m": 4.0, "log_inclusion_ratio": 1.2}
    fitted = Fitted(("inclusion",), np.zeros(30), column[:, None], (), values, ("log_inclusion_ratio",))
    change = 0.2 * 1.2 * column
    found = refitted_sizes(fitted, column[:, None], 1.0, np.outer(change, change))
    low, high = found.intervals["log_inclusion_ratio"]
    assert 0.5 * (low + high) == pytest.approx(1.2)
    assert high - low == pytest.approx(2 * 1.96 * np.hypot(1 / np.linalg.norm(column), 0.2 * 1.2))
    doubted = refitted_sizes(fitted, column[:, None], 1.0, np.outer(change, change), 1.5)
    assert np.ptp(doubted.intervals["log_inclusion_ratio"]) == pytest.approx(1.5 * (high - low))


def test_what_a_refit_tells_holds_a_profile_of_the_same_parameters_too():
    sizes = RefittedSizes({"c_kpa": 9.0}, {"force_zero_n": (0.2, 0.6), "weight_q": (0.1, 0.2)})
    found = sizes.hull_with({"force_zero_n": (0.3, 0.9), "m": (2.0, 5.0)})
    assert found.intervals == {"force_zero_n": (0.2, 0.9), "weight_q": (0.1, 0.2)}
    assert found.values == sizes.values


def test_what_is_told_holds_the_first_order_and_the_refit_with_its_own_c():
    first = {
        "inclusion": {"log_inclusion_ratio": (0.8, 0.9)},
        "contraction": {"active_stress_per_c": (0.1, 0.3)},
    }
    again = {"contraction": RefittedSizes({"c_kpa": 10.0}, {"active_stress_per_c": (0.2, 0.4)})}
    reported = reported_sizes(SLOTS, first, 8.0, again)
    assert reported["contraction"]["t0_kpa"] == pytest.approx((1.0, 4.0))
    assert reported["inclusion"]["stiffness_ratio"] == pytest.approx((np.exp(0.8), np.exp(0.9)))


@pytest.mark.slow
@pytest.mark.parametrize("times", [1.0, 3.0])
def test_sizes_are_as_wide_as_the_data_scatter(times):
    """Where they scatter more than their stated noise, sizes that are 0 are still inside at their rate."""
    rng, inside = np.random.default_rng(5), []
    for seed in range(16):
        found = diagnose(toy.make(rng, sd=times), seed=seed, n_draws=300, propose=False, max_effects=1)
        assert found.relative is (times > 1.0)
        for name in ("offset", "bias", "hump", "wave"):
            low, high = found.sizes[name][name]
            inside.append(low <= 0.0 <= high)
    assert np.mean(inside) >= 0.87  # 0.95 less three deviations of 64; unscaled 0.46
