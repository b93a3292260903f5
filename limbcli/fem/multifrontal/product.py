"""C -= A S B^T for parts of fronts, with the processor's own vectors; BLAS where it has no wide ones.

Blocks of A and B are packed into strips that the innermost loop reads in one go (Goto and
van de Geijn 2008). Signs S cost nothing: they go in with the packing. Rows that fill up
the last vector may be read, and written where the caller allows it.

The product is compiled once, by itself, and called by its address, as BLAS is.
"""

from __future__ import annotations

from functools import cache

from numba import cfunc, njit, types

from limbcli.fem.multifrontal.kernel import COLUMNS, micro_1, micro_2, micro_3, pack_left, pack_right

MOST_ROWS, MOST_COLUMNS = 384, 512  # of a block of A, of B
_DEPTH = 16  # columns of either, in rows of a strip
ROOM = (MOST_ROWS + MOST_COLUMNS) * _DEPTH * 16 + 3 * 16 * COLUMNS  # numbers


@cache
def address(single: bool) -> int:
    """Where the compiled `_product` is."""
    return int(cfunc(signature(types.float32 if single else types.float64), cache=True)(_product).address)


def signature(real):  # type: ignore[no-untyped-def]
    """The types of `_product`'s arguments, for numbers of one kind."""
    i, flag, numbers = types.intp, types.boolean, types.CPointer(real)
    return types.void(
        i, i, i, i, numbers, i, numbers, i, numbers, real, flag, flag, numbers, i, i, i, numbers
    )  # fmt: skip


def _product(rows, m, n, k, a, lda, b, ldb, sign, factor, add, lower, c, ldc, low, high, room):  # type: ignore[no-untyped-def]
    """C (m, n) = factor A S B^T, or added to it; A (m, k), B (n, k), S = diag(sign).

    rows : of a strip, as many as there are numbers in a vector
    lower : only the part on and below the diagonal matters
    low, high : rows of C that may be written; all in low..m are
    """
    depth = rows * _DEPTH
    right = MOST_ROWS * depth
    for k0 in range(0, k, depth):
        kc = min(depth, k - k0)
        more = add or k0 > 0
        for n0 in range(0, n, MOST_COLUMNS):
            nc = min(MOST_COLUMNS, n - n0)
            for j in range(0, nc, COLUMNS):
                pack_right(room, right + j * kc, b, n0 + j + k0 * ldb, ldb, kc, sign, k0, factor)
            start = n0 // rows * rows if lower else 0
            for m0 in range(start, m, MOST_ROWS):
                mc = min(MOST_ROWS, m - m0)
                for i in range(0, mc, rows):
                    pack_left(room, i * kc, a, m0 + i + k0 * lda, lda, kc)
                _block(m0, mc, n0, nc, kc, more, lower, rows, c, ldc, low, min(high, m + rows), room, right)


@njit(cache=True, nogil=True)
def _block(m0, mc, n0, nc, kc, more, lower, rows, c, ldc, low, high, room, right):  # type: ignore[no-untyped-def]
    """The packed block of A times that of B."""
    edge = right + MOST_COLUMNS * rows * _DEPTH
    for j in range(0, nc, COLUMNS):
        i = max(0, (n0 + j) // rows * rows - m0) if lower else 0
        while i < mc:
            strips = (mc - i + rows - 1) // rows
            strips = 2 if strips == 4 else min(strips, 3)
            inside = m0 + i >= low and m0 + i + strips * rows <= high and j + COLUMNS <= nc
            if inside:
                to = m0 + i + (n0 + j) * ldc
                _tile(strips, room, i * kc, right + j * kc, kc, more, c, to, ldc)
            else:
                _tile(strips, room, i * kc, right + j * kc, kc, False, room, edge, strips * rows)
                for jj in range(min(COLUMNS, nc - j)):
                    to = m0 + i + (n0 + j + jj) * ldc
                    for ii in range(max(low - m0 - i, 0), min(strips * rows, high - m0 - i)):
                        value = room[edge + ii + jj * strips * rows]
                        c[to + ii] = c[to + ii] + value if more else value
            i += strips * rows


@njit(cache=True, nogil=True)
def _tile(strips, room, left, right, k, add, c, oc, ldc):  # type: ignore[no-untyped-def]
    if strips == 3:
        micro_3(room, left, room, right, k, add, c, oc, ldc)
    elif strips == 2:
        micro_2(room, left, room, right, k, add, c, oc, ldc)
    else:
        micro_1(room, left, room, right, k, add, c, oc, ldc)
