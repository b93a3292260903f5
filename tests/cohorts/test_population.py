"""How sure a cohort's readings are: against drawn errors of edges, forces and slopes."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.cohorts.population import FORCE_NOISE, reading_noise, readings, slope_noise


def test_the_covariance_of_readings_is_that_of_drawn_errors(rng):
    """Skin, fat and muscle shorten by 0.4, 6 and 3 mm, told to 0.02, 0.2 and 0.05 mm. The force goes as depth
    to the power of 1.4: a depth that reads too large lowers the secant, raises what it is compared with."""
    shortened, deviation, n = np.array([0.4, 6.0, 3.0]), np.array([0.02, 0.2, 0.05]), 40_000
    reported = reading_noise(shortened[None], deviation, 0.05, np.zeros(4))[0]
    drawn = shortened + deviation * rng.standard_normal((n, 3))
    part = drawn[:, 1] / drawn[:, 1:].sum(axis=1)
    assert np.sqrt(reported[2, 2]) == pytest.approx(part.std(), rel=0.02)
    depth = 9.4 + deviation.max() * rng.standard_normal(n)
    force = 9.4**1.4 * (1 + FORCE_NOISE * rng.standard_normal(n))
    secant, compared = force / depth, depth**0.4
    assert np.sqrt(reported[0, 0]) == pytest.approx(np.log(secant / compared).std(), rel=0.02)
    assert np.sqrt(reported[1, 1]) == pytest.approx(0.05)
    assert np.array_equal(reported, np.diag(np.diag(reported)))


def test_readings_of_a_linear_slab_are_its_modulus_and_no_bend():
    """10 N on 500 mm2 shorten 20 mm by a tenth: 0.2 MPa; its slope is that of the secant."""
    shortened, slope = np.array([[0.5, 0.9, 0.6]]), np.array([10.0 / 500.0 / 2.0])
    seen = readings(np.array([10.0]), np.array([500.0]), np.array([20.0]), shortened, slope)
    assert seen == pytest.approx(np.array([[np.log(0.2), 0.0, 0.6]]))


def test_where_a_parabola_fits_no_better_the_slopes_scatter_is_its_noise(rng):
    """Rows that bend are left out, and a few that are far off do not count."""
    near = rng.random(600) < 0.5
    values = np.where(near, 0.3 + 0.08 * rng.standard_normal(600), rng.uniform(-2.0, 2.0, 600))
    values[::100], line = 30.0, np.full(600, 0.98)
    found, is_reported = slope_noise(values, line, np.where(near, 0.982, 0.995))
    assert is_reported
    assert found == pytest.approx(0.08, rel=0.15)
    assert not slope_noise(values, line, np.where(np.arange(600) < 19, 0.982, 0.995))[1]
    assert not slope_noise(values, line, None)[1]
