"""The multifrontal solver against dense and sparse algebra of numpy and scipy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy.sparse as sparse

from limbcli.fem.linear_solvers import direct as linear
from limbcli.fem.linear_solvers.direct import check_supported
from limbcli.fem.linear_solvers.multifrontal import Multifrontal
from limbcli.fem.linear_solvers.multifrontal.ordering import compress, minimum_degree, order
from limbcli.fem.linear_solvers.singular import SingularMatrix

ROUND_OFF = {True: 2e-4, False: 1e-9}  # of matrices with condition numbers of a few hundred


def grid(n: int, dofs: int = 3, seed: int = 7, shift: float = 0.0) -> sparse.csr_matrix:
    """A symmetric matrix of a cube of n^3 nodes with `dofs` equations each; indefinite with a shift."""
    line = sparse.diags_array([np.ones(n - 1), np.ones(n), np.ones(n - 1)], offsets=[-1, 0, 1])
    nodes = sparse.kron(sparse.kron(line, line, format="csr"), line, format="csr")
    pattern = sparse.kron(nodes, np.ones((dofs, dofs))).tocsr()
    pattern.data = np.random.default_rng(seed).standard_normal(pattern.nnz)
    matrix = (pattern + pattern.T) / 2
    heavy = np.abs(matrix).sum(axis=1)
    sign = np.where(np.arange(len(heavy)) % 5 == 0, -1.0, 1.0) if shift else 1.0
    return (matrix + sparse.diags_array((1.02 + shift) * heavy * sign)).tocsr()


def upper(matrix: sparse.csr_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    half = sparse.triu(matrix).tocsr()
    half.sort_indices()
    return half.indptr.astype(np.int64), half.indices.astype(np.int64), half.data


def solver_of(matrix: sparse.csr_matrix, **options: object) -> Multifrontal:
    indptr, indices, values = upper(matrix)
    solver = Multifrontal(indptr, indices, **options)  # type: ignore[arg-type]
    solver.factor(values)
    return solver


def error(matrix: sparse.csr_matrix, x: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(matrix @ x - b) / np.linalg.norm(b))


@pytest.mark.parametrize("single", [True, False])
@pytest.mark.parametrize("shift", [0.0, 0.5])
@pytest.mark.parametrize("threads", [1, 2])
def test_solves_definite_and_indefinite_matrices(single: bool, shift: float, threads: int) -> None:
    matrix = grid(6, shift=shift)
    b = np.random.default_rng(7).standard_normal(matrix.shape[0])
    solver = solver_of(matrix, single=single, threads=threads)
    x = solver.solve(b)
    assert error(matrix, x, b) < ROUND_OFF[single]
    assert np.allclose(
        x, sparse.linalg.spsolve(matrix.tocsc(), b), atol=10 * ROUND_OFF[single] * abs(x).max()
    )
    assert solver.n_perturbed == 0
    assert (solver._store.sign < 0).sum() == (np.linalg.eigvalsh(matrix.toarray()) < 0).sum()


@pytest.mark.parametrize("single", [True, False])
@pytest.mark.parametrize("shift", [0.0, 0.5])
def test_one_thread_gives_what_two_give(single: bool, shift: float) -> None:
    matrix = grid(8, shift=shift)
    b = np.random.default_rng(7).standard_normal(matrix.shape[0])
    one, two = (solver_of(matrix, single=single, threads=t).solve(b) for t in (1, 2))
    assert np.array_equal(one, two)


def test_update_matrices_that_are_needed_at_one_time_lie_apart() -> None:
    """A front's own and those of its children, whatever the other thread does, and all that the top needs."""
    solver = solver_of(grid(14))
    layout = solver.layout
    plan, subtrees = layout.plan, layout.factoring.subtrees
    sizes = plan.ldu * np.diff(plan.rows_at)
    assert len(subtrees) > 2

    def apart(fronts: list[int], at: np.ndarray) -> bool:
        used = sorted((int(at[s]), int(sizes[s])) for s in fronts if sizes[s])
        return all(a + n <= b for (a, n), (b, _) in itertools.pairwise(used))

    def walk(order: list[int], at: np.ndarray, waiting: list[int]) -> list[int]:
        for s in order:
            assert apart([*waiting, s], at)
            done = plan.children[plan.child_at[s] : plan.child_at[s + 1]]
            waiting = [each for each in waiting if each not in done] + [s]
        return waiting

    last = [stop - 1 for _, stop in subtrees]
    for first, stop in subtrees:
        for at in layout.update_at:
            others = [each for each in last if each != stop - 1]
            assert walk(list(range(first, stop)), at, others) == [*others, stop - 1]
    within = np.concatenate([np.arange(first, stop - 1) for first, stop in subtrees])
    of_first, of_second = (each[within] for each in layout.update_at)
    assert (of_first + sizes[within]).max() <= of_second.min()
    walk([int(s) for s in layout.factoring.top], layout.update_at[0], last)


@pytest.mark.parametrize("single", [True, False])
def test_schur_complement_of_the_last_equations(single: bool) -> None:
    matrix = grid(6, shift=0.5)
    last = np.random.default_rng(7).permutation(matrix.shape[0])[:70]
    solver = solver_of(matrix, single=single, last=last)
    assert set(solver.root) == set(last)
    others = np.setdiff1d(np.arange(matrix.shape[0]), last)
    A, r = matrix.toarray(), solver.root
    exact = A[np.ix_(r, r)] - A[np.ix_(r, others)] @ np.linalg.solve(
        A[np.ix_(others, others)], A[np.ix_(others, r)]
    )
    assert np.allclose(solver.schur, exact, rtol=0, atol=ROUND_OFF[single] * abs(exact).max())


