"""Sixteen integration points at a time: rows of sixteen numbers of a flat array, their products and sums.

Row r of w is w[16 r : 16 r + 16]; what it holds has a name here. For compiled loops that the compiler does
not vectorise because it cannot prove that the rows do not overlap.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from limbcli.numbers.compiled import njit

LANES = 16
_SIZES = {
    "F": 9, "J": 1, "C": 6, "D": 6, "S": 6, "CC": 21,  # the tangent: its upper triangle, row by row
    "ALPHA": 1, "BETA": 1, "X": 6, "PLUS": 1, "MINUS": 1, "KAPPA": 1,
    "SQUARES": 3, "LOGS": 3, "VECTORS": 9, "TAU": 3, "SLOPES": 3, "QUOTIENTS": 3, "P": 18, "H": 6,
    "WEIGHT": 1, "SHIFT": 1, "STRESS": 9, "TANGENT": 54, "PRODUCTS": 54,  # of the element loops
}  # fmt: skip
N_ROWS = sum(_SIZES.values())
_FIRST = {name: sum(list(_SIZES.values())[:k]) for k, name in enumerate(_SIZES)}
F, J, C, D, S, CC = (_FIRST[name] for name in ("F", "J", "C", "D", "S", "CC"))
ALPHA, BETA, X, PLUS, MINUS, KAPPA = (_FIRST[n] for n in ("ALPHA", "BETA", "X", "PLUS", "MINUS", "KAPPA"))
SQUARES, LOGS, VECTORS, TAU = (_FIRST[name] for name in ("SQUARES", "LOGS", "VECTORS", "TAU"))
SLOPES, QUOTIENTS, P, H = (_FIRST[name] for name in ("SLOPES", "QUOTIENTS", "P", "H"))
WEIGHT, SHIFT, STRESS = (_FIRST[name] for name in ("WEIGHT", "SHIFT", "STRESS"))
TANGENT, PRODUCTS = _FIRST["TANGENT"], _FIRST["PRODUCTS"]

UPPER = np.zeros((6, 6), dtype=np.int64)  # index of tangent entry (p, q) in the upper triangle
UPPER[np.triu_indices(6)] = np.arange(21)
UPPER += np.triu(UPPER, 1).T


def _row(context, builder, array_type, array, row):  # type: ignore[no-untyped-def]
    data = context.make_array(array_type)(context, builder, array).data
    at = builder.mul(row, ir.Constant(row.type, LANES))
    return builder.bitcast(builder.gep(data, [at]), ir.VectorType(ir.DoubleType(), LANES).as_pointer())


def plus_product(builder, total, first, second):  # type: ignore[no-untyped-def]
    """total + first times second, as a fused multiply-add where the processor has it."""
    return builder.fadd(total, builder.fmul(first, second, flags=("contract",)), flags=("contract",))


def _add_products(context, builder, signature, args):  # type: ignore[no-untyped-def]
    rows = [_row(context, builder, signature.args[0], args[0], each) for each in args[1:]]
    total, *factors = (builder.load(each, align=8) for each in rows)
    for first, second in zip(factors[::2], factors[1::2], strict=True):
        total = plus_product(builder, total, first, second)
    builder.store(total, rows[0], align=8)
    return context.get_dummy_value()


@intrinsic
def add_product(typingctx, w, to, a, b):  # type: ignore[no-untyped-def]
    """Row `to` += row a times row b."""
    return types.void(w, *[types.intp] * 3), _add_products


@intrinsic
def add_three(typingctx, w, to, a0, b0, a1, b1, a2, b2):  # type: ignore[no-untyped-def]
    """Row `to` = row `to` + a0 b0 + a1 b1 + a2 b2."""
    return types.void(w, *[types.intp] * 7), _add_products


def _recast(kind):  # type: ignore[no-untyped-def]
    return lambda context, builder, signature, args: builder.bitcast(args[0], kind)


@intrinsic
def bits(typingctx, x):  # type: ignore[no-untyped-def]
    """The bits of a number as an integer."""
    return types.int64(types.float64), _recast(ir.IntType(64))


@intrinsic
def from_bits(typingctx, n):  # type: ignore[no-untyped-def]
    """The number with these bits."""
    return types.float64(types.int64), _recast(ir.DoubleType())


@njit
def simd_workspace():
    """The rows, and the arrays F, S and CC of a single point for laws evaluated point by point."""
    return np.zeros(N_ROWS * LANES), np.empty((3, 3)), np.empty(6), np.empty((6, 6))


# Branch-free logarithm and exponential: relative errors are below 1e-15 (tests/materials/test_elementary.py).
# Arguments must be finite, positive for the logarithm; those of the exponential are clipped to +-690.
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
