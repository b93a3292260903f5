"""The tissue linearised, against the contact as it is; the contact in the root of the factor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import punch

from limbcli.fem.contacts.contact import near_nodes
from limbcli.fem.equilibrium import linearised as of_linearised
from limbcli.fem.equilibrium.linearised import Linearised
from limbcli.fem.equilibrium.newton import Newton
from limbcli.fem.equilibrium.settings import Counts, Settings
from limbcli.fem.motion.state import State, norm
from limbcli.fem.system import System


def pressed(
    rng: np.random.Generator, kind: str = "tet10", linear: str = "auto", size: float = 2e-2
) -> tuple[Linearised, State]:
    """A linearised block, and a state with the probe in it."""
    system = System(punch(kind, (5, 4, 3)), threads=1)
    linearised = Linearised(system, Settings(threads=1, linear=linear), Counts())
    state = system.prescribed(system.rest(), 0.2)
    state = system.moved(state, size * rng.standard_normal(system.n_unknowns))
    linearised.refresh(state, system.forces(state))
    return linearised, state


@pytest.mark.slow
def test_contact_matrix_is_the_contact_tangent(rng: np.random.Generator) -> None:
    linearised, state = pressed(rng)
    system = linearised.system
    n, contact = system.n_tissue, system.search(state)
    dense = system.contact_matrix(contact, system.equations, n).toarray()
    v = rng.standard_normal(n)
    assert abs(dense).max() > 0
    np.testing.assert_allclose(dense @ v, system.contact_change(contact, v), atol=1e-12 * abs(dense).max())
    upper = system.add_contact(contact, np.zeros(len(system.pattern.indices)))
    np.testing.assert_allclose(
        system.pattern.matrix(upper).toarray(), 0.5 * (dense + dense.T), atol=1e-12 * abs(dense).max()
    )


def test_the_nodes_that_touch_are_within_reach(rng: np.random.Generator) -> None:
    linearised, state = pressed(rng)
    system = linearised.system
    within = set(system.within_reach().tolist())
    patch = system.pairs[0].patches[0]
    touched = system.search(state).touching.reshape(len(patch.facets), -1)
    touching = np.unique(patch.facets[touched.any(axis=1)])
    wanted = system.equations[touching].ravel()
    assert len(within) < system.n_tissue
    assert set(wanted[wanted >= 0].tolist()) <= within


def test_reach_follows_the_outline_wherever_the_face_points(rng: np.random.Generator) -> None:
    """A long face over a plane: nodes below it, not beside it; the same after a rotation of the scene."""
    grid = np.stack(np.meshgrid(np.arange(21.0), np.arange(21.0), [0.0], indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    number = np.arange(441).reshape(21, 21)
    a, b, c, d = (
        each.ravel() for each in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    )
    soft = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    face = np.array([[4.0, 9, 1], [16, 9, 1], [16, 11, 1], [4, 11, 1]])
    X = np.concatenate([grid, face])
    rigid = np.array([[441, 442, 443, 444]])
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    for Q in (np.eye(3), turn):
        normals = np.tile(Q @ [0, 0, 1.0], (len(soft), 1))
        found = grid[near_nodes(X @ Q.T, rigid, soft, normals)]
        assert abs(found[:, 0] - 10).max() <= 8
        assert abs(found[:, 1] - 10).max() <= 3
        under = (abs(grid[:, 0] - 10) < 6) & (abs(grid[:, 1] - 10) < 1.1)
        assert under.sum() <= len(found)


def test_settled_tissue_and_contact_are_in_balance(rng: np.random.Generator) -> None:
    """By the tissue's own linear forces and a fresh search: not by what the iteration kept."""
    linearised, state = pressed(rng, size=2e-3)
    system = linearised.system
    for far, part in ((True, 0.1), (False, 1e-4)):
        forces = system.forces(state)
        linearised.refresh(state, forces)
        tissue = forces.residual - system.contact_residual(forces.contact)
        goal = part * norm(forces.residual)
        step, contact = linearised.settle(state, tissue, goal, forces.contact, far=far)
        assert linearised.tangent is not None
        after = system.moved(state, step)
        pushed = system.contact_residual(system.search(after))
        np.testing.assert_allclose(system.contact_residual(contact), pushed, atol=1e-12)
        left = tissue + linearised.tangent.tissue_times(step) + pushed
        assert norm(left) <= goal
        state = after


def test_the_factor_follows_the_contact(rng: np.random.Generator) -> None:
    """After the probe came deeper, far fewer Krylov iterations a decade than with the contact of before."""
    used = {}
    for linear in ("multifrontal", "superlu"):
        linearised, state = pressed(rng, linear=linear)
        system = linearised.system
        deeper = system.prescribed(state, 0.8)
        rhs = rng.standard_normal(system.n_unknowns)
        linearised.solve(replace(system.search(deeper), full_tangent=False), rhs, 1e-4)
        used[linear] = linearised.rate
    assert used["multifrontal"] < 0.6 * used["superlu"]


class TooOld:
    """An inverse of another tangent, with which GMRES does not converge."""

    tangent = None

    def follow(self, contact: object) -> None:
        """The contact does not matter."""

    def __call__(self, rhs: np.ndarray) -> np.ndarray:
        return np.roll(rhs, 7)


def test_an_older_factor_that_was_given_up_is_not_tried_where_the_next_increments_begin(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    linearised, state = pressed(rng, size=2e-3)
    newton = Newton(linearised.system, Settings(threads=1), Counts())
    newton.counts, newton.linearised = linearised.counts, linearised
    forces, assembled = linearised.system.forces(state), []
    stiffness = linearised.system.stiffness
    monkeypatch.setattr(linearised.system, "stiffness", lambda at: assembled.append(at) or stiffness(at))

    def factored(*, begins: bool) -> int:
        """How many factors a step takes that has one which is too old."""
        before = linearised.counts.factorisations
        linearised.inverse, linearised.reuse_cost, linearised.ageing = TooOld(), 0.0, 0.0
        assembled.clear()
        newton.direction(replace(state), forces, True, 1e-6, begins=begins)
        assert len(assembled) == 1  # also where a first factor fails
        return linearised.counts.factorisations - before

    krylov = []
    for _ in range(of_linearised._SPARED + 2):
        before = linearised.counts.krylov
        assert factored(begins=True) == 1
        krylov.append(linearised.counts.krylov - before)
    tried = [n > krylov[1] for n in krylov]
    assert tried == [True, *[False] * of_linearised._SPARED, True]
    linearised.forget()
    assert not linearised.spared


def test_the_contact_after_a_whole_step_is_searched_once(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    linearised, state = pressed(rng, size=2e-3)
    system = linearised.system
    newton = Newton(system, Settings(threads=1), Counts())
    forces, searched, search = system.forces(state), [], system.search
    step, found = newton.direction(state, forces, True, 1e-6)
    expected = system.forces(system.moved(state, step))
    monkeypatch.setattr(
        system, "search", lambda *args, **more: searched.append(args) or search(*args, **more)
    )
    _, after, length = newton.search(state, forces, step, 0, contact=found)
    assert length == 1.0
    assert not searched
    np.testing.assert_allclose(after.residual, expected.residual, atol=1e-12 * norm(expected.residual))
    _, after, _ = newton.search(state, forces, 0.5 * step, 0, contact=found)
    assert searched
    expected = system.forces(system.moved(state, 0.5 * step))
    np.testing.assert_allclose(after.residual, expected.residual, atol=1e-12 * norm(expected.residual))
