"""From cells to a sparse matrix: equation numbers, fixed pattern, threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sparse
from numba import njit
from numpy.typing import NDArray

from limbcli.model import Array, IntArray


class Threads:
    """Splits a range over a few threads; kernels release the interpreter's lock."""

    def __init__(self, n: int):
        self.n = max(1, n)
        self._pool = ThreadPoolExecutor(self.n) if self.n > 1 else None

    def run(self, task: Callable[[int, int, int], Any], n_items: int) -> list[Any]:
        """task(worker, start, stop) over equal parts of range(n_items)."""
        if self._pool is None or n_items < 64:
            return [task(0, 0, n_items)]
        edges = np.linspace(0, n_items, self.n + 1).astype(int)
        futures = [self._pool.submit(task, k, int(edges[k]), int(edges[k + 1])) for k in range(self.n)]
        return [each.result() for each in futures]

    def run_halves(self, task: Callable[[int, int, int], Any], n_items: int) -> None:
        """The same over two halves, whatever the number of threads."""
        cut = n_items // 2
        if self._pool is None or n_items < 64:
            task(0, 0, cut)
            task(1, cut, n_items)
        else:
            other = self._pool.submit(task, 1, cut, n_items)
            task(0, 0, cut)
            other.result()

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=False)


def total(parts: list[Array]) -> Array:
    """What the threads added up, each into its own part, in one array: the first of them."""
    for each in parts[1:]:
        parts[0] += each
    return parts[0]


@dataclass(frozen=True, eq=False)
class Pattern:
    """Pairs of nodes with a block of the stiffness matrix, and its upper triangle in CSR.

    first (n_points + 1,), high (n_pairs,) : pairs by their lower node, in order, and the higher node of each
    slots (n_pairs, 3, 3) : place of a block's entry in the CSR values, or -1; sources : the other way round
    pairs : one array per list of cells given, (n_cells, n (n + 1) / 2): 2 * pair + swapped, for a <= b
        row by row of b
    """

    indptr: IntArray
    indices: IntArray
    slots: NDArray[np.int32]
    sources: IntArray
    first: IntArray
    high: NDArray[np.int32]
    pairs: tuple[NDArray[np.int32], ...]

    @property
    def n(self) -> int:
        return len(self.indptr) - 1

    def values(self, blocks: Array) -> Array:
        """Upper triangle of the unknowns' matrix from the blocks (n_pairs, 3, 3) of all pairs."""
        return np.take(blocks.ravel(), self.sources)

    def matrix(self, values: Array) -> sparse.csr_matrix:
        """The full symmetric matrix."""
        upper = sparse.csr_matrix((values, self.indices, self.indptr), shape=(self.n, self.n))
        return upper + sparse.triu(upper, 1, format="csr").T


def make_pattern(equations: IntArray, cell_lists: Sequence[IntArray]) -> Pattern:
    """Pattern of a matrix whose entries couple nodes that share a cell.

    equations (n_points, 3): equation number of each degree of freedom, -1 where it has none.
    """
    n_points = len(equations)
    codes = [_pair_codes(cells, n_points) for cells in cell_lists]
    keys = np.concatenate([low * n_points + high for low, high, _ in codes] or [np.zeros(0, dtype=np.int64)])
    unique, inverse = np.unique(keys, return_inverse=True)
    low, high = unique // max(n_points, 1), unique % max(n_points, 1)
    slots, indptr, indices = _slots(low, high, equations)
    sources = np.empty(len(indices), dtype=np.int64)
    kept = np.flatnonzero(slots.ravel() >= 0)
    sources[slots.ravel()[kept]] = kept
    first = np.searchsorted(low, np.arange(n_points + 1))
    pairs, at = [], 0
    for cells, (_, _, swapped) in zip(cell_lists, codes, strict=True):
        n_pairs = cells.shape[1] * (cells.shape[1] + 1) // 2
        size = len(cells) * n_pairs
        part = 2 * inverse[at : at + size] + swapped
        pairs.append(np.ascontiguousarray(part.reshape(len(cells), n_pairs), dtype=np.int32))
        at += size
    return Pattern(indptr, indices, slots, sources, first, high.astype(np.int32), tuple(pairs))


def _pair_codes(cells: IntArray, n_points: int) -> tuple[IntArray, IntArray, IntArray]:
    n = cells.shape[1]
    a = np.concatenate([np.arange(b + 1) for b in range(n)])
    b = np.concatenate([np.full(b + 1, b) for b in range(n)])
    first, second = cells[:, a].ravel(), cells[:, b].ravel()
    return np.minimum(first, second), np.maximum(first, second), (first > second).astype(np.int64)


def _slots(
    low: IntArray, high: IntArray, equations: IntArray
) -> tuple[NDArray[np.int32], IntArray, IntArray]:
    """Places of the blocks' entries, and the pattern; equations must ascend with their nodes."""
    n = int(equations.max()) + 1 if equations.size else 0
    slots = np.full((len(low), 3, 3), -1, dtype=np.int32)
    indptr = np.zeros(n + 1, dtype=np.int64)
    _count(low, high, equations, indptr)
    np.cumsum(indptr, out=indptr)
    indices = np.empty(indptr[-1], dtype=np.int64)
    _place(low, high, equations, indptr[:-1].copy(), indices, slots)
    return slots, indptr, indices


@njit(cache=True)
def _count(low, high, equations, indptr):  # type: ignore[no-untyped-def]
    """Entries of every row, one place further on."""
    for k in range(len(low)):
        for i in range(3):
            row = equations[low[k], i]
            for j in range(i if low[k] == high[k] else 0, 3):
                if row >= 0 and equations[high[k], j] >= 0:
                    indptr[row + 1] += 1


@njit(cache=True)
def _place(low, high, equations, at, indices, slots):  # type: ignore[no-untyped-def]
    """Columns row by row; pairs are sorted, so each row's come in order."""
    for k in range(len(low)):
        for i in range(3):
            row = equations[low[k], i]
            for j in range(i if low[k] == high[k] else 0, 3):
                column = equations[high[k], j]
                if row >= 0 and column >= 0:
                    indices[at[row]] = column
                    slots[k, i, j] = at[row]
                    at[row] += 1
