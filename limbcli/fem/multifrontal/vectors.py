"""Short runs of numbers added to others, sixteen at a time and then what is left: 8, 4, 2, 1.

Written for compiled loops whose runs are too short for the compiler's own way of taking
a loop apart.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

_WIDE = 16


def _add(builder, kind, lanes, target, source, alpha, at):  # type: ignore[no-untyped-def]
    """target[at : at + lanes] += alpha source[at : at + lanes]."""
    several = ir.VectorType(kind, lanes).as_pointer()
    size = 4 if isinstance(kind, ir.FloatType) else 8
    to = builder.bitcast(builder.gep(target, [at]), several)
    given = builder.load(builder.bitcast(builder.gep(source, [at]), several), align=size)
    if alpha is not None:
        given = builder.fmul(_everywhere(builder, alpha, lanes), given, flags=("contract",))
    got = builder.fadd(builder.load(to, align=size), given, flags=("contract",))
    builder.store(got, to, align=size)


def _everywhere(builder, value, lanes):  # type: ignore[no-untyped-def]
    index = ir.IntType(32)
    nothing = ir.Constant(ir.VectorType(value.type, lanes), ir.Undefined)
    first = builder.insert_element(nothing, value, ir.Constant(index, 0))
    return builder.shuffle_vector(first, nothing, ir.Constant(ir.VectorType(index, lanes), [0] * lanes))


def _emit(context, builder, signature, target, to, source, at, alpha, n):  # type: ignore[no-untyped-def]
    kind = context.get_value_type(signature.args[0].dtype)
    target = builder.gep(context.make_array(signature.args[0])(context, builder, target).data, [to])
    source = builder.gep(context.make_array(signature.args[2])(context, builder, source).data, [at])
    word = n.type
    wide = ir.Constant(word, _WIDE)
    whole = builder.and_(n, ir.Constant(word, -_WIDE))
    with cgutils.for_range_slice(builder, ir.Constant(word, 0), whole, wide, intp=word) as (k, _):
        _add(builder, kind, _WIDE, target, source, alpha, k)
    done = cgutils.alloca_once_value(builder, whole)
    lanes = _WIDE // 2
    while lanes:
        some = builder.icmp_unsigned("!=", builder.and_(n, ir.Constant(word, lanes)), ir.Constant(word, 0))
        with builder.if_then(some):
            k = builder.load(done)
            _add(builder, kind, lanes, target, source, alpha, k)
            builder.store(builder.add(k, ir.Constant(word, lanes)), done)
        lanes //= 2
    return context.get_dummy_value()


@intrinsic
def add(typingctx, target, to, source, at, n):  # type: ignore[no-untyped-def]
    """target[to : to + n] += source[at : at + n]; the two must not overlap."""
    i = types.intp
    signature = types.void(target, i, source, i, i)

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        target, to, source, at, n = args
        return _emit(context, builder, signature, target, to, source, at, None, n)

    return signature, codegen


@intrinsic
def add_scaled(typingctx, target, to, source, at, alpha, n):  # type: ignore[no-untyped-def]
    """target[to : to + n] += alpha source[at : at + n]; the two must not overlap."""
    i = types.intp
    signature = types.void(target, i, source, i, source.dtype, i)

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        target, to, source, at, alpha, n = args
        return _emit(context, builder, signature, target, to, source, at, alpha, n)

    return signature, codegen
