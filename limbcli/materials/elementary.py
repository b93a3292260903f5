"""Branch-free logarithm and exponential, so that loops over many numbers are vectorised.

Relative errors are below 1e-15 (tests/materials/test_elementary.py). Arguments must be finite, and
positive for the logarithm; arguments of the exponential are clipped to +-690.
"""

from __future__ import annotations

import numpy as np

from limbcli.materials.simd import bits, from_bits
from limbcli.numbers.compiled import njit

_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # ln 2 as a sum of two numbers
_PER_LN2 = 1.44269504088896338700
_HALF = np.int64(0x3FE6A09E667F3BCD)  # bits of sqrt(1/2)
_MOST = 690.0


@njit(forceinline=True)
def series_log(s):
    """2 atanh(s) / s for s^2 < 0.03: the logarithm of (1 + s) / (1 - s) over s."""
    z = s * s
    p = 1.0 / 23.0
    p = p * z + 1.0 / 21.0
    p = p * z + 1.0 / 19.0
    p = p * z + 1.0 / 17.0
    p = p * z + 1.0 / 15.0
    p = p * z + 1.0 / 13.0
    p = p * z + 1.0 / 11.0
    p = p * z + 1.0 / 9.0
    p = p * z + 1.0 / 7.0
    p = p * z + 1.0 / 5.0
    p = p * z + 1.0 / 3.0
    return 2.0 * (p * z + 1.0)


@njit(forceinline=True)
def log(x):
    """ln x."""
    shifted = bits(x) - _HALF
    n = shifted >> 52
    m = from_bits(bits(x) - (n << 52))  # between sqrt(1/2) and sqrt(2)
    s = (m - 1.0) / (m + 1.0)
    e = float(n)
    return e * _LN2_HIGH + (s * series_log(s) + e * _LN2_LOW)


@njit(forceinline=True)
def expm1(x):
    """exp(x) - 1."""
    x = min(max(x, -_MOST), _MOST)
    n = np.floor(x * _PER_LN2 + 0.5)
    r = (x - n * _LN2_HIGH) - n * _LN2_LOW
    p = 1.0 / 6227020800.0
    p = p * r + 1.0 / 479001600.0
    p = p * r + 1.0 / 39916800.0
    p = p * r + 1.0 / 3628800.0
    p = p * r + 1.0 / 362880.0
    p = p * r + 1.0 / 40320.0
    p = p * r + 1.0 / 5040.0
    p = p * r + 1.0 / 720.0
    p = p * r + 1.0 / 120.0
    p = p * r + 1.0 / 24.0
    p = p * r + 1.0 / 6.0
    p = p * r + 0.5
    below = r + r * r * p
    scale = from_bits((np.int64(n) + 1023) << 52)
    return scale * below + (scale - 1.0)
