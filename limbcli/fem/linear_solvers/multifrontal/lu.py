"""LU of one dense matrix, partial pivoting, by two threads that hold no lock.

Panel by panel from the left: while one thread brings the next panel up to date and factors it, the other
does the columns beyond. LAPACK's own, by threads of the BLAS, leaves these waiting in loops that take the
processor from ours. Cut the same whatever the number of threads, so that the sums agree.
Source: Golub & Van Loan, Matrix Computations, 4th ed., section 3.4 (blocked, right-looking).
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit
from scipy.linalg import lapack

from limbcli.fem.linear_solvers.multifrontal.blas import gemm_nn, getrf, solve_unit_lower
from limbcli.fem.linear_solvers.multifrontal.sharing import ThreadTeam
from limbcli.model import Array, IntArray

PANEL = 256  # columns: 128 and 192 take as long
_PIECES = 3  # that what lies beyond the next panel is done in


class Lu:
    """n : equations; kind : of number; blas : of that kind, see `blas.addresses`; team : who does the work"""

    def __init__(self, n: int, kind: Any, blas: IntArray, team: ThreadTeam):
        self.n, self.blas, self.team = n, blas, team
        self._flat = np.empty(n * n, dtype=kind)
        self._pivots = np.zeros(n, dtype=np.int32)
        self._getrs = lapack.get_lapack_funcs(("getrs",), dtype=kind)[0]

    @property
    def matrix(self) -> Array:
        """(n, n), to be filled before `factor`; its factors afterwards."""
        return self._flat.reshape(self.n, self.n).T

    def factor(self) -> None:
        """Of `matrix`, in place; a pivot may come out as 0."""
        n = self.n
        edges = [*range(0, n, PANEL), n]
        where = self.blas, self._flat, n, self._pivots
        if n:
            _panel(*where, 0, edges[1])
        for k in range(len(edges) - 2):
            j0, j1, j2 = edges[k : k + 3]

            def ahead(j0: int = j0, j1: int = j1, j2: int = j2) -> None:
                _behind(*where, j0, j1, j1, j2)
                _panel(*where, j1, j2)

            cuts = np.linspace(j2, n, _PIECES + 1).astype(int).tolist()
            pieces = [partial(_behind, *where, j0, j1, a, b) for a, b in pairwise(cuts) if b > a]
            self.team.run([ahead, *pieces])
        panels = list(pairwise(edges))
        self.team.run([partial(_exchange_left, *where[1:], panels[half::2]) for half in range(2)])

    def solve(self, rhs: Array, *, transposed: bool = False) -> Array:
        """x (n,) of A x = rhs, or of A^T x = rhs."""
        return np.asarray(self._getrs(self.matrix, self._pivots, rhs, trans=int(transposed))[0])


@njit(cache=True, nogil=True)
def _panel(blas, a, n, pivots, j0, j1):  # type: ignore[no-untyped-def]
    """Factor columns j0..j1 below row j0; pivots : rows of the matrix, from 0."""
    getrf(blas, n - j0, j1 - j0, a, j0 + j0 * n, n, pivots, j0)
    for j in range(j0, j1):
        pivots[j] += j0 - 1


@njit(cache=True, nogil=True)
def _exchange(a, n, pivots, j0, j1, c0, c1):  # type: ignore[no-untyped-def]
    """The rows of columns c0..c1 that the pivots of columns j0..j1 exchange."""
    for c in range(c0, c1):
        at = c * n
        for j in range(j0, j1):
            p = pivots[j]
            if p != j:
                kept = a[at + j]
                a[at + j] = a[at + p]
                a[at + p] = kept


@njit(cache=True, nogil=True)
def _behind(blas, a, n, pivots, j0, j1, c0, c1):  # type: ignore[no-untyped-def]
    """What the factored columns j0..j1 do to columns c0..c1, on the right of them."""
    one = a.dtype.type(1)
    _exchange(a, n, pivots, j0, j1, c0, c1)
    solve_unit_lower(blas, j1 - j0, c1 - c0, a, j0 + j0 * n, n, a, j0 + c0 * n, n)
    if j1 < n:
        gemm_nn(
            blas, n - j1, c1 - c0, j1 - j0, -one, a, j1 + j0 * n, n, a, j0 + c0 * n, n, one, a, j1 + c0 * n, n
        )


def _exchange_left(a: Any, n: int, pivots: Any, panels: list[tuple[int, int]]) -> None:
    """In factored panels what later pivots exchange."""
    for j0, j1 in panels:
        _exchange(a, n, pivots, j1, n, j0, j1)
