"""Forward and backward substitution: subtrees on two threads, the fronts above them on one."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from limbcli.fem.linear_solvers.multifrontal import solve
from limbcli.fem.linear_solvers.multifrontal.compact_factor import PAD
from limbcli.fem.linear_solvers.multifrontal.factor_memory import Store
from limbcli.fem.linear_solvers.multifrontal.plan import Layout
from limbcli.fem.linear_solvers.multifrontal.sharing import ThreadTeam
from limbcli.fem.linear_solvers.multifrontal.tiles import TILE


class Substitution:
    """Substitution; each of two threads accumulates the contributions of its subtrees in its own vector."""

    def __init__(self, layout: Layout, store: Store, team: ThreadTeam):
        self.store, self.team, self.layout = store, team, layout
        shares = layout.solving
        self._mine = [
            [each for each, k in zip(shares.subtrees, shares.owner, strict=True) if k == thread]
            for thread in range(2)
        ]
        self._top = [(int(s), int(s) + 1) for s in shares.top[:-1]]  # without the root front
        self._of_second = np.zeros(len(layout.order), dtype=bool)
        pivot_at = layout.plan.pivot_at
        for start, stop in self._mine[1]:
            self._of_second[pivot_at[start] : pivot_at[stop]] = True
        lengths = (layout.largest_front + PAD, TILE)
        self._workspaces = [tuple(np.zeros(n, dtype=store.kind) for n in lengths) for _ in range(2)]

    def enter(self, rhs: Any) -> Any:
        """The right-hand side (n,) scaled and permuted to elimination order."""
        w = np.empty(rhs.shape, dtype=self.store.kind)
        solve.enter(self.layout.order, self.store.scaling, rhs, w)
        return w

    def leave(self, w: Any) -> Any:
        """The solution unscaled and permuted back to equation numbers."""
        out = np.empty(w.shape)
        solve.leave(self.layout.order, self.store.scaling, w, out)
        return out

    def forward(self, w: Any) -> None:
        """Forward substitution through all fronts except the root."""
        other = np.zeros_like(w)
        other[self._of_second] = w[self._of_second]
        w[self._of_second] = 0
        tasks = [partial(self._forward, self._mine[k], each, k) for k, each in enumerate((w, other))]
        self.team.run(tasks)
        w += other
        self._forward(self._top, w, 0)

    def backward(self, w: Any) -> None:
        """Backward substitution through all fronts except the root, whose part of w is already solved."""
        self._backward(self._top[::-1], w, 0)
        self.team.run([partial(self._backward, self._mine[k], w, k) for k in range(2)])

    def _forward(self, ranges: list[tuple[int, int]], w: Any, thread: int) -> None:
        store, workspace = self.store, self._workspaces[thread]
        for start, stop in ranges:
            solve.forward(store.plan, start, stop, store.kept, store.sign, w, *workspace)

    def _backward(self, ranges: list[tuple[int, int]], w: Any, thread: int) -> None:
        store, workspace = self.store, self._workspaces[thread]
        for start, stop in ranges:
            solve.backward(store.plan, start, stop, store.kept, w, *workspace)
