"""Dense factorisation of a front: A = L S L^T with S = diag(+-1), without pivoting.

Left-looking, block by block: one product with all columns to the left, then the block itself in narrow
tiles, whose inverses turn the triangular solves below them into products.
"""

from __future__ import annotations

import numpy as np

from limbcli.fem.linear_solvers.multifrontal.blas import gemm_nt, syrk
from limbcli.fem.linear_solvers.multifrontal.vectors import add_scaled
from limbcli.numbers.compiled import njit

NOT_FINITE = -1
TILE = 32  # columns factored by plain loops
STRIP = 512  # rows processed at a time below a diagonal block
ALIGNED = 16  # leading dimensions, and first rows and columns of parts of a front, are multiples of this


@njit
def signed_copy(a, oa, lda, n, k, sign, first, out):  # type: ignore[no-untyped-def]
    """out (n, k), column-major = a with each column times its sign, if any is negative; returns whether."""
    negative = False
    for j in range(k):
        negative |= sign[first + j] < 0
    if negative:
        for j in range(k):
            for i in range(n):
                out[j * n + i] = a[oa + j * lda + i] * sign[first + j]
    return negative


@njit
def reduce_block(blas, a, o, ld, j0, j1, r0, r1, sign, first, work):  # type: ignore[no-untyped-def]
    """Subtract the contribution of the columns before j0 from rows r0..r1 of columns j0..j1.

    r0 is j0 or a multiple of ALIGNED, like j0; values above the diagonal are undefined.
    """
    one = a.dtype.type(1)
    if j0 == 0 or r1 <= r0:
        return
    n = j1 - j0
    target = o + r0 + j0 * ld
    if signed_copy(a, o + j0, ld, n, j0, sign, first, work):
        gemm_nt(blas, r1 - r0, n, j0, -one, a, o + r0, ld, work, 0, n, one, a, target, ld)
    else:
        gemm_nt(blas, r1 - r0, n, j0, -one, a, o + r0, ld, a, o + j0, ld, one, a, target, ld)


@njit
def factor_diagonal(blas, a, o, ld, j0, j1, sign, first, tiny, inverse, work):  # type: ignore[no-untyped-def]
    """Factor the diagonal block of columns j0..j1; returns the number of perturbed pivots, or NOT_FINITE.

    inverse : output, S L^-1 of the TILE x TILE blocks on its diagonal, column-major
    """
    made_up = 0
    for k0 in range(j0, j1, TILE):
        k1 = min(k0 + TILE, j1)
        reduce_tile(blas, a, o, ld, j0, k0, k1, k0, j1, sign, first, work)
        inverted = inverse[(k0 - j0) * TILE : (k0 - j0 + TILE) * TILE]
        found = _factor_tile(a, o + k0 * (ld + 1), ld, k1 - k0, sign, first + k0, tiny, inverted, work)
        if found < 0:
            return NOT_FINITE
        made_up += found
        solve_tile(blas, a, o, ld, k0, k1, k1, j1, inverted, work)
    return made_up


@njit
def reduce_tile(blas, a, o, ld, j0, k0, k1, r0, r1, sign, first, work):  # type: ignore[no-untyped-def]
    """Subtract the contribution of columns j0..k0 from rows r0..r1 of columns k0..k1."""
    one = a.dtype.type(1)
    if k0 == j0 or r1 <= r0:
        return
    n, k = k1 - k0, k0 - j0
    target, left = o + r0 + k0 * ld, o + r0 + j0 * ld
    if signed_copy(a, o + k0 + j0 * ld, ld, n, k, sign, first + j0, work):
        gemm_nt(blas, r1 - r0, n, k, -one, a, left, ld, work, 0, n, one, a, target, ld)
    else:
        gemm_nt(blas, r1 - r0, n, k, -one, a, left, ld, a, o + k0 + j0 * ld, ld, one, a, target, ld)


