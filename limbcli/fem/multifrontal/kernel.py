"""The innermost loop of a matrix product, in the processor's own vectors.

For processors with 512-bit vectors: 16 v by 8 numbers of the result stay in registers
while the products of k columns are added up (Goto and van de Geijn 2008, ACM Trans. Math.
Softw. 34, article 12). LLVM keeps them there; elsewhere BLAS does better.
"""

from __future__ import annotations

import llvmlite.binding as llvm
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from limbcli.fem.multifrontal.vectors import _everywhere, _load, _start, _store
from limbcli.materials.wide import plus_product

COLUMNS = 8  # of a strip of B
_BYTES = 64  # of a vector; a strip of A has as many rows as there are numbers in one


def has_wide_vectors() -> bool:
    """Whether the processor has AVX-512."""
    try:
        return bool(llvm.get_host_cpu_features().get("avx512f", False))
    except RuntimeError:
        return False


def _lanes(kind):  # type: ignore[no-untyped-def]
    return _BYTES // (4 if isinstance(kind, ir.FloatType) else 8)


@intrinsic
def pack_left(typingctx, out, to, a, at, lda, k):  # type: ignore[no-untyped-def]
    """A strip of k columns of A, one vector after the other."""
    i = types.intp

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        target = _start(context, builder, signature.args[0], args[0], args[1])
        source = _start(context, builder, signature.args[2], args[2], args[3])
        rows = _lanes(source.type.pointee)
        with cgutils.for_range(builder, args[5], intp=args[5].type) as loop:
            value = _load(builder, source, builder.mul(loop.index, args[4]), rows)
            _store(builder, value, target, builder.mul(loop.index, ir.Constant(args[5].type, rows)), rows)
        return context.get_dummy_value()

    return types.void(out, i, a, i, i, i), codegen


@intrinsic
def pack_right(typingctx, out, to, b, at, ldb, k, sign, first, factor):  # type: ignore[no-untyped-def]
    """A strip of 8 rows of B, k columns, each times its sign (from `first`) and the factor."""
    i = types.intp

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        target = _start(context, builder, signature.args[0], args[0], args[1])
        source = _start(context, builder, signature.args[2], args[2], args[3])
        signs = _start(context, builder, signature.args[6], args[6], args[7])
        with cgutils.for_range(builder, args[5], intp=args[5].type) as loop:
            value = _load(builder, source, builder.mul(loop.index, args[4]), COLUMNS)
            times = builder.fmul(args[8], builder.load(builder.gep(signs, [loop.index])))
            value = builder.fmul(value, _everywhere(builder, times, COLUMNS))
            at = builder.mul(loop.index, ir.Constant(args[5].type, COLUMNS))
            _store(builder, value, target, at, COLUMNS)
        return context.get_dummy_value()

    return types.void(out, i, b, i, i, i, sign, i, b.dtype), codegen


def _micro(strips):  # type: ignore[no-untyped-def]
    @intrinsic
    def micro(typingctx, a, oa, b, ob, k, add, c, oc, ldc):  # type: ignore[no-untyped-def]
        """C (rows, 8) = A B^T, or C += A B^T; A in strips, B in one of 8 columns."""
        i = types.intp

        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            t = signature.args
            _, _, _, _, k, add, _, _, ldc = args
            left = _start(context, builder, t[0], args[0], args[1])
            right = _start(context, builder, t[2], args[2], args[3])
            target = _start(context, builder, t[6], args[6], args[7])
            word = k.type
            kind = left.type.pointee
            rows = _lanes(kind)
            zero = ir.Constant(ir.VectorType(kind, rows), [0.0] * rows)
            sums = [[cgutils.alloca_once_value(builder, zero) for _ in range(strips)] for _ in range(COLUMNS)]
            for column in sums:
                for each in column:
                    builder.store(zero, each)
            length = builder.mul(k, ir.Constant(word, rows))
            starts = [builder.mul(length, ir.Constant(word, s)) for s in range(strips)]
            with cgutils.for_range(builder, k, intp=word) as loop:
                at = builder.mul(loop.index, ir.Constant(word, rows))
                values = [_load(builder, left, builder.add(at, s), rows) for s in starts]
                at = builder.mul(loop.index, ir.Constant(word, COLUMNS))
                for j in range(COLUMNS):
                    factor = builder.load(builder.gep(right, [builder.add(at, ir.Constant(word, j))]))
                    many = _everywhere(builder, factor, rows)
                    for s in range(strips):
                        total = plus_product(builder, builder.load(sums[j][s]), values[s], many)
                        builder.store(total, sums[j][s])
            with builder.if_else(cgutils.is_true(builder, add)) as (more, fresh):
                with more:
                    for j in range(COLUMNS):
                        column = builder.mul(ldc, ir.Constant(word, j))
                        for s in range(strips):
                            place = builder.add(column, ir.Constant(word, s * rows))
                            total = builder.fadd(
                                _load(builder, target, place, rows), builder.load(sums[j][s])
                            )
                            _store(builder, total, target, place, rows)
                with fresh:
                    for j in range(COLUMNS):
                        column = builder.mul(ldc, ir.Constant(word, j))
                        for s in range(strips):
                            place = builder.add(column, ir.Constant(word, s * rows))
                            _store(builder, builder.load(sums[j][s]), target, place, rows)
            return context.get_dummy_value()

        return types.void(a, i, b, i, i, types.boolean, c, i, i), codegen

    return micro


micro_1, micro_2, micro_3 = _micro(1), _micro(2), _micro(3)
