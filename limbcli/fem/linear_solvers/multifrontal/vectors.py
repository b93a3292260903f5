"""Vectorised addition and scaling of short runs: sixteen numbers at a time, the remainder in 8, 4, 2, 1.

For compiled loops that the compiler does not vectorise well, because runs are short or arrays may alias.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from limbcli.materials.simd import plus_product

_WIDE = 16


def _start(context, builder, array_type, array, offset):  # type: ignore[no-untyped-def]
    if isinstance(array_type, types.CPointer):
        return builder.gep(array, [offset])
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


def _adding(scaled):  # type: ignore[no-untyped-def]
    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        into = _start(context, builder, signature.args[0], args[0], args[1])
        given = _start(context, builder, signature.args[2], args[2], args[3])

        def body(k, lanes):  # type: ignore[no-untyped-def]
            total, more = (_load(builder, each, k, lanes) for each in (into, given))
            if scaled:
                total = plus_product(builder, total, _everywhere(builder, args[4], lanes), more)
            else:
                total = builder.fadd(total, more)
            _store(builder, total, into, k, lanes)

        _in_pieces(builder, args[-1], body)
        return context.get_dummy_value()

    return codegen


@intrinsic
def add(typingctx, target, to, source, at, n):  # type: ignore[no-untyped-def]
    """target[to : to + n] += source[at : at + n]; the two must not overlap."""
    i = types.intp
    return types.void(target, i, source, i, i), _adding(scaled=False)


@intrinsic
def add_scaled(typingctx, target, to, source, at, factor, n):  # type: ignore[no-untyped-def]
    """target[to : to + n] += factor source[at : at + n]; the two must not overlap."""
    i = types.intp
    return types.void(target, i, source, i, source.dtype, i), _adding(scaled=True)
