"""Straight lines through shear-wave speeds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import linregress

from limbcli.errors import MeasurementError
from limbcli.measurement.regression import speed_line


def test_line_agrees_with_scipy_on_random_readings(rng):
    x, y = rng.uniform(0, 26, 14), rng.normal(3, 1, 14)
    ours, theirs = speed_line(x, y, against="force"), linregress(x, y)
    assert ours.slope == pytest.approx(theirs.slope, rel=1e-12)
    assert ours.intercept == pytest.approx(theirs.intercept, rel=1e-12)
    assert ours.r2 == pytest.approx(theirs.rvalue**2, rel=1e-10)
    assert ours.slope_se == pytest.approx(theirs.stderr, rel=1e-10)


def test_levels_without_a_reading_are_left_out(rng):
    force, speed = np.arange(8.0), rng.uniform(2, 4, 8)
    gaps = speed.copy()
    gaps[[2, 5]] = np.nan
    keep = np.isfinite(gaps)
    found = speed_line(force, gaps, against="force")
    assert found == speed_line(force[keep], speed[keep], against="force")
    assert found.n == 6


def test_speeds_that_do_not_vary_have_no_r2():
    line = speed_line(np.arange(5.0), np.full(5, 2.3), against="force")
    assert line.r2 is None
    assert line.slope == 0.0


def test_two_points_give_a_line_without_a_standard_error():
    line = speed_line(np.array([0.0, 4.0]), np.array([2.0, 3.0]), against="depth")
    assert (line.slope, line.slope_se) == (0.25, None)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.inf])
def test_an_impossible_speed_is_named_with_its_level(bad):
    with pytest.raises(MeasurementError, match="level 1") as caught:
        speed_line(np.arange(3.0), np.array([2.0, bad, 3.0]), against="force")
    assert caught.value.facts["level"] == 1
    assert caught.value.fix


@pytest.mark.parametrize(("x", "y"), [([1.0], [2.0]), ([1.0, 1.0], [2.0, 3.0]), ([1.0, 2.0], [2.0, np.nan])])
def test_too_few_readings_are_refused(x, y):
    with pytest.raises(MeasurementError, match="two different positions"):
        speed_line(np.array(x), np.array(y), against="depth")
