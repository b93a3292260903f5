"""Division of work: subtrees of the assembly tree in parallel, and the fronts above them one at a time."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from limbcli.model import Array, IntArray

_UNEVEN = 0.05  # allowed load of one thread above the mean, as a fraction of the mean
_MANY = 48  # maximum number of subtrees


class WorkShares(NamedTuple):
    """A cut through the assembly tree.

    subtrees : (first, stop) ranges of fronts, costliest first
    owner : thread of each subtree
    top : fronts above the cut
    """

    subtrees: list[tuple[int, int]]
    owner: list[int]
    top: IntArray


def share_for_two(parent: IntArray, cost: Array, *, largest: float) -> WorkShares:
    """Cut the tree (in postorder) at the highest level that balances two threads below the cut.

    The cut is for two threads even if there is only one, so that sums are formed in the same order. The last
    front is always above the cut.

    largest : largest cost of one subtree, as a fraction of the total cost
    """
    limit = largest * cost.sum()
    for pieces, _, load in _cuts(parent, cost):
        biggest = -min(pieces)[0] if pieces else 0.0
        if max(load) <= (1 + _UNEVEN) * sum(load) / 2 and biggest <= limit:
            break
    return _shares(parent, pieces)


def share_top_alone(parent: IntArray, cost: Array) -> WorkShares:
    """The cut with the shortest time if a single thread processes all fronts above it."""
    best = min(_cuts(parent, cost), key=lambda cut: cut[1] + max(cut[2]))
    return _shares(parent, best[0])


Pieces = list[tuple[float, int]]


def _cuts(parent: IntArray, cost: Array) -> Iterator[tuple[Pieces, float, list[float]]]:
    """Successively deeper cuts: subtrees (negative cost, front), cost above them, load of each thread."""
    n = len(parent)
    total = cost.copy()
    children: list[list[int]] = [[] for _ in range(n)]
    for s in range(n):
        if parent[s] >= 0:
            total[parent[s]] += total[s]
            children[parent[s]].append(s)
    heap = [(-total[s], s) for s in range(n - 1) if parent[s] < 0 or parent[s] == n - 1]
    heapq.heapify(heap)
    above = float(cost[n - 1])
    while True:
        pieces = sorted(heap)
        yield pieces, above, _loads([-c for c, _ in pieces])[0]
        if not heap or len(heap) >= _MANY or not children[heap[0][1]]:
            return
        _, biggest = heapq.heappop(heap)
        above += cost[biggest]
        for c in children[biggest]:
            heapq.heappush(heap, (-total[c], c))


def _shares(parent: IntArray, pieces: Pieces) -> WorkShares:
    size = np.ones(len(parent), dtype=np.int64)
    for s, up in enumerate(parent):
        if up >= 0:
            size[up] += size[s]
    ranges = [(int(s - size[s] + 1), s + 1) for _, s in pieces]
    above = np.ones(len(parent), dtype=bool)
    for first, stop in ranges:
        above[first:stop] = False
    _, owner = _loads([-c for c, _ in pieces])
    return WorkShares(ranges, owner, np.flatnonzero(above))


def _loads(costs: Sequence[float]) -> tuple[list[float], list[int]]:
    load: list[float] = [0.0, 0.0]
    owner: list[int] = []
    for each in costs:
        k = int(np.argmin(load))
        load[k] += each
        owner.append(k)
    return load, owner


class ThreadTeam:
    """Threads, including the caller's, that process a list of tasks until it is empty."""

    def __init__(self, threads: int):
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None
        self._helpers = max(threads - 1, 0)

    def run(self, tasks: Sequence[Callable[[], Any]]) -> list[Any]:
        """Run the tasks, started in order; returns their results."""
        results: list[Any] = [None] * len(tasks)
        if self._pool is None or len(tasks) < 2:
            return [task() for task in tasks]
        waiting = deque(enumerate(tasks))

        def work() -> None:
            while True:
                try:
                    k, task = waiting.popleft()
                except IndexError:
                    return
                results[k] = task()

        helpers = [self._pool.submit(work) for _ in range(min(self._helpers, len(tasks) - 1))]
        work()
        for each in helpers:
            each.result()
        return results

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=False)
