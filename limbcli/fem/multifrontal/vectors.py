"""Runs of numbers added and multiplied, sixteen at a time and then what is left: 8, 4, 2, 1.

For compiled loops whose runs are too short, or share too many arrays, for the compiler's
own way of taking a loop apart.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

_WIDE = 16


def _start(context, builder, array_type, array, offset):  # type: ignore[no-untyped-def]
    return builder.gep(context.make_array(array_type)(context, builder, array).data, [offset])


def _place(builder, start, at, lanes):  # type: ignore[no-untyped-def]
    kind = ir.VectorType(start.type.pointee, lanes).as_pointer()
    return builder.bitcast(builder.gep(start, [at]), kind)


def _load(builder, start, at, lanes):  # type: ignore[no-untyped-def]
    size = 4 if isinstance(start.type.pointee, ir.FloatType) else 8
    return builder.load(_place(builder, start, at, lanes), align=size)


def _store(builder, value, start, at, lanes):  # type: ignore[no-untyped-def]
    size = 4 if isinstance(start.type.pointee, ir.FloatType) else 8
    builder.store(value, _place(builder, start, at, lanes), align=size)


def _everywhere(builder, value, lanes):  # type: ignore[no-untyped-def]
    index = ir.IntType(32)
    nothing = ir.Constant(ir.VectorType(value.type, lanes), ir.Undefined)
    first = builder.insert_element(nothing, value, ir.Constant(index, 0))
    return builder.shuffle_vector(first, nothing, ir.Constant(ir.VectorType(index, lanes), [0] * lanes))


def _plus_product(builder, total, factor, value):  # type: ignore[no-untyped-def]
    product = builder.fmul(factor, value, flags=("contract",))
    return builder.fadd(total, product, flags=("contract",))


def _in_pieces(builder, n, body):  # type: ignore[no-untyped-def]
    """body(place, lanes) over range(n)."""
    word = n.type
    whole = builder.and_(n, ir.Constant(word, -_WIDE))
    step = ir.Constant(word, _WIDE)
    with cgutils.for_range_slice(builder, ir.Constant(word, 0), whole, step, intp=word) as (k, _):
        body(k, _WIDE)
    done = cgutils.alloca_once_value(builder, whole)
    lanes = _WIDE // 2
    while lanes:
        bit = ir.Constant(word, lanes)
        some = builder.icmp_unsigned("!=", builder.and_(n, bit), ir.Constant(word, 0))
        with builder.if_then(some):
            k = builder.load(done)
            body(k, lanes)
            builder.store(builder.add(k, bit), done)
        lanes //= 2


@intrinsic
def add(typingctx, target, to, source, at, n):  # type: ignore[no-untyped-def]
    """target[to : to + n] += source[at : at + n]; the two must not overlap."""
    i = types.intp

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        into = _start(context, builder, signature.args[0], args[0], args[1])
        given = _start(context, builder, signature.args[2], args[2], args[3])

        def body(k, lanes):  # type: ignore[no-untyped-def]
            total = builder.fadd(_load(builder, into, k, lanes), _load(builder, given, k, lanes))
            _store(builder, total, into, k, lanes)

        _in_pieces(builder, args[4], body)
        return context.get_dummy_value()

    return types.void(target, i, source, i, i), codegen


@intrinsic
def add_scaled(typingctx, target, to, source, at, factor, n):  # type: ignore[no-untyped-def]
    """target[to : to + n] += factor source[at : at + n]; the two must not overlap."""
    i = types.intp

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        into = _start(context, builder, signature.args[0], args[0], args[1])
        given = _start(context, builder, signature.args[2], args[2], args[3])

        def body(k, lanes):  # type: ignore[no-untyped-def]
            total = _load(builder, into, k, lanes)
            many = _everywhere(builder, args[4], lanes)
            total = _plus_product(builder, total, many, _load(builder, given, k, lanes))
            _store(builder, total, into, k, lanes)

        _in_pieces(builder, args[5], body)
        return context.get_dummy_value()

    return types.void(target, i, source, i, source.dtype, i), codegen


@intrinsic
def add_columns(typingctx, y, to, a, at, ld, f0, f1, f2, f3, n):  # type: ignore[no-untyped-def]
    """y[to : to + n] += four columns of a (from `at`, `ld` apart) times f0, f1, f2, f3.

    The next four are asked for meanwhile.
    """
    i, real = types.intp, a.dtype

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        into = _start(context, builder, signature.args[0], args[0], args[1])
        columns = _columns(context, builder, signature.args[2], *args[2:5])
        ahead = builder.mul(args[4], ir.Constant(args[4].type, 8))

        def body(k, lanes):  # type: ignore[no-untyped-def]
            total = _load(builder, into, k, lanes)
            for column, factor in zip(columns, args[5:9], strict=True):
                if lanes == _WIDE:
                    _fetch(builder, column, builder.add(k, ahead))
                many = _everywhere(builder, factor, lanes)
                total = _plus_product(builder, total, many, _load(builder, column, k, lanes))
            _store(builder, total, into, k, lanes)

        _in_pieces(builder, args[9], body)
        return context.get_dummy_value()

    return types.void(y, i, a, i, i, real, real, real, real, i), codegen


@intrinsic
def dot_columns(typingctx, y, at_y, a, at, ld, n):  # type: ignore[no-untyped-def]
    """Products of y[at_y : at_y + n] with four columns of a (from `at`, `ld` apart).

    The four before are asked for meanwhile.
    """
    i = types.intp
    result = types.UniTuple(a.dtype, 4)

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        vector = _start(context, builder, signature.args[0], args[0], args[1])
        columns = _columns(context, builder, signature.args[2], *args[2:5])
        kind = vector.type.pointee
        ahead = builder.mul(args[4], ir.Constant(args[4].type, -8))
        wide = [_zeros(builder, kind, _WIDE) for _ in columns]
        rest = [_zeros(builder, kind, 1) for _ in columns]

        def body(k, lanes):  # type: ignore[no-untyped-def]
            value = _load(builder, vector, k, lanes)
            for column, sums, more in zip(columns, wide, rest, strict=True):
                other = _load(builder, column, k, lanes)
                if lanes == _WIDE:
                    _fetch(builder, column, builder.add(k, ahead))
                    builder.store(_plus_product(builder, builder.load(sums), other, value), sums)
                else:
                    part = _across(builder, builder.fmul(other, value), lanes)
                    builder.store(builder.fadd(builder.load(more), part), more)

        _in_pieces(builder, args[5], body)
        totals = [
            builder.extract_element(
                builder.fadd(builder.load(more), _across(builder, builder.load(sums), _WIDE)),
                ir.Constant(ir.IntType(32), 0),
            )
            for sums, more in zip(wide, rest, strict=True)
        ]
        return context.make_tuple(builder, signature.return_type, totals)

    return result(y, i, a, i, i, i), codegen


def _fetch(builder, start, at):  # type: ignore[no-untyped-def]
    """Ask for what will be read soon."""
    word = ir.IntType(32)
    pointer = ir.IntType(8).as_pointer()
    kind = ir.FunctionType(ir.VoidType(), [pointer, word, word, word])
    function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
    where = builder.bitcast(builder.gep(start, [at]), pointer)
    builder.call(function, [where, *(ir.Constant(word, each) for each in (0, 3, 1))])


def _columns(context, builder, array_type, array, at, ld):  # type: ignore[no-untyped-def]
    first = _start(context, builder, array_type, array, at)
    return [builder.gep(first, [builder.mul(ld, ir.Constant(ld.type, c))]) for c in range(4)]


def _zeros(builder, kind, lanes):  # type: ignore[no-untyped-def]
    several = ir.VectorType(kind, lanes)
    return cgutils.alloca_once_value(builder, ir.Constant(several, [0.0] * lanes))


def _across(builder, value, lanes):  # type: ignore[no-untyped-def]
    """The sum of a vector's numbers, as a vector of one."""
    index = ir.IntType(32)
    while lanes > 1:
        lanes //= 2
        low = ir.Constant(ir.VectorType(index, lanes), list(range(lanes)))
        high = ir.Constant(ir.VectorType(index, lanes), list(range(lanes, 2 * lanes)))
        value = builder.fadd(
            builder.shuffle_vector(value, value, low), builder.shuffle_vector(value, value, high)
        )
    return value
