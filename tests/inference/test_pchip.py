"""PCHIP sampling: scipy's twin, and its exact derivative."""

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from limbcli.errors import FitError
from limbcli.inference.monotone_interpolation import pchip_sample


@pytest.mark.parametrize("shape", ["monotone", "wavy", "two knots", "three knots"])
def test_values_and_slopes_equal_scipy(shape, rng):
    n = {"two knots": 2, "three knots": 3}.get(shape, 12)
    knots = np.cumsum(rng.uniform(0.2, 1.0, n))
    values = np.cumsum(rng.uniform(0.0, 1.0, n)) if shape == "monotone" else rng.standard_normal(n)
    places = rng.uniform(knots[0], knots[-1], 50)
    sample, twin = pchip_sample(knots, values, places), PchipInterpolator(knots, values)
    np.testing.assert_allclose(sample.values, twin(places), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(sample.slopes, twin(places, 1), rtol=1e-9, atol=1e-10)


def test_a_knot_is_reproduced_exactly(rng):
    knots = np.arange(5.0)
    values = rng.standard_normal(5)
    assert np.array_equal(pchip_sample(knots, values, knots).values, values)


def test_a_depth_beyond_the_simulation_is_an_error_with_its_fix():
    with pytest.raises(FitError, match="build-feb"):
        pchip_sample(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.array([1.2]))
    with pytest.raises(FitError, match="do not increase"):
        pchip_sample(np.array([0.0, 0.0]), np.array([0.0, 1.0]), np.array([0.0]))
