"""Assembly of cells into a sparse matrix: node pairs, fixed sparsity pattern, threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from limbcli.model import Array, IntArray
from limbcli.numbers.compiled import njit


class Threads:
    """Splits a range over a few threads; the kernels release the GIL."""

    def __init__(self, n: int):
        self.n = max(1, n)
        self._pool = ThreadPoolExecutor(self.n) if self.n > 1 else None

    def run(self, task: Callable[[int, int, int], Any], n_items: int) -> list[Any]:
        """Run task(worker, start, stop) over equal parts of range(n_items)."""
        if self._pool is None or n_items < 64:
            return [task(0, 0, n_items)]
        edges = np.linspace(0, n_items, self.n + 1).astype(int)
        futures = [self._pool.submit(task, k, int(edges[k]), int(edges[k + 1])) for k in range(self.n)]
        return [each.result() for each in futures]

    def run_halves(self, task: Callable[[int, int, int], Any], n_items: int) -> None:
        """Run task(half, start, stop) over two halves of range(n_items), for any number of threads."""
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
    """Sum of the threads' partial arrays, accumulated in place into the first."""
    for each in parts[1:]:
        parts[0] += each
    return parts[0]


@dataclass(frozen=True, eq=False)
class Pattern:
    """Node pairs that have a block in the stiffness matrix, and the matrix's upper triangle in CSR.

    first (n_points + 1,), high (n_pairs,) : pairs sorted by lower node: row pointers, and higher node of each
    slots (n_pairs, 3, 3) : index of a block's entry in the CSR values, or -1
    sources : the inverse: index into the flat blocks of each CSR value
    pairs : for each list of cells, (n_cells, n (n + 1) / 2) codes 2 * pair + swapped, for local nodes a <= b,
        with a varying fastest; swapped: node a has the higher number
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
        """CSR values of the upper triangle from the blocks (n_pairs, 3, 3) of all pairs."""
        return np.take(blocks.ravel(), self.sources)

    def matrix(self, values: Array) -> sparse.csr_matrix:
        """The full symmetric matrix."""
        upper = sparse.csr_matrix((values, self.indices, self.indptr), shape=(self.n, self.n))
        return upper + sparse.triu(upper, 1, format="csr").T


def make_pattern(equations: IntArray, cell_lists: Sequence[IntArray]) -> Pattern:
    """Pattern of a matrix that couples the nodes of each cell.

    equations (n_points, 3): equation number of each degree of freedom, -1 where it has none.
    """
    n_points = len(equations)
    codes = [_pair_codes(cells, n_points) for cells in cell_lists]
    keys = np.concatenate([low * n_points + high for low, high, _ in codes] or [np.zeros(0, dtype=np.int64)])
    unique, inverse = np.unique(keys, return_inverse=True)
    low, high = unique // max(n_points, 1), unique % max(n_points, 1)
    # slots of the blocks' entries, and the CSR pattern; equation numbers must ascend with node numbers
    n = int(equations.max()) + 1 if equations.size else 0
    slots = np.full((len(low), 3, 3), -1, dtype=np.int32)
    indptr = np.zeros(n + 1, dtype=np.int64)
    _count(low, high, equations, indptr)
    np.cumsum(indptr, out=indptr)
    indices = np.empty(indptr[-1], dtype=np.int64)
    _place(low, high, equations, indptr[:-1].copy(), indices, slots)
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


@njit
def _count(low, high, equations, indptr):  # type: ignore[no-untyped-def]
    """Count the entries of each row i into indptr[i + 1]."""
    for k in range(len(low)):
        for i in range(3):
            row = equations[low[k], i]
            for j in range(i if low[k] == high[k] else 0, 3):
                if row >= 0 and equations[high[k], j] >= 0:
                    indptr[row + 1] += 1


@njit
def _place(low, high, equations, at, indices, slots):  # type: ignore[no-untyped-def]
    """Fill column indices and slots; pairs are sorted, so the columns of each row are in order."""
    for k in range(len(low)):
        for i in range(3):
            row = equations[low[k], i]
            for j in range(i if low[k] == high[k] else 0, 3):
                column = equations[high[k], j]
                if row >= 0 and column >= 0:
                    indices[at[row]] = column
                    slots[k, i, j] = at[row]
                    at[row] += 1
