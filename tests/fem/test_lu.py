"""The dense LU of the root: against LAPACK's, and the same whatever the number of threads."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import lu_factor

from limbcli.fem.linear_solvers.multifrontal.blas import addresses
from limbcli.fem.linear_solvers.multifrontal.lu import PANEL, Lu
from limbcli.fem.linear_solvers.multifrontal.sharing import ThreadTeam

SIZES = [1, PANEL - 1, PANEL, PANEL + 1, 2 * PANEL + 37, 3 * PANEL]


def matrix(n: int, kind: type = np.float64) -> np.ndarray:
    """Far from symmetric, with nothing on every other place of its diagonal: rows must be exchanged."""
    A = np.random.default_rng(n).normal(size=(n, n))
    if n > 1:
        A[np.arange(0, n, 2), np.arange(0, n, 2)] = 0.0
    return A.astype(kind)


def factored(A: np.ndarray, threads: int = 2) -> Lu:
    team = ThreadTeam(threads)
    found = Lu(len(A), A.dtype, addresses(A.dtype == np.float32), team)
    found.matrix[:] = A
    found.factor()
    team.close()
    return found


@pytest.mark.parametrize("n", SIZES)
def test_factors_are_those_of_lapack(n: int) -> None:
    A = matrix(n)
    np.testing.assert_allclose(factored(A).matrix, lu_factor(A)[0], rtol=1e-6, atol=1e-9 * n)


@pytest.mark.parametrize(("kind", "tolerance"), [(np.float64, 1e-8), (np.float32, 0.1)])
@pytest.mark.parametrize("transposed", [False, True])
def test_solution_is_that_of_the_matrix_or_its_transpose(kind, tolerance, transposed: bool) -> None:
    A = matrix(SIZES[-2], kind)
    x = np.linspace(-1.0, 1.0, len(A))
    rhs = (A.T if transposed else A).astype(float) @ x
    found = factored(A).solve(rhs.astype(kind), transposed=transposed)
    assert found == pytest.approx(x, abs=tolerance)


def test_one_thread_gives_the_same_numbers() -> None:
    A = matrix(SIZES[-2], np.float32)
    assert np.array_equal(factored(A, 1).matrix, factored(A, 2).matrix)


def test_a_column_without_a_pivot_is_left_with_zero() -> None:
    A = matrix(PANEL + 20)
    A[:, PANEL + 5] = 0.0
    found = factored(A)
    assert found.matrix[PANEL + 5, PANEL + 5] == 0.0
    assert np.isfinite(found.matrix).all()
