"""Calls of scipy's BLAS and LAPACK from compiled loops without the GIL.

The routine addresses are those that scipy exports (`scipy.linalg.cython_blas`, `cython_lapack`); they are
passed to the loops as numbers, so that the compiled loops can be cached. Matrices are flat arrays in
column-major order with an offset and a leading dimension.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import get_cython_function_address, intrinsic

from limbcli.model import IntArray

_ROUTINES = (("blas", "gemm"), ("blas", "syrk"), ("blas", "trsm"), ("lapack", "getrf"))
GEMM, SYRK, TRSM, GETRF = range(len(_ROUTINES))


def addresses(single: bool) -> IntArray:
    """Addresses of the routines, in the order GEMM, SYRK, TRSM, GETRF."""
    letter = "s" if single else "d"
    found = [
        get_cython_function_address(f"scipy.linalg.cython_{library}", letter + routine)
        for library, routine in _ROUTINES
    ]
    return np.array(found)


def _by_address(builder, value):  # type: ignore[no-untyped-def]
    slot = cgutils.alloca_once(builder, value.type)
    builder.store(value, slot)
    return slot


def _calling(routine, letters="", *, scale=None, info=False):  # type: ignore[no-untyped-def]
    """Generates the call of a routine: its letters, then what the intrinsic takes besides the table of
    addresses, an array with the offset that follows it as the pointer to its first number.

    scale : a constant before the first array; info : the routine ends with a number that is not looked at
    """
    integer = ir.IntType(32)

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        data = lambda kind, array: context.make_array(kind)(context, builder, array).data  # noqa: E731
        given = [ir.Constant(ir.IntType(8), ord(each)) for each in letters]
        arguments = [_by_address(builder, each) for each in given]
        rest, one = zip(signature.args[1:], args[1:], strict=True), scale
        for kind, value in rest:
            if isinstance(kind, types.Array):
                if one is not None:
                    constant, one = context.get_constant(kind.dtype, one), None
                    arguments.append(_by_address(builder, constant))
                arguments.append(builder.gep(data(kind, value), [next(rest)[1]]))
            else:
                is_count = isinstance(kind, types.Integer)
                arguments.append(_by_address(builder, builder.trunc(value, integer) if is_count else value))
        arguments += [_by_address(builder, ir.Constant(integer, 0))] if info else []
        kind = ir.FunctionType(ir.VoidType(), [each.type for each in arguments])
        at = builder.gep(data(signature.args[0], args[0]), [ir.Constant(ir.IntType(64), routine)])
        builder.call(builder.inttoptr(builder.load(at), kind.as_pointer()), arguments)
        return context.get_dummy_value()

    return codegen


_I = types.intp


def _gemm(turned):  # type: ignore[no-untyped-def]
    """GEMM intrinsic; turned : "T" if B is passed as its transpose, else "N"."""

    def typed(typingctx, table, m, n, k, alpha, a, oa, lda, b, ob, ldb, beta, c, oc, ldc):  # type: ignore[no-untyped-def]
        signature = types.void(table, _I, _I, _I, a.dtype, a, _I, _I, b, _I, _I, a.dtype, c, _I, _I)
        return signature, _calling(GEMM, "N" + turned)

    return typed


# C (m, n) = alpha A B^T + beta C, and alpha A B + beta C
gemm_nt = intrinsic(_gemm("T"))
gemm_nn = intrinsic(_gemm("N"))


@intrinsic
def syrk(typingctx, table, n, k, alpha, a, oa, lda, beta, c, oc, ldc):  # type: ignore[no-untyped-def]
    """Lower triangle of C = alpha A A^T + beta C, A (n, k)."""
    return types.void(table, _I, _I, a.dtype, a, _I, _I, a.dtype, c, _I, _I), _calling(SYRK, "LN")


@intrinsic
def solve_unit_lower(typingctx, table, m, n, a, oa, lda, b, ob, ldb):  # type: ignore[no-untyped-def]
    """B (m, n) = L^-1 B, with L the unit lower triangle of A."""
    return types.void(table, _I, _I, a, _I, _I, b, _I, _I), _calling(TRSM, "LLNU", scale=1.0)


@intrinsic
def getrf(typingctx, table, m, n, a, oa, lda, pivots, op):  # type: ignore[no-untyped-def]
    """LU of A (m, n) in place; the exchanged rows, counted from 1, go to pivots[op:] (int32)."""
    return types.void(table, _I, _I, a, _I, _I, pivots, _I), _calling(GETRF, info=True)
