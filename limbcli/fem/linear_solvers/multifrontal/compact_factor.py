"""A factor as it is kept for substitution, apart from the panels in which it is made.

Sixteen pivot columns at a time: the inverse of the triangle on their diagonal, and what is below it
in chunks (see `tiles`). In single precision the latter are short integers, 1/32767 of the largest
number of their column: the factor is an approximate inverse for GMRES, and the time of a
substitution is that of reading it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from limbcli.fem.linear_solvers.multifrontal.tiles import TILE, down_part, keep_column, times_tile, up_part
from limbcli.model import IntArray

PAD = 3 * TILE  # space beyond the rows of a front
_MOST = 32767.0


class CompactFactor(NamedTuple):
    """parts : below the diagonal; scales : of each pivot column; inverses, transposed : of the triangles"""

    parts: NDArray[Any]
    scales: NDArray[Any]
    inverses: NDArray[Any]
    transposed: NDArray[Any]

    @property
    def nbytes(self) -> int:
        return sum(each.nbytes for each in self)


def make_kept(n: int, n_tiles: int, size: int, kind: Any) -> CompactFactor:
    """Workspace for a factor of n pivots; `kind` is that of its panels."""
    part = np.int16 if kind is np.float32 else kind
    tiles = np.empty((2, n_tiles * TILE * TILE), dtype=kind)
    return CompactFactor(np.empty(size, dtype=part), np.zeros(n + TILE, dtype=kind), tiles[0], tiles[1])


def sizes(p: IntArray, m: IntArray) -> tuple[IntArray, IntArray]:
    """Tiles, and numbers in the parts, of fronts of p pivots and m rows.

    >>> sizes(np.array([20]), np.array([40]))
    (array([2]), array([640]))
    """
    whole, rest = p // TILE, p % TILE
    # chunks of the whole tiles: those of m - 16, m - 32 .. rows
    most = (m + TILE - 1) // TILE
    chunks = whole * most - whole * (whole + 1) // 2
    last = (m - p + TILE - 1) // TILE * ((rest + 3) // 4 * 4)
    return whole + (rest > 0), TILE * (TILE * chunks + last)


@njit(cache=True, nogil=True, fastmath=True)
def _largest(a, first, stop):  # type: ignore[no-untyped-def]
    largest = a.dtype.type(0)
    for i in range(first, stop):
        largest = max(largest, abs(a[i]))
    return largest


@njit(cache=True, nogil=True)
def keep(kept, tile, at, first, panel, o, ld, p, m, half):  # type: ignore[no-untyped-def]
    """Take over a front's panel (m, p); its first tile, part and pivot are numbers tile, at, first.

    half : 0 or 1, for one of two threads, or -1 for all of it
    """
    parts = kept.parts
    exact = parts.itemsize == panel.itemsize
    one = panel.dtype.type(1)
    rest = np.zeros(TILE, dtype=panel.dtype)
    for j0 in range(0, p, TILE):
        j1 = min(j0 + TILE, p)
        n, width = m - j1, (j1 - j0 + 3) // 4 * 4
        chunks = (n + TILE - 1) // TILE
        if half < 0 or (j0 // TILE) % 2 == half:
            diagonal, to = o + j0 * (ld + 1), tile * TILE * TILE
            _keep_triangle(panel, diagonal, ld, j1 - j0, kept.inverses, kept.transposed, to)
            for c in range(width):
                to, stride, whole = at + c * TILE, width * TILE, n // TILE
                if c >= j1 - j0:
                    rest[:] = 0
                    for k in range(chunks):
                        keep_column(parts, to + k * stride, stride, rest, 0, 1, one)
                    continue
                source = o + j1 + (j0 + c) * ld
                factor, scale = one, one
                if not exact:
                    largest = max(_largest(panel, source, source + n), panel.dtype.type(1e-30))
                    factor = panel.dtype.type(_MOST) / largest
                    scale = one / factor
                kept.scales[first + j0 + c] = scale
                keep_column(parts, to, stride, panel, source, whole, factor)
                if chunks > whole:
                    for i in range(TILE):
                        rest[i] = panel[source + whole * TILE + i] if whole * TILE + i < n else 0
                    keep_column(parts, to + whole * stride, stride, rest, 0, 1, factor)
        tile += 1
        at += chunks * width * TILE


@njit(cache=True, nogil=True)
def _keep_triangle(a, d, ld, n, inverses, transposed, at):  # type: ignore[no-untyped-def]
    """The inverse of n columns of L, filled up with those of the unit matrix, and its transpose."""
    one = a.dtype.type(1)
    for i in range(TILE * TILE):
        inverses[at + i] = 0
    for j in range(TILE):
        inverses[at + j * TILE + j] = one / a[d + j * (ld + 1)] if j < n else one
    for j in range(n):
        column = at + j * TILE
        for i in range(j + 1, n):
            total = a.dtype.type(0)
            for k in range(j, i):
                total += a[d + i + k * ld] * inverses[column + k]
            inverses[column + i] = -total / a[d + i * (ld + 1)]
    for j in range(TILE):
        for i in range(TILE):
            transposed[at + i * TILE + j] = inverses[at + j * TILE + i]


@njit(cache=True, nogil=True)
def down(kept, tile, at, first, p, m, y, z):  # type: ignore[no-untyped-def]
    """y -> L^-1 y for the first p, less L2 times that for the others; y has PAD more, z is workspace."""
    for j0 in range(0, p, TILE):
        j1 = min(j0 + TILE, p)
        width, chunks = (j1 - j0 + 3) // 4 * 4, (m - j1 + TILE - 1) // TILE
        times_tile(kept.inverses, tile * TILE * TILE, y, j0, z, 0)
        for c in range(TILE):
            y[j0 + c] = z[c]
        for c in range(TILE):
            z[c] *= kept.scales[first + j0 + c]
        down_part(width, kept.parts, at, chunks, z, y, j1)
        tile += 1
        at += chunks * width * TILE


@njit(cache=True, nogil=True)
def up(kept, tile, at, first, p, m, y, z):  # type: ignore[no-untyped-def]
    """The first p of y -> L^-T (y - L2^T of the others); tile, at : where the next front's begin."""
    for j0 in range((p - 1) // TILE * TILE, -1, -TILE):
        j1 = min(j0 + TILE, p)
        width, chunks = (j1 - j0 + 3) // 4 * 4, (m - j1 + TILE - 1) // TILE
        tile -= 1
        at -= chunks * width * TILE
        up_part(width, kept.parts, at, chunks, y, j1, z)
        for c in range(TILE):
            z[c] = y[j0 + c] - z[c] * kept.scales[first + j0 + c]
        times_tile(kept.transposed, tile * TILE * TILE, z, 0, y, j0)
