"""LU factorisation of a dense matrix with partial pivoting, by two threads without the GIL.

Panel by panel from the left: while one thread updates and factors the next panel, the other updates the
columns beyond it. LAPACK's multithreaded version is not used because idle BLAS threads busy-wait and take
processor time from ours. The work is divided in the same way for any number of threads, so that sums agree.
Source: Golub & Van Loan, Matrix Computations, 4th ed., section 3.4 (blocked, right-looking).
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import lapack

from limbcli.fem.linear_solvers.multifrontal.blas import gemm_nn, getrf, solve_unit_lower
from limbcli.fem.linear_solvers.multifrontal.sharing import ThreadTeam
from limbcli.model import Array, IntArray
from limbcli.numbers.compiled import njit

PANEL = 256  # columns per panel; 128 and 192 take as long
_PIECES = 3  # number of tasks into which the update beyond the next panel is divided


class Lu:
    """Dense LU factor.

    n : number of equations; kind : floating-point type
    blas : routine addresses for that type, see `blas.addresses`; team : threads
    """

    def __init__(self, n: int, kind: Any, blas: IntArray, team: ThreadTeam):
        self.n, self.blas, self.team = n, blas, team
        self._flat = np.empty(n * n, dtype=kind)
        self._pivots = np.zeros(n, dtype=np.int32)
        self._getrs = lapack.get_lapack_funcs(("getrs",), dtype=kind)[0]

    @property
    def matrix(self) -> Array:
        """Matrix (n, n), to be filled before `factor`; contains the factors afterwards."""
        return self._flat.reshape(self.n, self.n).T

    def factor(self) -> None:
        """Factor `matrix` in place; pivots may be zero."""
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
        """Solution x (n,) of A x = rhs, or of A^T x = rhs."""
        return np.asarray(self._getrs(self.matrix, self._pivots, rhs, trans=int(transposed))[0])


@njit
def _panel(blas, a, n, pivots, j0, j1):  # type: ignore[no-untyped-def]
    """Factor columns j0..j1 from row j0 down; pivots : row numbers of the matrix, from 0."""
    getrf(blas, n - j0, j1 - j0, a, j0 + j0 * n, n, pivots, j0)
    for j in range(j0, j1):
        pivots[j] += j0 - 1


@njit
def _exchange(a, n, pivots, j0, j1, c0, c1):  # type: ignore[no-untyped-def]
    """Apply the row exchanges of pivot columns j0..j1 to columns c0..c1."""
    for c in range(c0, c1):
        at = c * n
        for j in range(j0, j1):
            p = pivots[j]
            if p != j:
                kept = a[at + j]
                a[at + j] = a[at + p]
                a[at + p] = kept


@njit
def _behind(blas, a, n, pivots, j0, j1, c0, c1):  # type: ignore[no-untyped-def]
    """Update columns c0..c1, to the right, with the factored columns j0..j1."""
    one = a.dtype.type(1)
    _exchange(a, n, pivots, j0, j1, c0, c1)
    solve_unit_lower(blas, j1 - j0, c1 - c0, a, j0 + j0 * n, n, a, j0 + c0 * n, n)
    if j1 < n:
        gemm_nn(
            blas, n - j1, c1 - c0, j1 - j0, -one, a, j1 + j0 * n, n, a, j0 + c0 * n, n, one, a, j1 + c0 * n, n
        )


def _exchange_left(a: Any, n: int, pivots: Any, panels: list[tuple[int, int]]) -> None:
    """Apply the row exchanges of later pivots to factored panels."""
    for j0, j1 in panels:
        _exchange(a, n, pivots, j1, n, j0, j1)
