"""A direct solver of a matrix that gains entries from one factor to the next.

Surfaces that slide on each other couple ever other nodes. The pattern grows by these entries: it is analysed
anew, which costs about as much as a factor, only where an entry has no place yet.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sparse

from limbcli.fem.linear_solvers.direct import LinearSolver
from limbcli.model import Array, IntArray

Make = Callable[[IntArray, IntArray], LinearSolver]


class GrowingPatternSolver:
    """The solver that `make(indptr, indices)` gives, for the pattern so far; its attributes are passed on.

    n_analyses : how often it was made
    """

    def __init__(self, indptr: IntArray, indices: IntArray, make: Make):
        self._make, self.n_analyses = make, 1
        n = len(indptr) - 1
        self._n = n
        self._first = np.repeat(np.arange(n), np.diff(indptr)) * n + indices  # of the entries that always are
        self._keys, self._solver = self._first, make(indptr, indices)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self._solver, name)

    def factor(self, values: Array, further: sparse.csr_array) -> None:
        """Factor the first pattern's values plus the upper triangle of a symmetric matrix."""
        more = sparse.triu(further, format="coo")
        keys = more.row.astype(np.int64) * self._n + more.col
        if not np.isin(keys, self._keys, assume_unique=False).all():
            self._grow(keys)
        every = np.zeros(len(self._keys))
        every[np.searchsorted(self._keys, self._first)] = values
        np.add.at(every, np.searchsorted(self._keys, keys), more.data)
        self._solver.factor(every)

    def _grow(self, keys: IntArray) -> None:
        self._keys = np.union1d(self._keys, keys)
        row, column = np.divmod(self._keys, self._n)
        before, indptr = self._solver, np.searchsorted(row, np.arange(self._n + 1))
        self._solver = self._make(indptr, column)
        self._solver.n_factorisations += before.n_factorisations
        before.close()
        self.n_analyses += 1
