"""The same curve as scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from limbcli.effects.monotone import Monotone


@pytest.mark.parametrize("shape", [(7,), (7, 3), (2,), (3, 2)])
def test_values_and_slopes_are_those_of_scipy(rng, shape):
    knots = np.cumsum(0.2 + rng.random(shape[0]))
    values = rng.standard_normal(shape).round(1)  # some neighbours are equal
    mine, theirs = Monotone.through(knots, values), PchipInterpolator(knots, values)
    at = np.r_[knots, np.linspace(knots[0], knots[-1], 50)]
    assert mine(at) == pytest.approx(theirs(at), abs=1e-13)
    assert mine.slope(at) == pytest.approx(theirs(at, 1), abs=1e-12)
    assert mine(float(knots[1])) == pytest.approx(values[1], abs=1e-14)
