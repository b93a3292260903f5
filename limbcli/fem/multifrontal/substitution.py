"""Right-hand sides through a factor: subtrees on two threads, what is above them on one."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from limbcli.fem.multifrontal import solve
from limbcli.fem.multifrontal.plan import Layout
from limbcli.fem.multifrontal.sharing import Crew
from limbcli.fem.multifrontal.store import Store


class Substitution:
    """Each of two threads adds what its subtrees pass on to a vector of its own."""

    def __init__(self, layout: Layout, store: Store, crew: Crew):
        self.store, self.crew, self.layout = store, crew, layout
        shares = layout.solving
        self._mine = [
            [each for each, k in zip(shares.subtrees, shares.owner, strict=True) if k == thread]
            for thread in range(2)
        ]
        self._top = [(int(s), int(s) + 1) for s in shares.top[:-1]]  # the last front is the root's
        self._of_second = np.zeros(len(layout.order), dtype=bool)
        pivot_at = layout.plan.pivot_at
        for start, stop in self._mine[1]:
            self._of_second[pivot_at[start] : pivot_at[stop]] = True
        self._rooms: list[Any] = []

    def enter(self, rhs: Any) -> Any:
        """Right-hand sides in the order of elimination, scaled."""
        w = np.empty(rhs.shape, dtype=self.store.kind)
        if rhs.ndim == 1:
            solve.enter(self.layout.order, self.store.scaling, rhs, w)
        else:
            w[:] = (rhs * self.store.scaling[:, None])[self.layout.order]
        return w

    def leave(self, w: Any) -> Any:
        """Solutions by equation number, unscaled."""
        out = np.empty(w.shape)
        if w.ndim == 1:
            solve.leave(self.layout.order, self.store.scaling, w, out)
        else:
            out[self.layout.order] = w
            out *= self.store.scaling[:, None]
        return out

    def forward(self, w: Any) -> None:
        """All fronts but the root's."""
        other = np.zeros_like(w)
        other[self._of_second] = w[self._of_second]
        w[self._of_second] = 0
        rooms = self._get_rooms(w)
        tasks = [partial(self._forward, self._mine[k], each, rooms[k]) for k, each in enumerate((w, other))]
        self.crew.run(tasks)
        w += other
        self._forward(self._top, w, rooms[0])

    def backward(self, w: Any) -> None:
        """All fronts but the root's, whose part of w is known."""
        rooms = self._get_rooms(w)
        self._backward(self._top[::-1], w, rooms[0])
        self.crew.run([partial(self._backward, self._mine[k], w, rooms[k]) for k in range(2)])

    def _forward(self, ranges: list[tuple[int, int]], w: Any, room: Any) -> None:
        store = self.store
        for start, stop in ranges:
            if w.ndim == 1:
                solve.forward(store.plan, start, stop, store.panels, store.sign, w, room)
            else:
                solve.forward_many(store.blas, store.plan, start, stop, store.panels, store.sign, w, room)

    def _backward(self, ranges: list[tuple[int, int]], w: Any, room: Any) -> None:
        store = self.store
        for start, stop in ranges:
            if w.ndim == 1:
                solve.backward(store.plan, start, stop, store.panels, w, room)
            else:
                solve.backward_many(store.blas, store.plan, start, stop, store.panels, w, room)

    def _get_rooms(self, w: Any) -> list[Any]:
        size = self.layout.largest_front * (w.shape[1] if w.ndim > 1 else 1)
        if not self._rooms or len(self._rooms[0]) < size:
            self._rooms = [np.empty(size, dtype=self.store.kind) for _ in range(2)]
        return self._rooms
