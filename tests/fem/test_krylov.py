"""GMRES where it goes well, and where it breaks down."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.fem.linear_solvers.krylov import gmres
from limbcli.fem.linear_solvers.singular import SingularMatrix


def test_solves_to_the_tolerance(rng: np.random.Generator) -> None:
    A = np.eye(30) + 0.1 * rng.standard_normal((30, 30))
    b = rng.standard_normal(30)
    x, n, reached = gmres(lambda v: A @ v, lambda v: v.copy(), b, tolerance=1e-8)
    assert np.linalg.norm(A @ x - b) <= 1.01e-8 * np.linalg.norm(b)
    assert n < 30
    assert reached <= 1e-8


@pytest.mark.parametrize("rank", [0, 1, 3])
def test_a_breakdown_ends_with_what_there_is(rank: int) -> None:
    """Singular, with a right-hand side that it can partly meet: the rest is left, without an error."""
    A = np.diag([1.0, 2.0, 3.0][:rank] + [0.0] * (5 - rank))
    b = np.ones(5)
    x, n, reached = gmres(lambda v: A @ v, lambda v: v.copy(), b, tolerance=1e-10)
    assert np.isfinite(x).all()
    assert n <= 5
    assert reached > 0.5
    assert np.linalg.norm(A @ x - b) <= np.linalg.norm(b) * (1 + 1e-12)


@pytest.mark.parametrize("where", ["rhs", "product"])
def test_numbers_that_are_not_finite_are_an_error_that_a_shorter_step_can_mend(where: str) -> None:
    b = np.array([1.0, np.nan if where == "rhs" else 1.0])
    with pytest.raises(SingularMatrix, match="not finite"):
        gmres(lambda v: v * np.inf, lambda v: v.copy(), b, tolerance=1e-6)
