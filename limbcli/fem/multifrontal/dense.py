"""A front's dense arithmetic: A = L S L^T with S = diag(+-1), pivots in their given order.

Columns are finished block by block (left-looking): one product with all that lies to the
left, Cholesky's factor of the diagonal block (or our own loop where a pivot is negative or
next to nothing), one triangular solve below it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from limbcli.fem.multifrontal.blas import gemm_nt, potrf, syrk, trsm_right

NOT_FINITE = -1


@njit(cache=True, nogil=True)
def signed_copy(a, oa, lda, n, k, sign, first, out):  # type: ignore[no-untyped-def]
    """out (n, k), column after column: a with each column times its sign. Returns whether any is negative."""
    negative = False
    for j in range(k):
        negative |= sign[first + j] < 0
    if negative:
        for j in range(k):
            for i in range(n):
                out[j * n + i] = a[oa + j * lda + i] * sign[first + j]
    return negative


@njit(cache=True, nogil=True)
def reduce_block(blas, a, o, ld, j0, j1, r0, r1, sign, first, work):  # type: ignore[no-untyped-def]
    """Take from rows r0..r1 of columns j0..j1 what the columns before j0 contribute."""
    one = a.dtype.type(1)
    if j0 == 0 or r1 <= r0:
        return
    n = j1 - j0
    target = o + r0 + j0 * ld
    if signed_copy(a, o + j0, ld, n, j0, sign, first, work):
        gemm_nt(blas, r1 - r0, n, j0, -one, a, o + r0, ld, work, 0, n, one, a, target, ld)
    else:
        gemm_nt(blas, r1 - r0, n, j0, -one, a, o + r0, ld, a, o + j0, ld, one, a, target, ld)


@njit(cache=True, nogil=True)
def factor_diagonal(blas, a, o, ld, j0, j1, sign, first, tiny, work):  # type: ignore[no-untyped-def]
    """Factor the diagonal block of columns j0..j1; pivots made up for, or NOT_FINITE."""
    n = j1 - j0
    d = o + j0 + j0 * ld
    for j in range(n):
        for i in range(j, n):
            work[j * n + i] = a[d + i + j * ld]
    if potrf(blas, n, a, d, ld) == 0:
        good = True
        for j in range(n):
            root = a[d + j + j * ld]
            good &= root * root > tiny
            sign[first + j0 + j] = 1
        if good:
            return 0 if np.isfinite(a[d + (n - 1) * (ld + 1)]) else NOT_FINITE
    for j in range(n):
        for i in range(j, n):
            a[d + i + j * ld] = work[j * n + i]
    return _factor_signed(a, d, ld, n, sign, first + j0, tiny)


@njit(cache=True, nogil=True)
def _factor_signed(a, d, ld, n, sign, first, tiny):  # type: ignore[no-untyped-def]
    made_up = 0
    for j in range(n):
        pivot = a[d + j + j * ld]
        if not np.isfinite(pivot):
            return NOT_FINITE
        s = a.dtype.type(1) if pivot >= 0 else a.dtype.type(-1)
        if abs(pivot) <= tiny:
            pivot = s * tiny
            made_up += 1
        root = np.sqrt(abs(pivot))
        sign[first + j] = s
        a[d + j + j * ld] = root
        for i in range(j + 1, n):
            a[d + i + j * ld] /= s * root
        for k in range(j + 1, n):
            factor = s * a[d + k + j * ld]
            for i in range(k, n):
                a[d + i + k * ld] -= factor * a[d + i + j * ld]
    return made_up


@njit(cache=True, nogil=True)
def solve_block(blas, a, o, ld, j0, j1, r0, r1, sign, first):  # type: ignore[no-untyped-def]
    """Rows r0..r1 of columns j0..j1, once their diagonal block is factored."""
    if r1 <= r0:
        return
    trsm_right(blas, r1 - r0, j1 - j0, a, o + j0 + j0 * ld, ld, a, o + r0 + j0 * ld, ld)
    for j in range(j0, j1):
        if sign[first + j] < 0:
            for i in range(r0, r1):
                a[o + i + j * ld] = -a[o + i + j * ld]


@njit(cache=True, nogil=True)
def factor_panel(blas, a, o, ld, p, m, block, sign, first, tiny, work):  # type: ignore[no-untyped-def]
    """The first p columns of a front of m rows; pivots made up for, or NOT_FINITE."""
    made_up = 0
    for j0 in range(0, p, block):
        j1 = min(j0 + block, p)
        reduce_block(blas, a, o, ld, j0, j1, j0, m, sign, first, work)
        found = factor_diagonal(blas, a, o, ld, j0, j1, sign, first, tiny, work)
        if found < 0:
            return NOT_FINITE
        made_up += found
        solve_block(blas, a, o, ld, j0, j1, j1, m, sign, first)
    return made_up


@njit(cache=True, nogil=True)
def form_update(blas, a, o, ld, p, m, u, ou, ldu, c0, c1, block, sign, first, work):  # type: ignore[no-untyped-def]
    """Columns c0..c1 of the lower triangle of U = -L2 S L2^T, L2 the rows of a panel below its pivots."""
    one, none = a.dtype.type(1), a.dtype.type(0)
    r = m - p
    negative = False
    for j in range(first, first + p):
        negative |= sign[j] < 0
    low = o + p
    if not negative:
        n = c1 - c0
        syrk(blas, n, p, -one, a, low + c0, ld, none, u, ou + c0 * (ldu + 1), ldu)
        if r > c1:
            target = ou + c1 + c0 * ldu
            gemm_nt(blas, r - c1, n, p, -one, a, low + c1, ld, a, low + c0, ld, none, u, target, ldu)
        return
    for k0 in range(c0, c1, block):
        k1 = min(k0 + block, c1)
        signed_copy(a, low + k0, ld, k1 - k0, p, sign, first, work)
        target = ou + k0 + k0 * ldu
        gemm_nt(blas, r - k0, k1 - k0, p, -one, a, low + k0, ld, work, 0, k1 - k0, none, u, target, ldu)
