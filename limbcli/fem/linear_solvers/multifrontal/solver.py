"""`Multifrontal`: factorisation and solution of matrices with one sparsity pattern."""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sparse
from threadpoolctl import ThreadpoolController

from limbcli.fem.linear_solvers.multifrontal import numeric, solve
from limbcli.fem.linear_solvers.multifrontal.compact_factor import PAD
from limbcli.fem.linear_solvers.multifrontal.factor_memory import Store
from limbcli.fem.linear_solvers.multifrontal.ordering import compress, order
from limbcli.fem.linear_solvers.multifrontal.plan import Layout, make_plan
from limbcli.fem.linear_solvers.multifrontal.root import Root
from limbcli.fem.linear_solvers.multifrontal.shared_fronts import Top
from limbcli.fem.linear_solvers.multifrontal.sharing import ThreadTeam
from limbcli.fem.linear_solvers.multifrontal.symbolic import analyse
from limbcli.fem.linear_solvers.multifrontal.tiles import TILE
from limbcli.fem.linear_solvers.singular import singular
from limbcli.model import Array, IntArray


class Multifrontal:
    """L S L^T factorisation of a symmetric matrix (upper triangle, CSR), S = diag(+-1).

    The pattern is analysed once. There is no pivoting; pivots close to zero are perturbed and counted. The
    matrix is scaled to a diagonal of +-1.

    single : factor in single precision, stored as 16-bit integers (`compact_factor`): an approximate inverse
        with an accuracy of 1e-4
    last : equation numbers to eliminate last, which form the root front; its part of the matrix can be
        changed after the factorisation (`update_root`)
    metis : order by nested dissection (METIS) if available; otherwise by minimum degree
    """

    def __init__(
        self,
        indptr: IntArray,
        indices: IntArray,
        *,
        threads: int = 2,
        single: bool = False,
        last: IntArray | None = None,
        metis: bool = True,
    ):
        self.name = "multifrontal LDL" + (" (single precision)" if single else "")
        self.n = len(indptr) - 1
        self._indptr, self._indices = (np.ascontiguousarray(a, dtype=np.int64) for a in (indptr, indices))
        self.layout = _layout(self._indptr, self._indices, last, metis)
        self._store = Store(self.layout, self.n, len(indices), single)
        self._team = ThreadTeam(min(threads, 2))
        self._blas_threads = ThreadpoolController().select(user_api="blas")
        self._top = Top(self._store, self._team)
        self._root = Root(self._store, self._top, self.layout.order, kept=last is not None and len(last) > 0)
        self._substitution = Substitution(self.layout, self._store, self._team)
        self._made_up = 0
        self.n_factorisations = 0

    # ------------------------------------------------------------ factor

    def factor(self, values: Array) -> None:
        """Factor the matrix with these CSR values; the root front is factored when it is needed."""
        with self._blas_threads.limit(limits=1):
            self._scale(np.ascontiguousarray(values, dtype=float))
            self._made_up = self._factor_subtrees() + self._factor_top()
            self._top.gather(self._root.front, self._root.panel)
            self._root.gathered()
        self.n_factorisations += 1

    def _scale(self, values: Array) -> None:
        """Scale the matrix to a diagonal of +-1 and convert it to the factor's precision."""
        store, matrix = self._store, (self._indptr, self._indices, values)
        middle = int(np.searchsorted(self._indptr, len(self._indices) // 2))
        halves = [(a, b) for a, b in ((0, middle), (middle, self.n)) if b > a]
        scaling = np.empty(self.n)
        self._team.run([partial(numeric.scales, *matrix, a, b, scaling) for a, b in halves])
        if not scaling.all():
            numeric.scales_of_others(*matrix, scaling)
        store.scaling = scaling
        self._team.run([partial(numeric.scale, *matrix, scaling, a, b, store.values) for a, b in halves])

    def _factor_subtrees(self) -> int:
        store = self._store
        plans = [store.plan._replace(update_at=each) for each in self.layout.update_at]
        workspaces = deque(zip(plans, store.panels, store.inverses, store.work, strict=True))

        def run(start: int, stop: int) -> int:
            workspace = plan, panel, inverse, work = workspaces.pop()
            made_up = numeric.factor_subtree(
                store.blas, plan, start, stop, store.values,
                panel, store.updates, store.kept, store.sign, store.tiny, inverse, work,
            )  # fmt: skip
            workspaces.append(workspace)
            return int(made_up)

        found = self._team.run([partial(run, a, b) for a, b in self.layout.factoring.subtrees])
        if min(found, default=0) < 0:
            raise singular("an entry is not finite")
        return sum(found)

    def _factor_top(self) -> int:
        made_up = 0
        panel = self._store.panels[0]
        for s in map(int, self.layout.factoring.top[:-1]):
            self._top.gather(s, panel)
            found = self._top.factor(s, panel)
            if found < 0:
                raise singular("an entry is not finite")
            made_up += found
            self._top.update(s, panel)
            self._top.keep(s, panel, self._store.kept)
        return made_up

    # ------------------------------------------------------------ solve

    def solve(self, rhs: Array) -> Array:
        """Solution (n,) for a right-hand side (n,)."""
        self._finish()
        w = self._substitution.enter(np.ascontiguousarray(rhs, dtype=float))
        self._substitution.forward(w)
        self._root.solve(w)
        self._substitution.backward(w)
        x = self._substitution.leave(w)
        if not np.isfinite(x).all():
            raise singular("the solution is not finite")
        return x

    def _finish(self) -> None:
        """Factor the root front if this has not been done."""
        if not self._root.is_factored:
            with self._blas_threads.limit(limits=1):
                self._root.factor()

    # ------------------------------------------------------------ root

    @property
    def root(self) -> IntArray:
        """Equation numbers of the root front, in its order; none if `last` named none."""
        return self._root.equations if self._root.is_kept else self._root.equations[:0]

    @property
    def schur(self) -> Array:
        """Schur complement of the root's equations, (n_root, n_root), without any `update_root`."""
        return self._root.schur()

    def update_root(self, addition: sparse.sparray | None) -> None:
        """Factor `schur + addition` (None: `schur`), in the order of `root`."""
        with self._blas_threads.limit(limits=1):
            self._root.update(addition)

    # ------------------------------------------------------------ figures

    @property
    def n_perturbed(self) -> int:
        """Number of perturbed pivots in the last factor."""
        self._finish()
        return self._made_up + self._root.made_up

    @property
    def n_negative(self) -> int:
        """Number of negative pivots of the last factor, not counting the root front's."""
        return int(np.count_nonzero(np.signbit(self._store.sign[: self._root.first])))

    @property
    def solves_per_factor(self) -> float:
        """Cost of a factorisation in solves, from its operation count: about half of the measured ratio.

        A formula rather than a measured time, so that a model is always solved in the same way; the constants
        in `linearised` were tuned with this formula.
        """
        return 14.0 + self.layout.flops / 8e9

    def close(self) -> None:
        self._team.close()


def _layout(indptr: IntArray, indices: IntArray, last: IntArray | None, metis: bool) -> Layout:
    last = np.zeros(0, dtype=np.int64) if last is None else np.unique(np.asarray(last, dtype=np.int64))
    graph = compress(indptr, indices, last)
    is_last = np.zeros(len(indptr) - 1, dtype=bool)
    is_last[last] = True
    mask = is_last[graph.members[graph.members_at[:-1]]]
    fronts = analyse(graph, order(graph, mask, metis=metis), int(mask.sum()))
    return make_plan(graph, fronts, indptr, indices)


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
