"""The last front by itself: its Schur complement, changed and factored again."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numba import njit
from scipy.linalg import lapack

from limbcli.fem.multifrontal import solve
from limbcli.fem.multifrontal.dense import ALIGNED
from limbcli.fem.multifrontal.kept import PAD, Kept, make_kept, sizes
from limbcli.fem.multifrontal.pair import factor_pair
from limbcli.fem.multifrontal.store import Store
from limbcli.fem.multifrontal.tiles import TILE
from limbcli.fem.multifrontal.top import Top, even_area
from limbcli.fem.singular import singular
from limbcli.model import Array, IntArray

_SYMMETRIC = 1e-10  # of the largest entry
_GROWTH = 1e3  # of entries in a factor without pivoting, whose matrix has a diagonal of about 1


class Root:
    """equations : numbers of the root's equations in the front's order"""

    def __init__(self, store: Store, top: Top, order: IntArray, *, kept: bool):
        plan = store.plan
        self.store, self.top = store, top
        self.front = len(plan.pivot_at) - 2
        self.first = int(plan.pivot_at[self.front])
        self.equations = order[self.first :].copy()
        self.ld = int(plan.ld[self.front])
        self.panel = np.empty(self.n * self.ld + ALIGNED, dtype=store.kind)
        self._unfactored = np.empty(self.n * self.ld + ALIGNED if kept else 0, dtype=store.kind)
        self._left = self._make_kept()
        self._right: Kept | None = None  # where the matrix is not symmetric
        self._lu: tuple[Any, Any] | None = None
        self._spare: Kept | None = None
        self._pair_room: list[Any] = []
        self._sign = store.sign[self.first :]
        self._room = np.zeros(self.n + PAD, dtype=store.kind), np.zeros(TILE, dtype=store.kind)

    @property
    def n(self) -> int:
        return len(self.equations)

    def _make_kept(self) -> Kept:
        n_tiles, size = (int(each[0]) for each in sizes(np.array([self.n]), np.array([self.n])))
        return make_kept(self.n, n_tiles, size, self.store.kind)

    def factor(self) -> int:
        """Factor the gathered front; pivots made up for."""
        if len(self._unfactored):
            self._unfactored[:] = self.panel
        return self._factor(self.panel)

    def _factor(self, panel: Any) -> int:
        self._lu = self._right = None
        self._sign = self.store.sign[self.first :]
        made_up = self.top.factor(self.front, panel)
        if made_up < 0:
            raise singular("an entry is not finite")
        self.top.keep(self.front, panel, self._left, alone=True)
        return made_up

    def schur(self) -> Array:
        """What the elimination of all others leaves of the matrix, (n, n), unscaled."""
        self._need_kept()
        return _unscaled(self._unfactored, self.ld, self.store.scaling[self.equations])

    def update(self, addition: Array | None) -> int:
        """Factor the Schur complement with something added; pivots made up for."""
        self._need_kept()
        scaling = self.store.scaling[self.equations]
        if addition is None:
            self.panel[:] = self._unfactored
            return self._factor(self.panel)
        addition = np.ascontiguousarray(addition, dtype=float)
        if addition.shape != (self.n, self.n):
            raise ValueError(f"{self.n} equations in the root, not {addition.shape}")
        if self._add(addition, scaling):
            return self._factor(self._pair_room[0])
        if not self._factor_pair():
            self._factor_lu(addition, scaling)
        return 0

    def _add(self, addition: Array, scaling: Array) -> bool:
        """The sum in the room of the pair; whether it is symmetric."""
        if not self._pair_room:
            size = self.n * self.ld + ALIGNED
            self._pair_room = [np.empty(each, dtype=self.store.kind) for each in (size, size, self.n)]
        left, right, _ = self._pair_room
        columns = [
            partial(
                _both_lower,
                self._unfactored,
                self.ld,
                addition,
                scaling,
                a,
                b,
                left,
                right,
                np.empty((_TILE, _TILE)),
            )
            for a, b in even_area(self.n, self.n)
        ]
        found = np.array(self.top.crew.run(columns))
        return bool(found[:, 1].max() <= _SYMMETRIC * found[:, 0].max())

    def _factor_pair(self) -> bool:
        """Without pivoting, on both threads; whether that was safe."""
        left, right, sign = self._pair_room
        if not factor_pair(self.store, self.top.crew, left, right, self.ld, self.n, sign):
            return False
        if _growth(left, right, self.ld, self.n) > _GROWTH:
            return False
        if self._spare is None:
            self._spare = self._make_kept()
        self._lu, self._sign, self._right = None, sign, self._spare
        self.top.keep(self.front, left, self._left, alone=True)
        self.top.keep(self.front, right, self._right, alone=True)
        return True

    def _factor_lu(self, addition: Array, scaling: Array) -> None:
        full = np.empty((self.n, self.n), dtype=self.store.kind, order="F")
        _sum(self._unfactored, self.ld, addition, scaling, full)
        factor = lapack.sgetrf if self.store.kind is np.float32 else lapack.dgetrf
        lu, pivots, info = factor(full, overwrite_a=1)
        if info != 0 or not np.isfinite(np.diagonal(lu)).all():
            raise singular("the root has no factor")
        self._lu = (lu, pivots)

    def _need_kept(self) -> None:
        if not len(self._unfactored):
            raise ValueError("no Schur complement is kept unless `last` is given")

    def solve(self, w: Any) -> None:
        """Solve for the root's part of w (n,), scaled and in the order of elimination."""
        part = w[self.first :]
        if self._lu is not None:
            substitute = lapack.sgetrs if self.store.kind is np.float32 else lapack.dgetrs
            part[...] = substitute(*self._lu, part)[0]
        else:
            solve.whole(self._left, self._right or self._left, self._sign, part, *self._room)