@pytest.mark.parametrize("single", [True, False])
@pytest.mark.parametrize("shift", [0.0, 0.5])
@pytest.mark.parametrize("symmetric", [True, False])
def test_root_is_changed_and_factored_again(single: bool, shift: float, symmetric: bool) -> None:
    rng = np.random.default_rng(7)
    matrix = grid(7, shift=shift)
    solver = solver_of(matrix, single=single, last=rng.permutation(matrix.shape[0])[:90])
    addition = rng.standard_normal((90, 90)) * 0.5
    addition = addition @ addition.T
    if not symmetric:
        addition += 3.0 * rng.standard_normal((90, 90))
    b = rng.standard_normal(matrix.shape[0])
    before = solver.solve(b)
    changed = matrix.tolil()
    changed[np.ix_(solver.root, solver.root)] += addition
    solver.update_root(sparse.csr_array(addition))
    x = solver.solve(b)
    assert error(changed.tocsr(), x, b) < ROUND_OFF[single]
    solver.update_root(None)
    assert np.allclose(solver.solve(b), before, rtol=0, atol=ROUND_OFF[single] * 1e-3)


def test_a_matrix_of_all_zero_pivots_is_counted_and_refused() -> None:
    matrix = grid(4)
    matrix = sparse.block_diag([matrix, sparse.csr_matrix(np.ones((6, 6)))]).tocsr()
    for single in (True, False):
        solver = solver_of(matrix, single=single)
        assert solver.n_perturbed == 5
        with pytest.raises(SingularMatrix):
            check_supported(solver)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("single", [True, False])
def test_an_entry_that_is_not_finite_is_refused(bad: float, single: bool) -> None:
    matrix = grid(4)
    matrix.data[[5, -5]] = bad
    with pytest.raises(SingularMatrix):
        solver_of(matrix, single=single).solve(np.ones(matrix.shape[0]))


def small_matrices() -> dict[str, sparse.csr_matrix]:
    rng = np.random.default_rng(7)
    full = rng.standard_normal((50, 50))
    a, b = grid(4), grid(3, dofs=1)
    shuffle = rng.permutation(a.shape[0] + b.shape[0])
    apart = sparse.block_diag([a, b]).tocsr()[shuffle][:, shuffle]
    return {
        "one equation": sparse.csr_matrix([[-2.0]]),
        "two equations": sparse.csr_matrix([[2.0, 1.0], [1.0, 3.0]]),
        "a diagonal": sparse.diags_array(np.linspace(-3, 4, 40)).tocsr(),
        "a full matrix": sparse.csr_matrix(full @ full.T + np.eye(50)),
        "two matrices apart": apart,
    }


@pytest.mark.parametrize("name", small_matrices())
@pytest.mark.parametrize("last", [False, True])
def test_small_matrices(name: str, last: bool) -> None:
    matrix = small_matrices()[name]
    n = matrix.shape[0]
    solver = solver_of(matrix, last=np.array([0, n // 2]) if last else None)
    b = np.random.default_rng(7).standard_normal(n)
    assert error(matrix, solver.solve(b), b) < 1e-9


def test_all_equations_may_be_last() -> None:
    matrix = grid(4)
    solver = solver_of(matrix, last=np.arange(matrix.shape[0]))
    b = np.ones(matrix.shape[0])
    assert error(matrix, solver.solve(b), b) < 1e-9
    assert np.allclose(solver.schur, matrix.toarray()[np.ix_(solver.root, solver.root)])


def test_minimum_degree_stands_in_for_metis() -> None:
    matrix = grid(6)
    b = np.ones(matrix.shape[0])
    solver = solver_of(matrix, metis=False)
    assert error(matrix, solver.solve(b), b) < 1e-9
    with_metis = solver_of(matrix)
    assert solver.layout.flops < 4 * with_metis.layout.flops


def test_equations_of_a_node_are_one_vertex() -> None:
    matrix = grid(4)
    indptr, indices, _ = upper(matrix)
    graph = compress(indptr, indices, np.array([4], dtype=np.int64))
    assert graph.n == 65  # the node of equation 4 is cut in two
    assert sorted(graph.weights)[:2] == [1, 2]
    found = minimum_degree(graph.indptr, graph.indices)
    assert sorted(found) == list(range(65))
    mask = graph.weights == 1
    assert order(graph, mask)[-1] == np.flatnonzero(mask)[0]


def test_rows_of_the_scale_of_another_unit_make_no_difference() -> None:
    matrix = grid(6, shift=0.5)
    units = sparse.diags_array(10.0 ** np.random.default_rng(7).uniform(-9, 9, matrix.shape[0]))
    b = np.ones(matrix.shape[0])
    plain, other = solver_of(matrix, single=True), solver_of((units @ matrix @ units).tocsr(), single=True)
    assert np.allclose(
        units @ other.solve(units @ b), plain.solve(b), rtol=0, atol=1e-4 * abs(plain.solve(b)).max()
    )
    assert other.n_perturbed == 0


def test_is_made_by_name_with_its_last_equations() -> None:
    indptr, indices, values = upper(grid(4))
    solver = linear.make(indptr, indices, kind="multifrontal", single=True, last=np.arange(12))
    solver.factor(values)
    assert solver.name == "multifrontal LDL (single precision)"
    assert set(solver.root) == set(range(12))  # type: ignore[attr-defined]
    assert solver.n_factorisations == 1
    solver.close()
