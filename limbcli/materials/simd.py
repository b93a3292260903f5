"""Vector operations on rows of sixteen numbers of a flat array: products and sums.

Row r of w is w[16 r : 16 r + 16]. For compiled loops that the compiler does not vectorise because it cannot
prove that the rows do not overlap.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

LANES = 16


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