_TILE = 32


@njit(cache=True)
def _unscaled(lower, ld, scaling):  # type: ignore[no-untyped-def]
    n = len(scaling)
    out = np.empty((n, n))
    for j0 in range(0, n, _TILE):
        for i0 in range(j0, n, _TILE):
            for j in range(j0, min(j0 + _TILE, n)):
                for i in range(max(i0, j), min(i0 + _TILE, n)):
                    value = lower[i + j * ld] / (scaling[i] * scaling[j])
                    out[i, j] = value
                    out[j, i] = value
    return out


@njit(cache=True, nogil=True, fastmath=True)
def _both_lower(lower, ld, addition, scaling, first, stop, left, right, tile):  # type: ignore[no-untyped-def]
    """Columns first..stop of the lower triangles of the sum and of its transpose.

    Returns the largest entry added, and the largest difference from its mirror image.
    """
    n = len(scaling)
    largest, uneven = 0.0, 0.0
    for j0 in range(first, stop, _TILE):
        j1 = min(j0 + _TILE, stop)
        for i0 in range(j0, n, _TILE):
            i1 = min(i0 + _TILE, n)
            for i in range(i0, i1):
                for j in range(j0, j1):
                    tile[j - j0, i - i0] = addition[i, j]
            for j in range(j0, j1):
                low = max(i0, j)
                at = low + j * ld
                column, row = tile[j - j0, low - i0 : i1 - i0], addition[j, low:i1]
                to = at + i1 - low
                value, into, mirrored = lower[at:to], left[at:to], right[at:to]
                sizes, size = scaling[low:i1], scaling[j]
                for i in range(len(row)):
                    one, other = column[i], row[i]
                    largest = max(largest, max(abs(one), abs(other)))
                    uneven = max(uneven, abs(one - other))
                    into[i] = value[i] + one * (size * sizes[i])
                    mirrored[i] = value[i] + other * (size * sizes[i])
    return largest, uneven


@njit(cache=True)
def _growth(left, right, ld, n):  # type: ignore[no-untyped-def]
    """The largest entry of the factors, infinite if one is not finite."""
    largest = 0.0
    for j in range(n):
        for i in range(j, n):
            size = abs(left[i + j * ld]) + abs(right[i + j * ld])
            if not size < np.inf:
                return np.inf
            largest = max(largest, size)
    return largest


@njit(cache=True)
def _sum(lower, ld, addition, scaling, out):  # type: ignore[no-untyped-def]
    n = len(scaling)
    for j0 in range(0, n, _TILE):
        for i0 in range(j0, n, _TILE):
            for j in range(j0, min(j0 + _TILE, n)):
                for i in range(max(i0, j), min(i0 + _TILE, n)):
                    value = lower[i + j * ld]
                    size = scaling[i] * scaling[j]
                    out[i, j] = value + addition[i, j] * size
                    out[j, i] = value + addition[j, i] * size
