"""Data layout of the factorisation: fronts in terms of equations, index maps, memory, division of work.

Computed once per pattern and read by the compiled loops over the fronts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from limbcli.fem.linear_solvers.multifrontal.compact_factor import sizes as kept_sizes
from limbcli.fem.linear_solvers.multifrontal.dense import ALIGNED
from limbcli.fem.linear_solvers.multifrontal.ordering import Graph, positions
from limbcli.fem.linear_solvers.multifrontal.sharing import WorkShares, share_for_two, share_top_alone
from limbcli.fem.linear_solvers.multifrontal.symbolic import Fronts, cost
from limbcli.model import IntArray
from limbcli.numbers.compiled import njit

_GRAIN = 0.12  # largest subtree given to one thread, as a fraction of the total work


class Plan(NamedTuple):
    """Index arrays of the fronts.

    Front s has pivots pivot_at[s]..pivot_at[s + 1] and, below them, rows rows[rows_at[s]..rows_at[s + 1]],
    all as positions in the elimination order. Its panel (m, p) has leading dimension ld[s] and is stored in
    tiles and parts from tile_at[s], part_at[s] (see `compact_factor`); its update matrix (m - p, m - p),
    lower triangle, starts at update_at[s] with leading dimension ldu[s].

    into : position of each row in the parent's front
    run_at, runs : within the rows of a front, where runs of consecutive `into` start
    child_at, children : fronts whose update matrices are assembled into a front
    column_at : for each pivot, its range in entry_from (matrix values) and entry_to (panel indices)
    """

    pivot_at: IntArray
    rows_at: IntArray
    rows: IntArray
    into: IntArray
    run_at: IntArray
    runs: IntArray
    tile_at: IntArray
    part_at: IntArray
    ld: IntArray
    update_at: IntArray
    ldu: IntArray
    child_at: IntArray
    children: IntArray
    column_at: IntArray
    entry_to: IntArray
    entry_from: IntArray


class Layout(NamedTuple):
    """A plan with elimination order (equation numbers), sizes, and division of work between threads.

    update_at (2, n) : the plan's `update_at` for each of two threads
    panel_size : size of the largest panel, the last front's excluded
    """

    plan: Plan
    update_at: IntArray
    order: IntArray
    parent: IntArray
    panel_size: int
    update_size: int
    largest_front: int
    largest_panel: int
    flops: float
    factoring: WorkShares
    solving: WorkShares


def make_plan(graph: Graph, fronts: Fronts, indptr: IntArray, indices: IntArray) -> Layout:
    """The layout of the factor of a matrix (upper triangle, CSR) for given fronts."""
    equations, at = _expand(graph, fronts.order)
    pivot_at = at[fronts.start]
    rows_at, rows = _rows(fronts.rows_at, fronts.rows, at)
    p, r = np.diff(pivot_at), np.diff(rows_at)
    into, run_at, runs = _maps(pivot_at, rows_at, rows, fronts.parent)
    ld, ldu = _round_up(p + r), _round_up(r)
    tile_at, part_at = (np.concatenate([[0], np.cumsum(each)]) for each in kept_sizes(p, p + r))
    by_parent = np.argsort(fronts.parent, kind="stable")
    n_roots = int((fronts.parent < 0).sum())
    counts = np.bincount(fronts.parent[fronts.parent >= 0], minlength=fronts.n)
    child_at = np.concatenate([[0], np.cumsum(counts)])
    column_at, entry_to, entry_from = _entries(
        indptr, indices, positions(equations), pivot_at, rows_at, rows, ld
    )
    seconds = cost(p.astype(float), (p + r).astype(float))
    factoring = share_for_two(fronts.parent, seconds, largest=_GRAIN)
    solving = share_top_alone(fronts.parent, (p * (p + r) - p * p / 2).astype(float) + 300.0)
    update_at, update_size = place_updates(fronts.parent, ldu * r, factoring)
    plan = Plan(
        pivot_at, rows_at, rows, into, run_at, runs, tile_at, part_at, ld, update_at[0], ldu,
        child_at, by_parent[n_roots:], column_at, entry_to, entry_from,
    )  # fmt: skip
    pf, rf = p.astype(float), r.astype(float)
    flops = float((pf**3 / 3 + pf * pf * rf + pf * rf * rf).sum())
    largest = int((p + r).max(initial=1))
    return Layout(
        plan, update_at, equations, fronts.parent, int((ld * p)[:-1].max(initial=1)), update_size, largest,
        int(p.max(initial=1)), flops, factoring, solving,
    )  # fmt: skip


def _round_up(n: IntArray) -> IntArray:
    return (n + ALIGNED - 1) // ALIGNED * ALIGNED


def _expand(graph: Graph, order: IntArray) -> tuple[IntArray, IntArray]:
    """Equations in the order of the vertices, and the start of each vertex's equations."""
    at = np.concatenate([[0], np.cumsum(graph.weights[order])])
    first = np.repeat(graph.members_at[:-1][order], graph.weights[order])
    within = np.arange(at[-1]) - np.repeat(at[:-1], graph.weights[order])
    return graph.members[first + within], at


