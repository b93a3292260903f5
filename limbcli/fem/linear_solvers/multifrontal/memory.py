"""Memory layout of the update matrices, which are live from their own front to the parent's."""

from __future__ import annotations

import numpy as np

from limbcli.fem.linear_solvers.multifrontal.sharing import WorkShares
from limbcli.model import IntArray


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
    """Offset of each front's update matrix, and the total size; subtrees get separate memory."""
    children: list[list[int]] = [[] for _ in parent]
    for s, up in enumerate(parent):
        if up >= 0:
            children[up].append(s)
    at = np.zeros(len(parent), dtype=np.int64)
    pieces = Pieces()
    base = 0
    kept = []
    for first, stop in shares.subtrees:
        pieces = Pieces(base)
        for s in range(first, stop):
            _place(s, at, sizes, children, pieces)
        base = pieces.size
        kept.append(stop - 1)
    pieces = Pieces(base)
    pieces.free = _between(sorted((int(at[s]), int(sizes[s])) for s in kept if sizes[s]), base)
    for s in shares.top:
        _place(int(s), at, sizes, children, pieces)
    return at, pieces.size


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
