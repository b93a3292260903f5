"""Symbolic factorisation: columns are grouped into supernodes (fronts), small ones merged into larger ones.

All indices refer to vertices in elimination order; `plan` translates them to equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.fem.linear_solvers.multifrontal.ordering import Graph, positions
from limbcli.fem.linear_solvers.multifrontal.pivot_order import longer_runs
from limbcli.model import IntArray
from limbcli.numbers.compiled import njit


@dataclass(frozen=True, eq=False)
class Fronts:
    """The assembly tree, children before parents.

    order : vertices in the final elimination order
    start (n + 1,) : start of each front's pivots in `order`
    parent (n,) : -1 for a root
    rows_at (n + 1,), rows : positions (in the order) of the rows below each front's pivots, ascending
    """

    order: IntArray
    start: IntArray
    parent: IntArray
    rows_at: IntArray
    rows: IntArray

    @property
    def n(self) -> int:
        return len(self.parent)


def analyse(graph: Graph, order: IntArray, n_last: int) -> Fronts:
    """Fronts for an elimination order; the `n_last` last vertices are the pivots of the last front."""
    place = positions(order)
    at, rows, parent = _structure(graph.indptr, graph.indices, order, place, graph.n - n_last)
    weights = graph.weights[order].astype(np.float64)
    head, top = _supernodes(at, rows, parent, weights, graph.n - n_last)
    return _renumber(order, at, rows, head, top, n_last)


@njit
def _structure(indptr, indices, order, place, n_inner):  # type: ignore[no-untyped-def]
    """Rows below the diagonal of each column of the factor, unsorted, and the elimination tree.

    Columns from n_inner on are treated as dense: in the tree they form a chain, and no rows are listed.
    """
    n = len(order)
    parent = np.full(n, -1, dtype=np.int64)
    child = np.full(n, -1, dtype=np.int64)
    sibling = np.full(n, -1, dtype=np.int64)
    at = np.zeros(n + 1, dtype=np.int64)
    rows = np.empty(4 * len(indices) + n + 1024, dtype=np.int32)
    stamp = np.full(n, -1, dtype=np.int64)
    size = 0
    for j in range(n_inner):
        if size + n > len(rows):
            more = np.empty(2 * len(rows) + n, dtype=np.int32)
            for k in range(size):
                more[k] = rows[k]
            rows = more
        stamp[j] = j
        low = n
        v = order[j]
        for k in range(indptr[v], indptr[v + 1]):
            i = place[indices[k]]
            if i > j and stamp[i] != j:
                stamp[i] = j
                rows[size] = i
                size += 1
                low = min(low, i)
        c = child[j]
        while c >= 0:
            for k in range(at[c], at[c + 1]):
                i = rows[k]
                if stamp[i] != j:
                    stamp[i] = j
                    rows[size] = i
                    size += 1
                    low = min(low, i)
            c = sibling[c]
        at[j + 1] = size
        if low < n:
            parent[j] = low
            sibling[j] = child[low]
            child[low] = j
    for j in range(n_inner, n):
        at[j + 1] = size
        parent[j] = j + 1 if j + 1 < n else -1
    return at, rows[:size].copy(), parent


@njit
def cost(p, m):  # type: ignore[no-untyped-def]
    """Estimated time (s) of a front of p pivots and m rows: call overhead, memory traffic, arithmetic."""
    r = m - p
    work = p * p * p / 3.0 + p * p * r + p * r * r
    return 4e-6 + 1.5e-10 * p * m + 3e-10 * r * r + work * (1.0 + 24.0 / p) / 1.1e11


@njit
def _supernodes(at, rows, parent, weights, n_inner):  # type: ignore[no-untyped-def]
    """The head column of each column's supernode (itself for a head), and the parent of each head.

    First columns with the same rows are merged (fundamental supernodes), then children whose merging saves
    time although it adds explicit zeros.
    """
    n = len(weights)
    head = np.arange(n)
    below = np.zeros(n)
    for j in range(n_inner):
        for k in range(at[j], at[j + 1]):
            below[j] += weights[rows[k]]
    pivots = weights.copy()
    for j in range(n_inner):  # fundamental supernodes: merge a child with the same rows into its parent
        up = parent[j]
        if 0 <= up < n_inner and at[j + 1] - at[j] == at[up + 1] - at[up] + 1 and pivots[up] == weights[up]:
            head[j] = up
            pivots[up] += pivots[j]
    if n_inner < n:
        for j in range(n_inner, n - 1):
            pivots[n - 1] += pivots[j]
            head[j] = n - 1
    for j in range(n - 1, -1, -1):
        head[j] = head[head[j]]
    top = np.full(n, -1, dtype=np.int64)
    for j in range(n):
        if head[j] == j and parent[j] >= 0:
            top[j] = head[parent[j]]
    child = np.full(n, -1, dtype=np.int64)
    sibling = np.full(n, -1, dtype=np.int64)
    for s in range(n):
        if head[s] != s:
            continue
        if s < n_inner:
            _absorb(s, child, sibling, pivots, below, head, top)
        if top[s] >= 0:
            sibling[s] = child[top[s]]
            child[top[s]] = s
    for j in range(n - 1, -1, -1):
        head[j] = head[head[j]]
    for s in range(n):
        if head[s] == s and top[s] >= 0:
            top[s] = head[top[s]]
    return head, top


@njit
def _absorb(s, child, sibling, pivots, below, head, top):  # type: ignore[no-untyped-def]
    """Merge children into front s, the largest saving first, as long as it reduces the estimated time."""
    while True:
        best, gain, before = -1, 0.0, -1
        last = -1
        c = child[s]
        while c >= 0:
            apart = cost(pivots[s], pivots[s] + below[s]) + cost(pivots[c], pivots[c] + below[c])
            p = pivots[s] + pivots[c]
            saved = apart - cost(p, p + below[s])
            if saved > gain:
                best, gain, before = c, saved, last
            last = c
            c = sibling[c]
        if best < 0:
            return
        if before < 0:
            child[s] = sibling[best]
        else:
            sibling[before] = sibling[best]
        c = child[best]  # its children become those of s
        while c >= 0:
            after = sibling[c]
            top[c] = s
            sibling[c] = child[s]
            child[s] = c
            c = after
        head[best] = s
        pivots[s] += pivots[best]


def _renumber(
    order: IntArray, at: IntArray, rows: IntArray, head: IntArray, top: IntArray, n_last: int
) -> Fronts:
    """Fronts in postorder, with the final positions of their rows."""
    n = len(order)
    heads = np.flatnonzero(head == np.arange(n))
    parent = top[heads]
    number = np.full(n + 1, -1)
    number[heads] = np.arange(len(heads))
    post = _postorder(np.where(parent < 0, -1, number[parent]))
    rank = positions(post)
    front_of = rank[number[head]]
    fresh = np.argsort(front_of, kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(front_of, minlength=len(heads)))])
    up = np.where(parent < 0, -1, rank[np.where(parent < 0, 0, number[parent])])[post]
    tops = heads[post]
    rows_at = np.concatenate([[0], np.cumsum(at[tops + 1] - at[tops])])
    below = np.concatenate([rows[at[j] : at[j + 1]] for j in tops])
    fresh = fresh[longer_runs(start, rows_at, _sorted(rows_at, positions(fresh)[below]))]
    return Fronts(order[fresh], start, up, rows_at, _sorted(rows_at, positions(fresh)[below]))


def _sorted(at, rows):  # type: ignore[no-untyped-def]
    """The rows of each front in order; sorted all at once, in keys that begin with the front's number."""
    first = np.repeat(np.arange(len(at) - 1), np.diff(at)) * (rows.max(initial=0) + 1)
    return np.sort(first + rows) - first


@njit
def _postorder(parent):  # type: ignore[no-untyped-def]
    """Postorder: children before parents, each subtree contiguous; the last root stays last."""
    n = len(parent)
    child = np.full(n + 1, -1, dtype=np.int64)
    sibling = np.full(n, -1, dtype=np.int64)
    for s in range(n - 1, -1, -1):
        up = parent[s] if parent[s] >= 0 else n
        sibling[s] = child[up]
        child[up] = s
    out = np.empty(n, dtype=np.int64)
    stack = np.empty(n + 1, dtype=np.int64)
    depth, size = 0, 0
    stack[0] = n
    while depth >= 0:
        s = stack[depth]
        if child[s] >= 0:
            c = child[s]
            child[s] = sibling[c]
            depth += 1
            stack[depth] = c
        else:
            if s < n:
                out[size] = s
                size += 1
            depth -= 1
    return out
