"""The same curve as scipy's, with its derivatives and its inverse."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from limbcli.inference.monotone_interpolation import Monotone, columns_through


@pytest.mark.parametrize("n", [2, 3, 7, 12])
def test_values_and_slopes_are_those_of_scipy(rng, n):
    knots = np.cumsum(0.2 + rng.random(n))
    values = rng.standard_normal(n).round(1)  # some neighbours are equal
    mine, theirs = Monotone.through(knots, values), PchipInterpolator(knots, values)
    at = np.r_[knots, np.linspace(knots[0], knots[-1], 50)]
    found = mine.read(at)
    assert found.values == pytest.approx(theirs(at), abs=1e-13)
    assert found.slopes == pytest.approx(theirs(at, 1), abs=1e-12)


@pytest.mark.parametrize("kind", ["growing", "wavy", "with flats", "two knots", "three knots"])
def test_weights_are_differences_by_the_knots_values(kind, rng):
    n = {"two knots": 2, "three knots": 3}.get(kind, 9)
    knots = np.cumsum(rng.uniform(0.2, 1.0, n))
    values = np.cumsum(rng.uniform(0.1, 1.0, n)) if kind == "growing" else rng.standard_normal(n)
    fixed = np.zeros(n, dtype=bool)
    if kind == "with flats":  # a flat piece is a kink of the curve: its own two values are left alone
        values[4], fixed[4:6] = values[5], True
    at = np.r_[knots[0], rng.uniform(knots[0], knots[-1], 30), knots[-1]]
    weights = Monotone.through(knots, values).read(at).weights
    for k in np.flatnonzero(~fixed):
        move = 1e-6 * np.eye(n)[k]
        up, down = (Monotone.through(knots, values + sign * move).read(at).values for sign in (1, -1))
        np.testing.assert_allclose(weights[:, k], (up - down) / 2e-6, atol=1e-7)


def test_inverse_finds_the_place_again(rng):
    knots, values = np.cumsum(rng.uniform(0.2, 1.0, 8)), np.cumsum(rng.uniform(0.1, 1.0, 8))
    curve, at = Monotone.through(knots, values), rng.uniform(knots[0], knots[-1], 20)
    np.testing.assert_allclose(curve.inverse(curve.read(at).values), at, atol=1e-9)
    np.testing.assert_allclose(curve.inverse(values[[0, -1]] + [-1.0, 1.0]), knots[[0, -1]], atol=1e-12)


def test_columns_go_through_what_is_known_of_each(rng):
    """Every column alone by the class, whatever is known of it; level before, its last slope beyond."""
    knots = np.cumsum(rng.uniform(0.2, 1.0, 9))
    values = rng.standard_normal((9, 40)).round(1)  # some neighbours are equal
    values[rng.random(values.shape) < 0.4] = np.nan
    values[:, 0], values[1:, 1], values[2:, 2] = rng.standard_normal(9), np.nan, np.nan
    values[:2, 2] = 1.0, 2.0
    at = np.r_[knots[0] - 1.0, knots, rng.uniform(knots[0], knots[-1], 30), knots[-1] + 0.7, np.nan]
    found = columns_through(knots, values, at)
    for c, column in enumerate(values.T):
        known = np.isfinite(column)
        if known.sum() < 2:
            assert np.isnan(found[:, c]).all()
            continue
        curve, last = Monotone.through(knots[known], column[known]), knots[known][-1]
        inside = np.clip(at[:-1], knots[known][0], last)
        expected = curve.read(inside).values + np.maximum(at[:-1] - last, 0.0) * curve.slopes[-1]
        np.testing.assert_allclose(found[:-1, c], expected, atol=1e-13)
    assert np.isnan(found[-1]).all()
    assert columns_through(knots, values, np.zeros(0)).shape == (0, 40)
