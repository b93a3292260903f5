"""Order of the pivots within a front, chosen so that the rows of its descendants are contiguous.

The arithmetic is the same for any order of a front's own pivots; keeping together the pivots that are updated
by the same descendants gives long contiguous runs when update matrices are added.
"""

from __future__ import annotations

import numpy as np

from limbcli.model import IntArray
from limbcli.numbers.compiled import njit


def longer_runs(start: IntArray, rows_at: IntArray, rows: IntArray) -> IntArray:
    """Old positions in the new order: each front's pivots are successively split by its descendants' rows.

    start, rows_at, rows : as in `Fronts`; the descendants with the most rows are used first
    """
    widest = np.argsort(-np.diff(rows_at), kind="stable")
    return _refine(start, rows_at, rows, widest)


@njit
def _refine(start, rows_at, rows, widest):  # type: ignore[no-untyped-def]
    n = start[-1]
    order = np.arange(n)
    group = np.zeros(n, dtype=np.int64)  # first position of the group that a position belongs to
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


@njit
def _split(first, stop, order, group, hit, held):  # type: ignore[no-untyped-def]
    """Split each group of the positions first..stop into those marked in `hit` and the others."""
    before = False  # whether the preceding part consists of marked positions
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