@njit
def _factor_tile(a, d, ld, n, sign, first, tiny, inverse, work):  # type: ignore[no-untyped-def]
    """L S L^T of n <= TILE columns, in loops of fixed length; S L^-1 goes to `inverse`, column-major."""
    one, none = a.dtype.type(1), a.dtype.type(0)
    made_up = 0
    for j in range(n):
        for i in range(TILE):
            work[j * TILE + i] = a[d + i + j * ld] if j <= i < n else none
    for j in range(n):
        pivot = work[j * TILE + j]
        if not np.isfinite(pivot):
            return NOT_FINITE
        s = one if pivot >= 0 else -one
        if abs(pivot) <= tiny:
            pivot = s * tiny
            made_up += 1
        root = np.sqrt(abs(pivot))
        sign[first + j] = s
        factor = s / root
        for i in range(TILE):
            work[j * TILE + i] *= factor
        work[j * TILE + j] = root
        for k in range(j + 1, n):
            add_scaled(work, k * TILE, work, j * TILE, -s * work[j * TILE + k], TILE)
    for j in range(n):
        for i in range(j, n):
            a[d + i + j * ld] = work[j * TILE + i]
    invert_tile(work, 0, n, sign, first, inverse)
    return made_up


@njit
def invert_tile(tile, at, n, sign, first, inverse):  # type: ignore[no-untyped-def]
    """S L^-1, column-major, of the n columns of L at tile[at], which are overwritten."""
    one, none = tile.dtype.type(1), tile.dtype.type(0)
    for j in range(n):
        for i in range(TILE):
            inverse[j * TILE + i] = none
        inverse[j * TILE + j] = one
        for k in range(j):
            add_scaled(inverse, j * TILE, inverse, k * TILE, -tile[at + k * TILE + j], TILE)
        factor = one / tile[at + j * TILE + j]
        for i in range(TILE):
            inverse[j * TILE + i] *= factor
    for j in range(n):
        for i in range(TILE):
            tile[at + i * TILE + j] = inverse[j * TILE + i] * sign[first + j]
    for i in range(TILE * TILE):
        inverse[i] = tile[at + i]


@njit
def solve_tile(blas, a, o, ld, k0, k1, r0, r1, inverse, work):  # type: ignore[no-untyped-def]
    """Multiply rows r0..r1 of columns k0..k1 by L^-T S of the tile, given its inverse."""
    one, none = a.dtype.type(1), a.dtype.type(0)
    n, m = k1 - k0, r1 - r0
    if m <= 0:
        return
    for j in range(n):
        source = o + r0 + (k0 + j) * ld
        for i in range(m):
            work[j * m + i] = a[source + i]
    gemm_nt(blas, m, n, n, one, work, 0, m, inverse, 0, TILE, none, a, o + r0 + k0 * ld, ld)


@njit
def solve_block(blas, a, o, ld, j0, j1, r0, r1, sign, first, inverse, work):  # type: ignore[no-untyped-def]
    """Solve for rows r0..r1 of columns j0..j1 after their diagonal block has been factored."""
    for b0 in range(r0, r1, STRIP):
        b1 = min(b0 + STRIP, r1)
        for k0 in range(j0, j1, TILE):
            k1 = min(k0 + TILE, j1)
            reduce_tile(blas, a, o, ld, j0, k0, k1, b0, b1, sign, first, work)
            inverted = inverse[(k0 - j0) * TILE : (k0 - j0 + TILE) * TILE]
            solve_tile(blas, a, o, ld, k0, k1, b0, b1, inverted, work)


@njit
def factor_panel(blas, a, o, ld, p, m, block, sign, first, tiny, inverse, work):  # type: ignore[no-untyped-def]
    """Factor the first p columns of a front of m rows; returns how many pivots were perturbed, or NOT_FINITE.

    block : columns per block
    """
    made_up = 0
    for j0 in range(0, p, block):
        j1 = min(j0 + block, p)
        reduce_block(blas, a, o, ld, j0, j1, j0, m, sign, first, work)
        found = factor_diagonal(blas, a, o, ld, j0, j1, sign, first, tiny, inverse, work)
        if found < 0:
            return NOT_FINITE
        made_up += found
        solve_block(blas, a, o, ld, j0, j1, j1, m, sign, first, inverse, work)
    return made_up


@njit
def form_update(blas, a, o, ld, p, m, u, ou, ldu, c0, c1, block, sign, first, work):  # type: ignore[no-untyped-def]
    """Columns c0..c1 of the lower triangle of U = -L2 S L2^T, with L2 the panel's rows below its pivots."""
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
