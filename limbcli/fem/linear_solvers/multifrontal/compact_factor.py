"""Compact storage of a factor for substitution, separate from the panels in which it is computed.

For every sixteen pivot columns: the inverse of their diagonal triangle, and the rows below in chunks (see
`tiles`). In single precision the latter are 16-bit integers in units of 1/32767 of their column's largest
number: the factor is an approximate inverse for GMRES, and substitution is limited by memory bandwidth.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from limbcli.fem.linear_solvers.multifrontal.tiles import TILE, down_part, keep_column, times_tile, up_part
from limbcli.model import IntArray
from limbcli.numbers.compiled import njit

PAD = 3 * TILE  # padding of vectors beyond the rows of a front
_MOST = 32767.0


class CompactFactor(NamedTuple):
    """The stored factor.

    parts : rows below the diagonal triangles; scales : scale of each pivot column
    inverses, transposed : inverses of the diagonal triangles, and their transposes
    """

    parts: NDArray[Any]
    scales: NDArray[Any]
    inverses: NDArray[Any]
    transposed: NDArray[Any]

    @property
    def nbytes(self) -> int:
        return sum(each.nbytes for each in self)


def make_kept(n: int, n_tiles: int, size: int, kind: Any) -> CompactFactor:
    """Memory for a factor of n pivots; `kind` is the floating-point type of its panels."""
    part = np.int16 if kind is np.float32 else kind
    tiles = np.empty((2, n_tiles * TILE * TILE), dtype=kind)
    return CompactFactor(np.empty(size, dtype=part), np.zeros(n + TILE, dtype=kind), tiles[0], tiles[1])


def sizes(p: IntArray, m: IntArray) -> tuple[IntArray, IntArray]:
    """Number of tiles, and of numbers in the parts, for fronts of p pivots and m rows.

    >>> sizes(np.array([20]), np.array([40]))
    (array([2]), array([640]))
    """
    whole, rest = p // TILE, p % TILE
    # chunks of the whole tiles: those of m - 16, m - 32 .. rows
    most = (m + TILE - 1) // TILE
    chunks = whole * most - whole * (whole + 1) // 2
    last = (m - p + TILE - 1) // TILE * ((rest + 3) // 4 * 4)
    return whole + (rest > 0), TILE * (TILE * chunks + last)


@njit(fastmath=True)
def _largest(a, first, stop):  # type: ignore[no-untyped-def]
    largest = a.dtype.type(0)
    for i in range(first, stop):
        largest = max(largest, abs(a[i]))
    return largest


@njit
def keep(kept, tile, at, first, panel, o, ld, p, m, half):  # type: ignore[no-untyped-def]
    """Store a front's panel (m, p), from tile number `tile`, part offset `at` and pivot `first` on.

    half : 0 or 1 for the tiles of one of two threads, -1 for all
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


@njit
def _keep_triangle(a, d, ld, n, inverses, transposed, at):  # type: ignore[no-untyped-def]
    """Store the inverse, and its transpose, of n columns of L, padded with the unit matrix."""
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


@njit
def down(kept, tile, at, first, p, m, y, z):  # type: ignore[no-untyped-def]
    """Forward substitution: y1 -> L^-1 y1 for the first p rows, then y2 -> y2 - L2 y1 for the others.

    y has PAD more rows; z is workspace.
    """
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


@njit
def up(kept, tile, at, first, p, m, y, z):  # type: ignore[no-untyped-def]
    """Backward substitution: y1 -> L^-T (y1 - L2^T y2); tile, at : start of the next front's storage."""
    for j0 in range((p - 1) // TILE * TILE, -1, -TILE):
        j1 = min(j0 + TILE, p)
        width, chunks = (j1 - j0 + 3) // 4 * 4, (m - j1 + TILE - 1) // TILE
        tile -= 1
        at -= chunks * width * TILE
        up_part(width, kept.parts, at, chunks, y, j1, z)
        for c in range(TILE):
            z[c] = y[j0 + c] - z[c] * kept.scales[first + j0 + c]
        times_tile(kept.transposed, tile * TILE * TILE, z, 0, y, j0)
