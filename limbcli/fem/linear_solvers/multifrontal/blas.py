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


_BYTE, _INT = ir.IntType(8), ir.IntType(32)


def _pointer(context, builder, array_type, array, offset):  # type: ignore[no-untyped-def]
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [offset])


def _by_address(builder, value):  # type: ignore[no-untyped-def]
    slot = cgutils.alloca_once(builder, value.type)
    builder.store(value, slot)
    return slot


def _letter(builder, letter):  # type: ignore[no-untyped-def]
    return _by_address(builder, ir.Constant(_BYTE, ord(letter)))


def _int(builder, value):  # type: ignore[no-untyped-def]
    return _by_address(builder, builder.trunc(value, _INT))


def _call(builder, table, routine, arguments):  # type: ignore[no-untyped-def]
    kind = ir.FunctionType(ir.VoidType(), [each.type for each in arguments])
    at = builder.gep(table, [ir.Constant(ir.IntType(64), routine)])
    builder.call(builder.inttoptr(builder.load(at), kind.as_pointer()), arguments)


def _table(context, builder, signature, args):  # type: ignore[no-untyped-def]
    return context.make_array(signature.args[0])(context, builder, args[0]).data


def _gemm(turned):  # type: ignore[no-untyped-def]
    """GEMM intrinsic; turned : "T" if B is passed as its transpose, else "N"."""

    def typed(typingctx, table, m, n, k, alpha, a, oa, lda, b, ob, ldb, beta, c, oc, ldc):  # type: ignore[no-untyped-def]
        i = types.intp
        real = a.dtype
        signature = types.void(table, i, i, i, real, a, i, i, b, i, i, real, c, i, i)

        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            t = signature.args
            _, m, n, k, alpha, a, oa, lda, b, ob, ldb, beta, c, oc, ldc = args
            arguments = [
                _letter(builder, "N"),
                _letter(builder, turned),
                _int(builder, m),
                _int(builder, n),
                _int(builder, k),
                _by_address(builder, alpha),
                _pointer(context, builder, t[5], a, oa),
                _int(builder, lda),
                _pointer(context, builder, t[8], b, ob),
                _int(builder, ldb),
                _by_address(builder, beta),
                _pointer(context, builder, t[12], c, oc),
                _int(builder, ldc),
            ]
            _call(builder, _table(context, builder, signature, args), GEMM, arguments)
            return context.get_dummy_value()

        return signature, codegen

    return typed


# C (m, n) = alpha A B^T + beta C, and alpha A B + beta C
gemm_nt = intrinsic(_gemm("T"))
gemm_nn = intrinsic(_gemm("N"))


@intrinsic
def syrk(typingctx, table, n, k, alpha, a, oa, lda, beta, c, oc, ldc):  # type: ignore[no-untyped-def]
    """Lower triangle of C = alpha A A^T + beta C, A (n, k)."""
    i = types.intp
    signature = types.void(table, i, i, a.dtype, a, i, i, a.dtype, c, i, i)

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        t = signature.args
        _, n, k, alpha, a, oa, lda, beta, c, oc, ldc = args
        arguments = [
            _letter(builder, "L"),
            _letter(builder, "N"),
            _int(builder, n),
            _int(builder, k),
            _by_address(builder, alpha),
            _pointer(context, builder, t[4], a, oa),
            _int(builder, lda),
            _by_address(builder, beta),
            _pointer(context, builder, t[8], c, oc),
            _int(builder, ldc),
        ]
        _call(builder, _table(context, builder, signature, args), SYRK, arguments)
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def solve_unit_lower(typingctx, table, m, n, a, oa, lda, b, ob, ldb):  # type: ignore[no-untyped-def]
    """B (m, n) = L^-1 B, with L the unit lower triangle of A."""
    i = types.intp
    signature = types.void(table, i, i, a, i, i, b, i, i)

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        t = signature.args
        _, m, n, a, oa, lda, b, ob, ldb = args
        one = context.get_constant(t[3].dtype, 1.0)
        arguments = [
            *(_letter(builder, each) for each in "LLNU"),
            _int(builder, m),
            _int(builder, n),
            _by_address(builder, one),
            _pointer(context, builder, t[3], a, oa),
            _int(builder, lda),
            _pointer(context, builder, t[6], b, ob),
            _int(builder, ldb),
        ]
        _call(builder, _table(context, builder, signature, args), TRSM, arguments)
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def getrf(typingctx, table, m, n, a, oa, lda, pivots, op):  # type: ignore[no-untyped-def]
    """LU of A (m, n) in place; the exchanged rows, counted from 1, go to pivots[op:] (int32)."""
    i = types.intp
    signature = types.void(table, i, i, a, i, i, pivots, i)

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        t = signature.args
        _, m, n, a, oa, lda, pivots, op = args
        arguments = [
            _int(builder, m),
            _int(builder, n),
            _pointer(context, builder, t[3], a, oa),
            _int(builder, lda),
            _pointer(context, builder, t[6], pivots, op),
            _by_address(builder, ir.Constant(_INT, 0)),
        ]
        _call(builder, _table(context, builder, signature, args), GETRF, arguments)
        return context.get_dummy_value()

    return signature, codegen
