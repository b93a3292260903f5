"""Elimination order: nested dissection of a compressed graph.

Equations with the same pattern (the degrees of freedom of a node) are merged into one weighted vertex: the
graph, and hence the whole analysis, becomes three times smaller.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse

from limbcli.model import IntArray
from limbcli.numbers.compiled import njit

# METIS options: number of separators tried, and allowed imbalance in 1/1000; they save 5 to 15 % of the work.
_TRIALS, _UNEVEN = 2, 100


@dataclass(frozen=True, eq=False)
class Graph:
    """Compressed graph; each vertex is a set of equations with the same pattern.

    indptr, indices : neighbours of each vertex, without itself
    members_at, members : equations of each vertex, ascending
    """

    indptr: IntArray
    indices: IntArray
    members_at: IntArray
    members: IntArray

    @property
    def n(self) -> int:
        return len(self.indptr) - 1

    @property
    def weights(self) -> IntArray:
        return np.diff(self.members_at)


def compress(indptr: IntArray, indices: IntArray, last: IntArray) -> Graph:
    """The graph of a symmetric matrix given by its upper triangle (CSR, diagonal optional).

    Equations in `last` are not merged with others.
    """
    n = len(indptr) - 1
    at, neighbours = _symmetric(indptr, indices)
    colour = np.random.default_rng(7).integers(1, 2**62, size=n + 1)
    colour[n] = 0
    flag = np.zeros(n, dtype=np.int64)
    flag[last] = 1
    code = _codes(at, neighbours, colour) + flag
    vertex = _classes(np.argsort(code, kind="stable"), code, flag, at, neighbours)
    _, first, vertex = np.unique(vertex, return_index=True, return_inverse=True)
    members = np.argsort(vertex, kind="stable")
    members_at = np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=len(first)))])
    vertex_at, vertex_indices = _quotient(first, vertex, at, neighbours)
    return Graph(vertex_at, vertex_indices, members_at, members)


def order(graph: Graph, last: IntArray, *, metis: bool = True) -> IntArray:
    """Vertices in elimination order, with those of `last` (a mask) at the end."""
    inner = np.flatnonzero(~last)
    number = np.full(graph.n, -1)
    number[inner] = np.arange(len(inner))
    indptr, indices = _part(inner, number, graph.indptr, graph.indices)
    weights = graph.weights[inner]
    found = _metis(indptr, indices, weights) if metis else None
    if found is None:
        found = minimum_degree(indptr, indices)
    return np.concatenate([inner[found], np.flatnonzero(last)])


def _metis(indptr: IntArray, indices: IntArray, weights: IntArray) -> IntArray | None:
    if len(indices) == 0:
        return np.arange(len(indptr) - 1)
    try:
        import pymetis
    except ImportError:
        return None
    graph = pymetis.CSRAdjacency(indptr.astype(np.int32), indices.astype(np.int32))
    options = pymetis.Options(nseps=_TRIALS, ufactor=_UNEVEN)
    found, _ = pymetis.nested_dissection(graph, vweights=weights.astype(np.int32), options=options)
    return np.asarray(found, dtype=np.int64)


def minimum_degree(indptr: IntArray, indices: IntArray) -> IntArray:
    """Minimum-degree order from SuperLU: twice the work of nested dissection, but always available."""
    n = len(indptr) - 1
    weights = np.full(len(indices), -1.0)
    matrix = sparse.csc_matrix((weights, indices, indptr), shape=(n, n))
    matrix = (matrix + sparse.diags_array(2.0 * np.diff(indptr) + 1.0)).tocsc()
    factor = sparse.linalg.splu(
        matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return np.argsort(factor.perm_c)


@njit
def _symmetric(indptr, indices):  # type: ignore[no-untyped-def]
    n = len(indptr) - 1
    count = np.zeros(n + 1, dtype=np.int64)
    for i in range(n):
        for k in range(indptr[i], indptr[i + 1]):
            if indices[k] != i:
                count[i + 1] += 1
                count[indices[k] + 1] += 1
    at = np.cumsum(count)
    place = at[:-1].copy()
    out = np.empty(at[n], dtype=np.int64)
    for i in range(n):
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if j != i:
                out[place[i]] = j
                place[i] += 1
                out[place[j]] = i
                place[j] += 1
    return at, out


@njit
def _codes(at, neighbours, colour):  # type: ignore[no-untyped-def]
    n = len(at) - 1
    code = np.empty(n, dtype=np.int64)
    for i in range(n):
        total = colour[i]
        for k in range(at[i], at[i + 1]):
            total += colour[neighbours[k]]
        code[i] = total
    return code


@njit
def _classes(by_code, code, flag, at, neighbours):  # type: ignore[no-untyped-def]
    """For each equation, the first one with the same pattern; equal hash codes are verified."""
    n = len(at) - 1
    vertex = np.arange(n)
    stamp = np.full(n, -1, dtype=np.int64)
    head = -1
    for i in by_code:
        same = head >= 0 and code[i] == code[head] and flag[i] == flag[head]
        same = same and at[i + 1] - at[i] == at[head + 1] - at[head] and stamp[i] == head
        if same:
            for k in range(at[i], at[i + 1]):
                same = same and stamp[neighbours[k]] == head
        if same:
            vertex[i] = head
        else:
            head = i
            stamp[i] = i
            for k in range(at[i], at[i + 1]):
                stamp[neighbours[k]] = i
    return vertex


@njit
def _quotient(first, vertex, at, neighbours):  # type: ignore[no-untyped-def]
    n = len(first)
    indptr = np.zeros(n + 1, dtype=np.int64)
    total = 0
    for v in range(n):
        total += at[first[v] + 1] - at[first[v]]
    indices = np.empty(total, dtype=np.int64)
    stamp = np.full(n, -1, dtype=np.int64)
    size = 0
    for v in range(n):
        stamp[v] = v
        for k in range(at[first[v]], at[first[v] + 1]):
            w = vertex[neighbours[k]]
            if stamp[w] != v:
                stamp[w] = v
                indices[size] = w
                size += 1
        indptr[v + 1] = size
    return indptr, indices[:size].copy()


@njit
def _part(inner, number, indptr, indices):  # type: ignore[no-untyped-def]
    at = np.zeros(len(inner) + 1, dtype=np.int64)
    out = np.empty(len(indices), dtype=np.int64)
    size = 0
    for v in range(len(inner)):
        for k in range(indptr[inner[v]], indptr[inner[v] + 1]):
            if number[indices[k]] >= 0:
                out[size] = number[indices[k]]
                size += 1
        at[v + 1] = size
    return at, out[:size].copy()


def positions(order_of: IntArray) -> IntArray:
    """The inverse permutation: the position of each item in an order."""
    place = np.empty(len(order_of), dtype=np.int64)
    place[order_of] = np.arange(len(order_of))
    return place
