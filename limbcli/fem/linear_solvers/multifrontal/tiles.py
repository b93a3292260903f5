"""Products with parts of a factor, sixteen rows by up to sixteen columns at a time.

A part is stored in chunks: sixteen rows of every column, then the next sixteen, so that it is read
sequentially. Its numbers may be 16-bit integers, with a scale per column that the caller applies: this halves
the memory of single precision, and substitution is limited by memory bandwidth.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from limbcli.fem.linear_solvers.multifrontal.vectors import _everywhere, _load, _start, _store
from limbcli.materials.simd import plus_product
from limbcli.numbers.compiled import njit

TILE = 16  # rows of a chunk, and its maximum number of columns
_INDEX = ir.IntType(32)


def _load_chunk(builder, start, at, real):  # type: ignore[no-untyped-def]
    """Load sixteen stored numbers and convert them to floating point."""
    kind = start.type.pointee
    pointer = builder.bitcast(builder.gep(start, [at]), ir.VectorType(kind, TILE).as_pointer())
    value = builder.load(pointer, align=kind.width // 8 if isinstance(kind, ir.IntType) else 4)
    if not isinstance(kind, ir.IntType):
        return value
    wide = builder.sext(value, ir.VectorType(ir.IntType(32), TILE))
    return builder.sitofp(wide, ir.VectorType(real, TILE))


def _zero(real):  # type: ignore[no-untyped-def]
    return ir.Constant(ir.VectorType(real, TILE), [0.0] * TILE)


def _rows(builder, n, body):  # type: ignore[no-untyped-def]
    """Emit a loop of body(first row, chunk number) over n chunks."""
    with cgutils.for_range(builder, n, intp=n.type) as loop:
        body(builder.mul(loop.index, ir.Constant(n.type, TILE)), loop.index)


def _down(width: int) -> Any:
    @intrinsic
    def down(typingctx, q, at, n, f, y, to):  # type: ignore[no-untyped-def]
        """y[to : to + 16 n] -= the columns of a part, each times its f[c]."""
        i = types.intp

        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            t = signature.args
            source = _start(context, builder, t[0], args[0], args[1])
            into = _start(context, builder, t[4], args[4], args[5])
            given = _start(context, builder, t[3], args[3], ir.Constant(args[1].type, 0))
            real, word = into.type.pointee, args[1].type
            given = [builder.load(builder.gep(given, [ir.Constant(word, c)])) for c in range(width)]
            factors = [_everywhere(builder, each, TILE) for each in given]

            def body(row, chunk):  # type: ignore[no-untyped-def]
                first = builder.mul(chunk, ir.Constant(word, width * TILE))
                sums = [_zero(real), _zero(real)]
                for c, factor in enumerate(factors):
                    at = builder.add(first, ir.Constant(word, c * TILE))
                    value = _load_chunk(builder, source, at, real)
                    sums[c % 2] = plus_product(builder, sums[c % 2], factor, value)
                total = builder.fsub(_load(builder, into, row, TILE), builder.fadd(*sums))
                _store(builder, total, into, row, TILE)

            _rows(builder, args[2], body)
            return context.get_dummy_value()

        return types.void(q, i, i, f, y, i), codegen

    return down


def _up(width: int) -> Any:
    @intrinsic
    def up(typingctx, q, at, n, y, to, out):  # type: ignore[no-untyped-def]
        """out[c] = dot product of column c of a part with y[to : to + 16 n]; padded with 0 to sixteen."""
        i = types.intp

        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            t = signature.args
            source = _start(context, builder, t[0], args[0], args[1])
            vector = _start(context, builder, t[3], args[3], args[4])
            into = _start(context, builder, t[5], args[5], ir.Constant(args[1].type, 0))
            real, word = vector.type.pointee, args[1].type
            sums = [cgutils.alloca_once_value(builder, _zero(real)) for _ in range(width)]
            for each in sums:
                builder.store(_zero(real), each)

            def body(row, chunk):  # type: ignore[no-untyped-def]
                first = builder.mul(chunk, ir.Constant(word, width * TILE))
                many = _load(builder, vector, row, TILE)
                for c, each in enumerate(sums):
                    at = builder.add(first, ir.Constant(word, c * TILE))
                    value = _load_chunk(builder, source, at, real)
                    builder.store(plus_product(builder, builder.load(each), value, many), each)

            _rows(builder, args[2], body)
            totals = [builder.load(each) for each in sums] + [_zero(real)] * (TILE - width)
            _store(builder, _sums(builder, totals), into, ir.Constant(word, 0), TILE)
            return context.get_dummy_value()

        return types.void(q, i, i, y, i, y), codegen

    return up


def _sums(builder, vectors):  # type: ignore[no-untyped-def]
    """The element sums of sixteen vectors, as one vector."""
    stride = 1
    while len(vectors) > 1:
        low = [lane for k in range(0, TILE, 2 * stride) for lane in _mixed(k, stride)]
        high = [lane + stride for lane in low]
        masks = [ir.Constant(ir.VectorType(_INDEX, TILE), lanes) for lanes in (low, high)]
        pairs = zip(vectors[::2], vectors[1::2], strict=True)
        vectors = [
            builder.fadd(*(builder.shuffle_vector(first, second, mask) for mask in masks))
            for first, second in pairs
        ]
        stride *= 2
    return vectors[0]


def _mixed(k: int, stride: int) -> list[int]:
    """Lanes k.. of the first vector, then those of the second."""
    return [*range(k, k + stride), *range(TILE + k, TILE + k + stride)]


@intrinsic
def times_tile(typingctx, tiles, at, x, first, out, to):  # type: ignore[no-untyped-def]
    """out[to : to + 16] = the sixteen columns at tiles[at], times x[first : first + 16]."""
    i = types.intp

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        t = signature.args
        source = _start(context, builder, t[0], args[0], args[1])
        given = _start(context, builder, t[2], args[2], args[3])
        into = _start(context, builder, t[4], args[4], args[5])
        real, word = given.type.pointee, args[1].type
        sums = [_zero(real) for _ in range(4)]
        for c in range(TILE):
            value = builder.load(builder.gep(given, [ir.Constant(word, c)]))
            column = _load(builder, source, ir.Constant(word, c * TILE), TILE)
            sums[c % 4] = plus_product(builder, sums[c % 4], _everywhere(builder, value, TILE), column)
        total = builder.fadd(builder.fadd(sums[0], sums[1]), builder.fadd(sums[2], sums[3]))
        _store(builder, total, into, ir.Constant(word, 0), TILE)
        return context.get_dummy_value()

    return types.void(tiles, i, x, i, out, i), codegen


@intrinsic
def keep_column(typingctx, q, to, stride, a, at, n, factor):  # type: ignore[no-untyped-def]
    """Store 16 n numbers of a in q's chunks, `stride` apart, times the factor and rounded if q is integer."""
    i = types.intp

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        t = signature.args
        into = _start(context, builder, t[0], args[0], args[1])
        source = _start(context, builder, t[3], args[3], args[4])
        kind = into.type.pointee
        many = _everywhere(builder, args[6], TILE)

        def body(row, chunk):  # type: ignore[no-untyped-def]
            value = builder.fmul(_load(builder, source, row, TILE), many)
            place = builder.gep(into, [builder.mul(chunk, args[2])])
            pointer = builder.bitcast(place, ir.VectorType(kind, TILE).as_pointer())
            if isinstance(kind, ir.IntType):
                whole = builder.fptosi(_rounded(builder, value), ir.VectorType(ir.IntType(32), TILE))
                builder.store(builder.trunc(whole, ir.VectorType(kind, TILE)), pointer, align=2)
            else:
                builder.store(value, pointer, align=4)

        _rows(builder, args[5], body)
        return context.get_dummy_value()

    return types.void(q, i, i, a, i, i, a.dtype), codegen


def _rounded(builder, value):  # type: ignore[no-untyped-def]
    name = f"llvm.rint.v{TILE}f{32 if isinstance(value.type.element, ir.FloatType) else 64}"
    kind = ir.FunctionType(value.type, [value.type])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), [value])


def _dispatch(make: Callable[[int], Any]) -> Any:
    four, eight, twelve, sixteen = (make(width) for width in (4, 8, 12, 16))

    @njit(cache=False)
    def run(width, q, at, n, first, second, third):  # type: ignore[no-untyped-def]
        if width == 16:
            sixteen(q, at, n, first, second, third)
        elif width == 12:
            twelve(q, at, n, first, second, third)
        elif width == 8:
            eight(q, at, n, first, second, third)
        else:
            four(q, at, n, first, second, third)

    return run


down_part, up_part = _dispatch(_down), _dispatch(_up)
