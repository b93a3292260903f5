"""A matrix that is not symmetric: A = L S R^T, S = diag(+-1), from the lower triangles of A and A^T.

L and R have the same diagonal. Each is factored as in `dense`, with the other in the place
of its own transpose; the two halves of the work go side by side. Pivots keep their order,
which is safe where the symmetric part of A is definite, or nearly (Golub and Van Loan 1979,
Linear Algebra Appl. 28, 85-97); where a pivot is next to nothing the caller must do otherwise.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numba import njit

from limbcli.fem.multifrontal.dense import (
    NOT_FINITE,
    TILE,
    invert_tile,
    reduce_block,
    reduce_tile,
    solve_block,
    solve_tile,
)
from limbcli.fem.multifrontal.sharing import Crew
from limbcli.fem.multifrontal.store import BLOCK, Store
from limbcli.fem.multifrontal.vectors import add_scaled


def factor_pair(store: Store, crew: Crew, a: Any, b: Any, ld: int, n: int, sign: Any) -> bool:
    """L in place of A (n, n) and R in place of its transpose; whether all pivots could be used."""
    blas, (mine, other), (inverse, inverse2) = store.blas, store.work, store.inverses
    for j0 in range(0, n, BLOCK):
        j1 = min(j0 + BLOCK, n)
        span = (0, ld, j0, j1, j0, n, sign, 0)
        crew.run(
            [partial(reduce_block, blas, a, b, *span, mine), partial(reduce_block, blas, b, a, *span, other)]
        )
        found = _factor_diagonal(blas, a, b, ld, j0, j1, sign, store.tiny, inverse, inverse2, mine)
        if found != 0:
            return False
        span = (0, ld, j0, j1, j1, n, sign, 0)
        crew.run(
            [
                partial(solve_block, blas, a, b, *span, inverse2, mine),
                partial(solve_block, blas, b, a, *span, inverse, other),
            ]
        )
    return True


@njit(cache=True, nogil=True)
def _factor_diagonal(blas, a, b, ld, j0, j1, sign, tiny, inverse, inverse2, work):  # type: ignore[no-untyped-def]
    """As `dense.factor_diagonal`; inverse gets S L^-1, inverse2 S R^-1."""
    made_up = 0
    for k0 in range(j0, j1, TILE):
        k1 = min(k0 + TILE, j1)
        reduce_tile(blas, a, b, 0, ld, j0, k0, k1, k0, j1, sign, 0, work)
        reduce_tile(blas, b, a, 0, ld, j0, k0, k1, k0, j1, sign, 0, work)
        of_l = inverse[(k0 - j0) * TILE : (k0 - j0 + TILE) * TILE]
        of_r = inverse2[(k0 - j0) * TILE : (k0 - j0 + TILE) * TILE]
        found = _factor_tile(a, b, k0 * (ld + 1), ld, k1 - k0, sign, k0, tiny, of_l, of_r, work)
        if found < 0:
            return NOT_FINITE
        made_up += found
        solve_tile(blas, a, 0, ld, k0, k1, k1, j1, of_r, work)
        solve_tile(blas, b, 0, ld, k0, k1, k1, j1, of_l, work)
    return made_up


@njit(cache=True, nogil=True)
def _factor_tile(a, b, d, ld, n, sign, first, tiny, of_l, of_r, work):  # type: ignore[no-untyped-def]
    one, none = a.dtype.type(1), a.dtype.type(0)
    made_up, second = 0, TILE * TILE
    for j in range(n):
        for i in range(TILE):
            work[j * TILE + i] = a[d + i + j * ld] if j <= i < n else none
            work[second + j * TILE + i] = b[d + i + j * ld] if j <= i < n else none
    for j in range(n):
        pivot = work[j * TILE + j]
        if not np.isfinite(pivot):
            return NOT_FINITE
        s = one if pivot >= 0 else -one
        made_up += abs(pivot) <= tiny
        root = np.sqrt(max(abs(pivot), tiny))
        sign[first + j] = s
        factor = s / root
        for i in range(TILE):
            work[j * TILE + i] *= factor
            work[second + j * TILE + i] *= factor
        work[j * TILE + j] = root
        work[second + j * TILE + j] = root
        for k in range(j + 1, n):
            l, r = work[j * TILE + k], work[second + j * TILE + k]
            add_scaled(work, k * TILE, work, j * TILE, -s * r, TILE)
            add_scaled(work, second + k * TILE, work, second + j * TILE, -s * l, TILE)
    for j in range(n):
        for i in range(j, n):
            a[d + i + j * ld] = work[j * TILE + i]
            b[d + i + j * ld] = work[second + j * TILE + i]
    invert_tile(work, 0, n, sign, first, of_l)
    invert_tile(work, second, n, sign, first, of_r)
    return made_up
