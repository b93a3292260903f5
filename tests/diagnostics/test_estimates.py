"""Intervals by profile, and a weak prior that moves m only where the data do not tell it."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.diagnostics.model.estimates import LN_M_DEVIATION, USUAL_M, Conditional, Reported, reported

BOUNDS = (1.0, 20.0)


def walk_on(deviance):
    def walk(m, start):
        return Conditional(deviance(np.log(m)), {"m": m, "c_kpa": 6.0}, {"c_kpa": 0.05})

    return walk


def estimates(deviance, start=5.0, scale=1.0):
    return reported(walk_on(deviance), {"m": start, "c_kpa": 6.0}, BOUNDS, scale=scale)


def test_a_well_told_m_keeps_its_value_and_its_interval():
    found = estimates(lambda x: 20 + ((x - np.log(8)) / 0.05) ** 2, start=8.0)
    assert found.values["m"] == pytest.approx(8.0, rel=0.01)
    low, high = found.intervals["m"]
    assert np.log([low / 8, high / 8]) == pytest.approx([-0.098, 0.098], abs=0.01)
    assert found.open == ()
    assert not found.is_pulled


def test_of_a_parabola_the_value_is_the_weighted_mean():
    """Two independent readings of ln m: weights 1/variance."""
    at, deviation = np.log(2.0), 0.5
    found = estimates(lambda x: ((x - at) / deviation) ** 2, start=2.0)
    weights = np.array([deviation**-2, LN_M_DEVIATION**-2])
    expected = np.exp(weights @ [at, np.log(USUAL_M)] / weights.sum())
    assert found.values["m"] == pytest.approx(expected, rel=0.03)
    assert found.is_pulled


def test_of_two_equal_minima_the_usual_one_is_told_and_both_are_in_the_interval():
    def two(x):
        return 25 + 8 * (np.sin(np.pi * (x - np.log(1.1)) / np.log(4 / 1.1))) ** 2 + 40 * max(x - 1.4, 0) ** 2

    found = estimates(two, start=1.1)
    assert found.values["m"] == pytest.approx(4.0, rel=0.15)
    low, high = found.intervals["m"]
    assert low == 1.0
    assert high > 4.0
    assert found.open == ("m below",)


def test_noise_of_unknown_level_widens_the_interval():
    def parabola(x):
        return 40 + ((x - np.log(4)) / 0.15) ** 2

    narrow, wide = estimates(parabola, start=4.0), estimates(parabola, start=4.0, scale=4.0)
    assert wide.intervals["m"][1] > 1.1 * narrow.intervals["m"][1]
    assert wide.intervals["c_kpa"][1] > narrow.intervals["c_kpa"][1]


def test_an_interval_that_ends_where_the_search_ends_is_open():
    """Fibres and c can trade places for ever: the interval of c then had 59 digits."""
    reported = Reported({}, {}, {"c_kpa": (1e-40, 1e59), "m": (1.0, 4.0)}, ("m below",))
    found = reported.within({"c_kpa": (0.4, 160.0)})
    assert found.intervals == {"c_kpa": (0.4, 160.0), "m": (1.0, 4.0)}
    assert found.open == ("m below", "c below", "c above")
    assert reported.within({"c_kpa": (0.0, 1e60)}).open == ("m below",)


@pytest.mark.parametrize("short", [0.0, 1e-6, 5e-4])
@pytest.mark.parametrize(("bound", "beyond", "is_open"), [(20.0, 25.0, "m above"), (1.0, 0.9, "m below")])
def test_an_interval_is_open_where_a_fit_ended_just_short_of_its_bound(short, bound, beyond, is_open):
    start = bound * np.exp(-short if beyond > bound else short)
    found = estimates(lambda x: 20.0 * (x - np.log(beyond)) ** 2, start=start)
    assert found.open == (is_open,)
    assert bound in found.intervals["m"]


def test_a_wider_interval_has_its_ends_as_much_farther_from_the_value():
    reported = Reported({"c_kpa": 8.0, "m": 4.0, "tilt_deg": 5.0}, {},
                    {"c_kpa": (4.0, 16.0), "m": (4.0, 19.0), "tilt_deg": (3.0, 7.0)})  # fmt: skip
    found = reported.widened(2.0)
    assert found.intervals["c_kpa"] == pytest.approx((2.0, 32.0))
    assert found.intervals["m"] == pytest.approx((4.0, 90.25))
    assert found.intervals["tilt_deg"] == (3.0, 7.0)
    assert found.within({"m": (1.0, 20.0)}).open == ("m above",)


@pytest.mark.parametrize("deviation", [0.02, 0.05, 0.2])
@pytest.mark.parametrize("correlation", [-0.5, 0.97])
def test_the_interval_of_c_is_its_own_however_m_goes_with_it(deviation, correlation):
    """ln c known to 0.03, ln m to `deviation`, together normal: at the places that are walked alone, c would
    be known up to a third too well."""
    of_c, at = 0.03, np.log(4.0)

    def walk(m, start):
        x = (np.log(m) - at) / deviation
        c = 6.0 * np.exp(correlation * of_c * x)
        return Conditional(x**2, {"m": m, "c_kpa": c}, {"c_kpa": of_c * np.sqrt(1 - correlation**2)})

    found = reported(walk, {"m": 4.0, "c_kpa": 6.0}, BOUNDS, scale=1.0)
    ends = np.log(np.array(found.intervals["c_kpa"]) / 6.0)
    assert ends == pytest.approx(np.array([-1.0, 1.0]) * 3.84**0.5 * of_c, rel=0.02)
