"""The root (last) front: its Schur complement can be changed and refactored separately.

The matrix added to it need not be symmetric; the front is then factored by a dense LU.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sparse

from limbcli.fem.linear_solvers.multifrontal import solve
from limbcli.fem.linear_solvers.multifrontal.compact_factor import PAD, make_kept, sizes
from limbcli.fem.linear_solvers.multifrontal.dense import ALIGNED
from limbcli.fem.linear_solvers.multifrontal.factor_memory import Store
from limbcli.fem.linear_solvers.multifrontal.lu import Lu
from limbcli.fem.linear_solvers.multifrontal.shared_fronts import Top
from limbcli.fem.linear_solvers.multifrontal.tiles import TILE
from limbcli.fem.linear_solvers.singular import singular
from limbcli.model import Array, IntArray
from limbcli.numbers.compiled import njit


class Root:
    """The root front. equations : equation numbers in the front's order"""

    def __init__(self, store: Store, top: Top, order: IntArray, *, kept: bool):
        plan = store.plan
        self.store, self.top = store, top
        self.front = len(plan.pivot_at) - 2
        self.first = int(plan.pivot_at[self.front])
        self.equations = order[self.first :].copy()
        self.ld = int(plan.ld[self.front])
        self.panel = np.empty(self.n * self.ld + ALIGNED, dtype=store.kind)
        self._unfactored = np.empty(self.n * self.ld + ALIGNED if kept else 0, dtype=store.kind)
        n_tiles, size = (int(each[0]) for each in sizes(np.array([self.n]), np.array([self.n])))
        self._kept = make_kept(self.n, n_tiles, size, store.kind)
        self.made_up, self.is_factored = 0, True
        self._lu = Lu(self.n if kept else 0, store.kind, store.blas, top.team)
        self._is_unsymmetric = False
        self._room = np.zeros(self.n + PAD, dtype=store.kind), np.zeros(TILE, dtype=store.kind)

    @property
    def n(self) -> int:
        return len(self.equations)

    def gathered(self) -> None:
        """Accept the newly assembled panel; it is factored when needed, unchanged or after `update`."""
        self._is_unsymmetric, self.made_up, self.is_factored = False, 0, False
        if len(self._unfactored):
            self._unfactored[:] = self.panel

    def factor(self) -> None:
        """Factor the front as assembled, unless it is already factored."""
        if not self.is_factored:
            self.made_up, self.is_factored = self._factor(), True

    def _factor(self) -> int:
        made_up = self.top.factor(self.front, self.panel)
        if made_up < 0:
            raise singular("an entry is not finite")
        self.top.keep(self.front, self.panel, self._kept, alone=True)
        return made_up

    def schur(self) -> Array:
        """Schur complement (n, n) after elimination of all other equations, unscaled."""
        self._need_kept()
        return _unscaled(self._unfactored, self.ld, self.store.scaling[self.equations])

    def update(self, addition: sparse.sparray | None) -> None:
        """Factor the Schur complement plus a matrix that need not be symmetric (None: nothing is added)."""
        self._need_kept()
        self._is_unsymmetric = False
        if addition is None:
            self.panel[:] = self._unfactored
            self.made_up, self.is_factored = self._factor(), True
            return
        if addition.shape != (self.n, self.n):
            raise ValueError(f"{self.n} equations in the root, not {addition.shape}")
        scaling = self.store.scaling[self.equations]
        full = self._lu.matrix.T
        middle = self.n - int(self.n / np.sqrt(2.0))  # half of the triangle's area on either side
        self.top.team.run(
            [
                partial(_mirrored, self._unfactored, self.ld, a, b, full)
                for a, b in ((0, middle), (middle, self.n))
            ]
        )
        added = sparse.csr_array(addition)
        _add(added.indptr, added.indices, added.data, scaling, full)
        self._lu.factor()
        pivots = self._lu.matrix.diagonal()
        if not np.isfinite(pivots).all():
            raise singular("an entry is not finite")
        small = np.flatnonzero(np.abs(pivots) < self.store.tiny)
        self._lu.matrix[small, small] = self.store.tiny
        self.made_up, self._is_unsymmetric, self.is_factored = len(small), True, True

    @property
    def is_kept(self) -> bool:
        """Whether the front's Schur complement is kept, so that it can be changed."""
        return len(self._unfactored) > 0

    def _need_kept(self) -> None:
        if not self.is_kept:
            raise ValueError("no Schur complement is kept unless `last` is given")

    def solve(self, w: Any) -> None:
        """Solve for the root's part of the scaled vector w, which is in elimination order (in place)."""
        if self._is_unsymmetric:
            w[self.first :] = self._lu.solve(w[self.first :], transposed=True)
            return
        solve.whole(self._kept, self.store.sign[self.first :], w[self.first :], *self._room)


_TILE = 32


@njit
def _mirrored(lower, ld, first, stop, out):  # type: ignore[no-untyped-def]
    """Copy columns first..stop of a lower triangle to `out`, and mirror them to the upper triangle."""
    n = len(out)
    for j0 in range(first, stop, _TILE):
        for i0 in range(j0, n, _TILE):
            for j in range(j0, min(j0 + _TILE, stop)):
                for i in range(max(i0, j), min(i0 + _TILE, n)):
                    value = lower[i + j * ld]
                    out[i, j] = value
                    out[j, i] = value


@njit
def _add(indptr, indices, data, scaling, out):  # type: ignore[no-untyped-def]
    for i in range(len(out)):
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            out[i, j] += data[k] * scaling[i] * scaling[j]


@njit
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
