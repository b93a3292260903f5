"""Logarithm and exponential without branches, against numpy's."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from limbcli.materials import simd


@njit
def _of_all(function, x, out):
    for k in range(len(x)):
        out[k] = function(x[k])


@pytest.mark.parametrize("spread", [1e-12, 1e-6, 1e-2, 1.0, 30.0])
def test_logarithm(spread: float, rng: np.random.Generator) -> None:
    x = np.exp(rng.uniform(-spread, spread, 4000))
    out = np.empty_like(x)
    _of_all(simd.log, x, out)
    np.testing.assert_allclose(out, np.log(x), rtol=1e-15)
    assert simd.log(1.0) == 0.0


@pytest.mark.parametrize("spread", [1e-12, 1e-6, 1e-2, 1.0, 30.0, 600.0])
def test_exponential_less_one(spread: float, rng: np.random.Generator) -> None:
    x = rng.uniform(-spread, spread, 4000)
    out = np.empty_like(x)
    _of_all(simd.expm1, x, out)
    np.testing.assert_allclose(out, np.expm1(x), rtol=1e-15)
    assert simd.expm1(0.0) == 0.0


def test_exponents_are_cut_and_stay_finite() -> None:
    assert np.isfinite(simd.expm1(1e6))
    assert simd.expm1(-1e6) == -1.0
