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


@intrinsic
def add_product(typingctx, w, to, a, b):  # type: ignore[no-untyped-def]
    """Row `to` += row a times row b."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        rows = [_row(context, builder, signature.args[0], args[0], each) for each in args[1:]]
        values = [builder.load(each, align=8) for each in rows]
        builder.store(plus_product(builder, *values), rows[0], align=8)
        return context.get_dummy_value()

    i = types.intp
    return types.void(w, i, i, i), codegen


@intrinsic
def add_three(typingctx, w, to, a0, b0, a1, b1, a2, b2):  # type: ignore[no-untyped-def]
    """Row `to` = row `to` + a0 b0 + a1 b1 + a2 b2."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        rows = [_row(context, builder, signature.args[0], args[0], each) for each in args[1:]]
        values = [builder.load(each, align=8) for each in rows]
        total = values[0]
        for k in (1, 3, 5):
            total = plus_product(builder, total, values[k], values[k + 1])
        builder.store(total, rows[0], align=8)
        return context.get_dummy_value()

    i = types.intp
    return types.void(w, *[i] * 7), codegen


@intrinsic
def bits(typingctx, x):  # type: ignore[no-untyped-def]
    """The bits of a number as an integer."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.bitcast(args[0], ir.IntType(64))

    return types.int64(types.float64), codegen


@intrinsic
def from_bits(typingctx, n):  # type: ignore[no-untyped-def]
    """The number with these bits."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.bitcast(args[0], ir.DoubleType())

    return types.float64(types.int64), codegen
