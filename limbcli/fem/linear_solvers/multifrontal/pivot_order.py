"""The order of the pivots within a front, such that the rows of the fronts below lie side by side.

Any order of a front's own pivots costs the same arithmetic; the one that keeps together
what the same descendants reach makes for long runs where update matrices are added.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from limbcli.model import IntArray


def longer_runs(start: IntArray, rows_at: IntArray, rows: IntArray) -> IntArray:
    """Old places in their new order: within each front split again and again by who reaches what.

    start, rows_at, rows : as in `Fronts`; widest fronts split first
    """
    widest = np.argsort(-np.diff(rows_at), kind="stable")
    return _refine(start, rows_at, rows, widest)


@njit(cache=True)
def _refine(start, rows_at, rows, widest):  # type: ignore[no-untyped-def]
    n = start[-1]
    order = np.arange(n)
    group = np.zeros(n, dtype=np.int64)  # first place of the group that a place belongs to
    for s in range(len(start) - 1):
        group[start[s] : start[s + 1]] = start[s]
    front = np.empty(n, dtype=np.int64)
    for s in range(len(start) - 1):
        front[start[s] : start[s + 1]] = s
    hit = np.zeros(n, dtype=np.bool_)
    held = np.empty(n, dtype=np.int64)
    for c in widest:
        k = rows_at[c]
        while k < rows_at[c + 1]:
            s = front[rows[k]]
            stop = k
            while stop < rows_at[c + 1] and front[rows[stop]] == s:
                hit[rows[stop]] = True
                stop += 1
            _split(start[s], start[s + 1], order, group, hit, held)
            for j in range(k, stop):
                hit[rows[j]] = False
            k = stop
    return order


@njit(cache=True)
def _split(first, stop, order, group, hit, held):  # type: ignore[no-untyped-def]
    """Each group of the places first..stop cut in those that are hit and those that are not."""
    before = False  # whether the last place was hit
    begin = first
    while begin < stop:
        end = begin + 1
        while end < stop and group[end] == begin:
            end += 1
        n_hit = 0
        for k in range(begin, end):
            n_hit += hit[order[k]]
        if 0 < n_hit < end - begin:
            hits = begin if before else end - n_hit
            others = begin + n_hit if before else begin
            at_hit, at_other = hits, others
            for k in range(begin, end):
                held[k] = order[k]
            for k in range(begin, end):
                if hit[held[k]]:
                    order[at_hit] = held[k]
                    at_hit += 1
                else:
                    order[at_other] = held[k]
                    at_other += 1
            cut = max(hits, others)
            for k in range(cut, end):
                group[k] = cut
            before = not before
        else:
            before = n_hit > 0
        begin = end
