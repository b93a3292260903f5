"""Factorisation of the fronts above the subtrees, each by two threads together."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from limbcli.fem.linear_solvers.multifrontal.compact_factor import CompactFactor, keep
from limbcli.fem.linear_solvers.multifrontal.dense import (
    ALIGNED,
    NOT_FINITE,
    factor_diagonal,
    form_update,
    reduce_block,
    solve_block,
)
from limbcli.fem.linear_solvers.multifrontal.factor_memory import BLOCK, Store
from limbcli.fem.linear_solvers.multifrontal.numeric import gather_panel, gather_update
from limbcli.fem.linear_solvers.multifrontal.sharing import ThreadTeam


class Top:
    """Factors single fronts, with the work split in two for any number of threads, so that sums agree."""

    def __init__(self, store: Store, team: ThreadTeam):
        self.team, self.store = team, store
        self.blas, self.sign, self.tiny, self.work = store.blas, store.sign, store.tiny, store.work
        self.inverse = store.inverses[0]

    def gather(self, s: int, panel: Any) -> None:
        """Assemble the panel of front s."""
        plan, store = self.store.plan, self.store
        p = int(plan.pivot_at[s + 1] - plan.pivot_at[s])
        r = int(plan.rows_at[s + 1] - plan.rows_at[s])
        edges = even_area(p, p + r)
        self.team.run(
            [partial(gather_panel, plan, s, a, b, store.values, panel, store.updates) for a, b in edges]
        )

    def factor(self, s: int, panel: Any) -> int:
        """Factor the assembled panel of front s; returns the number of perturbed pivots, or NOT_FINITE."""
        plan, made_up = self.store.plan, 0
        ld, first = int(plan.ld[s]), int(plan.pivot_at[s])
        p = int(plan.pivot_at[s + 1]) - first
        m = p + int(plan.rows_at[s + 1] - plan.rows_at[s])
        blas, sign, work, inverse = self.blas, self.sign, self.work, self.inverse
        for j0 in range(0, p, BLOCK):
            j1 = min(j0 + BLOCK, p)
            cut = min(max(_aligned((j0 + m) // 2), _aligned(j1)), m)

            def head(j0: int = j0, j1: int = j1, cut: int = cut) -> int:
                reduce_block(blas, panel, 0, ld, j0, j1, j0, cut, sign, first, work[0])
                found = factor_diagonal(blas, panel, 0, ld, j0, j1, sign, first, self.tiny, inverse, work[0])
                return int(found)

            def tail(j0: int = j0, j1: int = j1, cut: int = cut) -> int:
                reduce_block(blas, panel, 0, ld, j0, j1, cut, m, sign, first, work[1])
                return 0

            found = self.team.run([head, tail])[0] if j0 else head()
            if found < 0:
                return NOT_FINITE
            made_up += found
            cut = min(_aligned((j1 + m) // 2), m)
            self.team.run(
                [
                    partial(solve_block, blas, panel, 0, ld, j0, j1, a, b, sign, first, inverse, w)
                    for a, b, w in ((j1, cut, work[0]), (cut, m, work[1]))
                ]
            )
        return made_up

    def update(self, s: int, panel: Any) -> None:
        """Compute the update matrix of front s, including the contributions of its children."""
        plan, updates = self.store.plan, self.store.updates
        first = int(plan.pivot_at[s])
        p = int(plan.pivot_at[s + 1]) - first
        r = int(plan.rows_at[s + 1] - plan.rows_at[s])
        ld, u, ldu = (int(each[s]) for each in (plan.ld, plan.update_at, plan.ldu))

        def columns(a: int, b: int, work: Any) -> None:
            form_update(
                self.blas, panel, 0, ld, p, p + r, updates, u, ldu, a, b, BLOCK, self.sign, first, work
            )
            gather_update(plan, s, a, b, updates)

        edges = even_area(r, r)
        self.team.run([partial(columns, a, b, w) for (a, b), w in zip(edges, self.work, strict=False)])

    def keep(self, s: int, panel: Any, kept: CompactFactor, *, alone: bool = False) -> None:
        """Store the factored panel of front s in `kept`; alone : as its only front."""
        plan = self.store.plan
        first = int(plan.pivot_at[s])
        p = int(plan.pivot_at[s + 1]) - first
        m = p + int(plan.rows_at[s + 1] - plan.rows_at[s])
        where = (0, 0, 0) if alone else (int(plan.tile_at[s]), int(plan.part_at[s]), first)
        run = partial(keep, kept, *where, panel, 0, int(plan.ld[s]), p, m)
        self.team.run([partial(run, half) for half in range(2)])


def even_area(p: int, m: int) -> list[tuple[int, int]]:
    """Split the first p columns of a lower triangle of m rows into two ranges of equal area."""
    area = (p * m - p * p / 2) / 2
    cut = int(m - np.sqrt(max(m * m - 2 * area, 0.0)) + 0.5)
    cut = min(max(_aligned(cut), 0), p)
    return [(a, b) for a, b in ((0, cut), (cut, p)) if b > a]


def _aligned(row: int) -> int:
    return (row + ALIGNED - 1) // ALIGNED * ALIGNED