@njit
def _rows(vertex_at, vertices, at):  # type: ignore[no-untyped-def]
    rows_at = np.zeros(len(vertex_at), dtype=np.int64)
    size = 0
    for s in range(len(vertex_at) - 1):
        for k in range(vertex_at[s], vertex_at[s + 1]):
            size += at[vertices[k] + 1] - at[vertices[k]]
        rows_at[s + 1] = size
    rows = np.empty(size, dtype=np.int32)
    size = 0
    for v in vertices:
        for e in range(at[v], at[v + 1]):
            rows[size] = e
            size += 1
    return rows_at, rows


@njit
def _maps(pivot_at, rows_at, rows, parent):  # type: ignore[no-untyped-def]
    n = len(parent)
    into = np.empty(len(rows), dtype=np.int32)
    run_at = np.zeros(n + 1, dtype=np.int64)
    runs = np.empty(len(rows) + n, dtype=np.int32)
    size = 0
    for s in range(n):
        up = parent[s]
        if rows_at[s + 1] > rows_at[s]:
            k = rows_at[up]
            first, stop = pivot_at[up], pivot_at[up + 1]
            before = -2
            for e in range(rows_at[s], rows_at[s + 1]):
                if rows[e] < stop:
                    to = rows[e] - first
                else:
                    while rows[k] != rows[e]:
                        k += 1
                    to = stop - first + k - rows_at[up]
                into[e] = to
                if to != before + 1:
                    runs[size] = e - rows_at[s]
                    size += 1
                before = to
        run_at[s + 1] = size
    return into, run_at, runs[:size].copy()


@njit
def _entries(indptr, indices, place, pivot_at, rows_at, rows, ld):  # type: ignore[no-untyped-def]
    n = len(place)
    front = np.empty(n, dtype=np.int64)
    for s in range(len(pivot_at) - 1):
        front[pivot_at[s] : pivot_at[s + 1]] = s
    column_at = np.zeros(n + 1, dtype=np.int64)
    for i in range(n):
        for k in range(indptr[i], indptr[i + 1]):
            column_at[min(place[i], place[indices[k]]) + 1] += 1
    column_at = np.cumsum(column_at)
    at = column_at[:-1].copy()
    entry_to = np.empty(len(indices), dtype=np.int32)
    entry_from = np.empty(len(indices), dtype=np.int32)
    for i in range(n):
        for k in range(indptr[i], indptr[i + 1]):
            a, b = place[i], place[indices[k]]
            column, row = min(a, b), max(a, b)
            s = front[column]
            if row < pivot_at[s + 1]:
                local = row - pivot_at[s]
            else:
                low = rows_at[s] + np.searchsorted(rows[rows_at[s] : rows_at[s + 1]], row)
                local = pivot_at[s + 1] - pivot_at[s] + low - rows_at[s]
            entry_to[at[column]] = local + ld[s] * (column - pivot_at[s])
            entry_from[at[column]] = k
            at[column] += 1
    return column_at, entry_to, entry_from


class Pieces:
    """First-fit memory allocator; `size` is the largest extent needed so far."""

    def __init__(self, base: int = 0):
        self.free: list[tuple[int, int]] = []
        self.size = base

    def take(self, n: int) -> int:
        for k, (at, size) in enumerate(self.free):
            if size >= n:
                if size == n:
                    del self.free[k]
                else:
                    self.free[k] = (at + n, size - n)
                return at
        if self.free and sum(self.free[-1]) == self.size:
            at, _ = self.free.pop()
        else:
            at = self.size
        self.size = at + n
        return at

    def give(self, at: int, n: int) -> None:
        if n == 0:
            return
        self.free.append((at, n))
        self.free.sort()
        joined = self.free[:1]
        for start, size in self.free[1:]:
            if sum(joined[-1]) == start:
                joined[-1] = (joined[-1][0], joined[-1][1] + size)
            else:
                joined.append((start, size))
        self.free = joined


def place_updates(parent: IntArray, sizes: IntArray, shares: WorkShares) -> tuple[IntArray, int]:
    """Offset of each front's update matrix for each of two threads (2, n), and the total size.

    A subtree works in the memory of its thread, which the next one uses again; only the update matrix of its
    last front is kept for the top.
    """
    children: list[list[int]] = [[] for _ in parent]
    for s, up in enumerate(parent):
        if up >= 0:
            children[up].append(s)
    at = np.zeros(len(parent), dtype=np.int64)
    within = np.zeros(len(parent), dtype=bool)
    share = 0
    for first, stop in shares.subtrees:
        pieces = Pieces()
        for s in range(first, stop - 1):
            _place(s, at, sizes, children, pieces)
        within[first : stop - 1] = True
        share = max(share, pieces.size)
    size, kept = 2 * share, []
    for _, stop in shares.subtrees:
        at[stop - 1] = size
        kept.append((size, int(sizes[stop - 1])))
        size += int(sizes[stop - 1])
    pieces = Pieces(size)
    pieces.free = _between(kept, size)
    for s in shares.top:
        _place(int(s), at, sizes, children, pieces)
    return np.stack([at, at + np.where(within, share, 0)]), pieces.size


def _place(s: int, at: IntArray, sizes: IntArray, children: list[list[int]], pieces: Pieces) -> None:
    at[s] = pieces.take(int(sizes[s]))
    for c in children[s]:
        pieces.give(int(at[c]), int(sizes[c]))


def _between(taken: list[tuple[int, int]], size: int) -> list[tuple[int, int]]:
    free, at = [], 0
    for start, n in taken:
        if start > at:
            free.append((at, start - at))
        at = start + n
    if size > at:
        free.append((at, size - at))
    return free
