"""Values and intervals of c, m and sizes, averaged over explanations by their probability."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from limbcli.diagnosis.explanations.estimates import LN_M_DEVIATION, USUAL_M, estimates, sizes_95
from limbcli.diagnosis.explanations.forward_model import Direction, Fitted, Prior, Priors
from limbcli.diagnosis.explanations.laplace import Posterior, posterior
from limbcli.diagnosis.explanations.linear_evidence import LinearEvidence
from limbcli.diagnosis.explanations.noise import Noise, independent
from limbcli.diagnosis.forward_model.predictions import Slot
from limbcli.diagnosis.written_result import reported_sizes
from limbcli.effects import EFFECTS
from limbcli.numbers.whitening import Whitener
from tests.diagnosis import toy

LN_C, LN_M = Prior.uniform(*np.log([0.3, 120.0])), Prior(np.log(USUAL_M), LN_M_DEVIATION, 0.0, np.log(20.0))
Z = stats.norm.ppf(0.975)
KNOWN = {each.name: each for each in EFFECTS if each.kind != "numerical"}
SLOTS = {name: [Slot(p.name, p) for p in each.sizes] for name, each in KNOWN.items()}


def found(c: float, m: float, deviations, sizes=(), step=0.0, size_prior: Prior | None = None) -> Posterior:
    """A posterior about a fit; sizes : values of effects a, b, ..."""
    names = tuple("abc"[: len(sizes)])
    at = np.array([np.log(c), np.log(m), *sizes])
    priors = Priors.about(at, (LN_C, LN_M, *[size_prior or Prior(0.0, 9.0)] * len(sizes)))
    values = {"c_kpa": c, "m": m, **dict(zip(names, sizes, strict=True))}
    fitted = Fitted(names, np.zeros(1), np.zeros((1, len(at))), ("c", "m"), values, names, priors=priors)
    return Posterior(fitted, 0.0, np.full(len(at), step), np.diag(np.square(deviations)), 0.0, {})


def test_of_one_explanation_they_are_those_of_its_posterior():
    told = estimates([(1.0, found(8.0, 4.0, [0.1, 0.2]))])
    assert (told.values["c_kpa"], told.values["m"]) == (
        pytest.approx(8.0, rel=1e-3),
        pytest.approx(4.0, rel=1e-3),
    )
    of_c, of_m = np.hypot(0.1, 0.05), np.hypot(0.2, 0.12)  # and the models' own error
    assert told.intervals["c_kpa"] == pytest.approx(8.0 * np.exp(of_c * np.array([-Z, Z])), rel=1e-3)
    assert told.intervals["m"] == pytest.approx(4.0 * np.exp(of_m * np.array([-Z, Z])), rel=1e-3)
    assert (told.open, told.over) == ({"c_kpa": (False, False), "m": (False, False)}, 1)
    blind = estimates([(1.0, found(8.0, 4.0, [0.1, 0.2]))], imaged=False)
    assert blind.intervals["c_kpa"] == told.intervals["c_kpa"]
    of_m = np.hypot(0.2, 0.35)
    assert blind.intervals["m"] == pytest.approx(4.0 * np.exp(of_m * np.array([-Z, Z])), rel=1e-2)
    moved = estimates([(1.0, found(8.0, 4.0, [0.1, 0.2], step=0.05))])
    assert moved.values["c_kpa"] == pytest.approx(8.0 * np.exp(0.05), rel=1e-3)


def test_over_several_they_are_quantiles_of_the_mixture():
    """Nine in ten at 8 kPa: the tenth at 16 is in the interval, and hardly moves the value."""
    told = estimates([(0.9, found(8.0, 4.0, [0.02, 0.1, 0.5], [2.0])), (0.1, found(16.0, 4.0, [0.02, 0.1]))])
    assert told.values["c_kpa"] == pytest.approx(8.0, rel=0.02)
    low, high = told.intervals["c_kpa"]
    of_c = np.hypot(0.02, 0.05)  # and the models' own error
    assert high == pytest.approx(16.0 * np.exp(of_c * stats.norm.ppf(0.75)), rel=2e-3)  # a quarter above
    assert low == pytest.approx(8.0 * np.exp(of_c * stats.norm.ppf(0.025 / 0.9)), rel=2e-3)
    assert told.over == 2


def test_a_size_is_averaged_over_the_explanations_that_have_it():
    several = [(0.6, found(8.0, 4.0, [0.1, 0.1, 0.5], [2.0])), (0.4, found(8.0, 4.0, [0.1, 0.1]))]
    told = estimates(several)
    assert told.values["a"] == pytest.approx(2.0, abs=0.01)
    assert told.intervals["a"] == pytest.approx((2.0 - 0.5 * Z, 2.0 + 0.5 * Z), abs=0.01)
    half = found(8.0, 4.0, [0.1, 0.1, 1.0], [0.0], size_prior=Prior(0.0, 9.0, 0.0))
    low, high = estimates([(1.0, half)]).intervals["a"]
    assert low == 0.0  # nothing is as probable as no effect
    assert high == pytest.approx(stats.halfnorm.ppf(0.95), abs=0.01)


@pytest.mark.parametrize(
    ("m", "deviation", "is_open"),
    [
        (1.2, 0.3, (True, False)),
        (16.0, 0.4, (False, True)),
        (4.0, 0.3, (False, False)),
        (4.0, 3.0, (True, True)),
    ],
)
def test_an_interval_is_open_where_it_reaches_the_limit_of_the_search(m, deviation, is_open):
    told = estimates([(1.0, found(8.0, m, [0.1, deviation]))])
    assert told.open["m"] == is_open
    low, high = told.intervals["m"]
    assert 1.0 <= low <= told.values["m"] <= high <= 20.0
    assert is_open[0] is (low == pytest.approx(1.0))


def test_of_m_a_poor_reading_is_weighed_with_its_prior():
    """Two independent readings of ln m, the prior one of them: the mean is weighted by reciprocal
    variances."""
    at, deviation = np.log(2.0), 0.5
    noise = Noise((independent("own", np.array([deviation]), source="spec"),))
    weights = np.array([deviation**-2, LN_M_DEVIATION**-2])
    expected = weights @ [at, LN_M.mean] / weights.sum()
    J = np.array([[0.0, 1.0]])
    start = np.array([np.log(8.0), expected])
    values = {"c_kpa": 8.0, "m": float(np.exp(expected))}
    fitted = Fitted((), start[1:], J, ("c", "m"), values, priors=Priors.about(start, (LN_C, LN_M)))
    told = estimates([(1.0, posterior(fitted, np.array([at]), noise))])
    assert told.values["m"] == pytest.approx(np.exp(expected), rel=0.03)  # the limit at 1 cuts a little
    assert told.open["c_kpa"][0]


def test_the_interval_of_a_size_alone_is_over_its_grid(rng):
    """Of an effect whose place is one of three, without a fit: a mixture over places by their evidence."""
    n, columns = 30, 2.0 * np.linalg.qr(rng.standard_normal((30, 3)))[0]
    y = 0.8 * columns[:, 1] + 0.8 * columns[:, 2] + 0.3 * rng.standard_normal(n)
    noise, prior = Noise((independent("own", np.ones(n), source="spec"),)), Prior(1.0, 4.0)
    directions = {
        "a": [Direction(each[:, None], {"size": prior}, f"at {k}") for k, each in enumerate(columns.T)]
    }
    fitted = Fitted((), np.zeros(n), np.zeros((n, 0)), (), {})
    linear = LinearEvidence.about(fitted, y, Whitener.of(noise.covariance), directions)
    told = sizes_95({}, linear)
    assert set(told) == {"a"}
    precision = 4.0 + 1 / 16
    mean, weight = columns.T @ y / precision, np.exp(0.5 * (columns.T @ y) ** 2 / precision)
    drawn = rng.choice(mean, 200_000, p=weight / weight.sum()) + rng.standard_normal(200_000) / precision**0.5
    low, high = told["a"]["size"]
    assert np.mean((1.0 + drawn > low) & (1.0 + drawn < high)) == pytest.approx(0.95, abs=0.003)
    assert high - low <= np.ptp(np.quantile(drawn, [0.025, 0.975])) + 0.02  # the shortest there is


@pytest.mark.slow
@pytest.mark.parametrize("times", [1.0, 3.0])
def test_sizes_are_as_wide_as_the_data_scatter(times):
    """Where they scatter more than their stated noise, sizes that are 0 are still inside at their rate."""
    from limbcli.diagnosis.explanations.verdict import diagnose

    rng, inside = np.random.default_rng(5), []
    for seed in range(16):
        result = diagnose(toy.make(rng, sd=times), seed=seed, propose=False, max_effects=1)
        assert result.relative is (times > 1.0)
        for name in ("offset", "bias", "hump", "wave"):
            low, high = result.sizes[name][name]
            inside.append(low <= 0.0 <= high)
    assert np.mean(inside) >= 0.87  # 0.95 less three deviations of 64; unscaled 0.46


def test_sizes_are_reported_by_their_usual_names_and_units():
    given = {
        "swe-guided-wave": {"guided_1e4_per_hz2": (0.1, 0.4)},
        "inclusion": {"log_inclusion_ratio": (-0.5, 1.0)},
        "contraction": {"active_stress_per_c": (0.1, 0.3)},
        "adipose-layer": {"log_fat_softness": (0.5, 1.2)},
        "friction": {"friction_coefficient": (0.1, 0.5)},
    }
    told = reported_sizes(SLOTS, given, 8.0)
    assert told["swe-guided-wave"]["f_c_hz"] == pytest.approx((100 / 0.4**0.5, 100 / 0.1**0.5))
    assert told["inclusion"]["stiffness_ratio"] == pytest.approx((np.exp(-0.5), np.e))
    assert told["contraction"]["t0_kpa"] == pytest.approx((0.8, 2.4))
    assert told["adipose-layer"]["stiffness_ratio"] == pytest.approx((np.exp(-1.2), np.exp(-0.5)))
    assert told["friction"]["coefficient"] == pytest.approx((0.1, 0.5))


def test_what_the_data_leave_open_has_no_end():
    depth_zero = next(p for p in KNOWN["depth-zero"].parameters if p.name == "depth_zero_mm")
    told = reported_sizes(SLOTS, {"depth-zero": {"depth_zero_mm": (depth_zero.low, 1.0)}}, 8.0)
    assert told["depth-zero"]["d0_mm"] == (None, 1.0)
    assert told["tilt"]["about_long_axis_deg"] == (None, None)
    assert told["friction"]["coefficient"] == (0.0, None)  # it cannot be less than none
    assert told["swe-guided-wave"]["f_c_hz"][1] is None  # no guided wave: an infinite cut-off
