"""Tissue that is held back by a drag: where it comes to rest, and how the tangent has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import block, punch

from limbcli.errors import SolveError
from limbcli.fem.analysis import Analysis
from limbcli.fem.equilibrium import load_stepping, newton, relaxation
from limbcli.fem.equilibrium.newton import Newton, NotConverged
from limbcli.fem.equilibrium.relaxation import relax
from limbcli.fem.equilibrium.settings import LoadStep, Settings
from limbcli.fem.equilibrium.tangent import assemble
from limbcli.fem.system import System
from limbcli.materials import ogden_type

LEVEL = LoadStep(1, 1, 0.0)


def test_drag_is_shear_modulus_times_volume() -> None:
    model = block("tet10", (2, 2, 2), (2.0, 3.0, 1.0), material=ogden_type(c=0.008, f_kappa=100.0, m=5.0))
    system = System(model, threads=1)
    assert system.drag.sum() == pytest.approx(0.004 * 6.0, rel=1e-9)
    system.close()


def test_drag_is_on_the_tangents_diagonal(rng: np.random.Generator) -> None:
    system = System(punch("tet10", (3, 2, 2)), threads=1)
    state = system.rest()
    forces = system.forces(state)
    v = rng.standard_normal(system.n_unknowns)
    held, free = (assemble(system, state, forces.nodal, drag=drag).tissue_times(v) for drag in (2.5, 0.0))
    of_all = system.collect(np.repeat(system.drag[:, None], 3, axis=1))
    np.testing.assert_allclose(
        (held - free)[: system.n_tissue], 2.5 * of_all * v[: system.n_tissue], rtol=1e-9
    )


@pytest.mark.parametrize("f_kappa", [5.0, 500.0])
def test_it_comes_to_rest_where_newtons_method_ends(f_kappa: float) -> None:
    """Out of a state that is not near: the whole load at once."""
    model = punch("tet10", depth=0.6, levels=1, material=ogden_type(c=0.008, f_kappa=f_kappa, m=4.0))
    expected = Analysis(model, Settings(tolerance=1e-9, threads=1)).run()[-1]
    system = System(model, threads=1)
    solver = Newton(system, Settings(tolerance=1e-9, threads=1))
    found, forces = relax(solver, system.prescribed(system.start, 1.0), LEVEL)
    assert forces.error <= 1e-9
    np.testing.assert_allclose(found.u, expected.state.u, atol=1e-7)
    assert solver.linearised.drag == 0.0, "nothing is held back afterwards"


def test_a_march_goes_on_where_newtons_method_gives_up(monkeypatch: pytest.MonkeyPatch) -> None:
    model = punch("tet10", depth=0.6, levels=2, material=ogden_type(c=0.008, f_kappa=50.0, m=4.0))
    expected = Analysis(model, Settings(tolerance=1e-8, threads=1)).run()[-1].forces.bodies[0, 2]
    solve, requested = Newton.equilibrate, [0]

    def fails_at_the_end(self, guess, level, **options):  # type: ignore[no-untyped-def]
        if level.number == 2:
            requested[0] += 1
            raise NotConverged("no", where="here", fix="none")
        return solve(self, guess, level, **options)

    monkeypatch.setattr(Newton, "equilibrate", fails_at_the_end)
    last = Analysis(model, Settings(tolerance=1e-8, threads=1)).run()[-1]
    assert requested[0] >= 1
    assert last.forces.bodies[0, 2] == pytest.approx(expected, rel=1e-6)


def test_it_begins_where_newtons_method_came_nearest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton's method given up when two iterations are made: all but done, it is not begun again."""
    model = punch("tet10", depth=0.6, levels=2, material=ogden_type(c=0.008, f_kappa=50.0, m=4.0))
    left: list[float] = []
    monkeypatch.setattr(newton, "_too_long", lambda sizes: len(sizes) == 3)

    def watched(solver, guess, level, **options):  # type: ignore[no-untyped-def]
        left.append(solver.nearest[0])
        assert guess is solver.nearest[1]
        return relax(solver, guess, level, **options)

    monkeypatch.setattr(load_stepping, "relax", watched)
    last = Analysis(model, Settings(tolerance=1e-8, threads=1)).run()[-1]
    assert 0.0 < max(left) < load_stepping._NEAR
    monkeypatch.undo()
    expected = Analysis(model, Settings(tolerance=1e-8, threads=1)).run()[-1]
    np.testing.assert_allclose(last.state.u, expected.state.u, atol=1e-6)


def test_what_drag_has_held_back_must_leave_less(monkeypatch: pytest.MonkeyPatch) -> None:
    """A drag that never goes: its equilibria leave a tenth of the tolerance."""
    system = System(punch("tet10", depth=0.6, levels=1), threads=1)
    solver = Newton(system, Settings(tolerance=1e-2, threads=1))
    guess = system.prescribed(system.start, 1.0)
    monkeypatch.setattr(relaxation, "_LEAST_DRAG", 0.0)
    assert relax(solver, guess, LEVEL)[1].error <= 1e-3
    loosely = relax(solver, guess, LEVEL, tolerance=1e-2)[1].error
    assert 1e-3 < loosely <= 1e-2, "on the way it will do"


def test_a_failure_says_what_gave_way_and_how_far_there_is_an_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    model = punch("tet10", depth=1.0, levels=4)
    solve = Newton.equilibrate

    def fails(self, guess, level, **options):  # type: ignore[no-untyped-def]
        if guess.time > 0.6:
            raise NotConverged("no", where="node 3", fix="none")
        return solve(self, guess, level, **options)

    monkeypatch.setattr(Newton, "equilibrate", fails)
    monkeypatch.setattr(relaxation, "_RELAXED", 0)
    with pytest.raises(SolveError, match=r"there is a solution up to depth 0\.") as caught:
        Analysis(model, Settings(threads=1)).run()
    reached = caught.value.facts["reached_depth_mm"]
    assert 0.5 < reached < 0.7
    assert "node 3; contact changes" in caught.value.where
    monkeypatch.setattr(newton, "_NEARLY_FLAT", 2.0)  # any element
    with pytest.raises(SolveError) as caught:
        Analysis(model, Settings(threads=1)).run()
    assert "is about to invert: volume ratio" in caught.value.where
    assert load_stepping._LOOSE < 0.1


def test_friction_is_not_relaxed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Friction depends on the way: increments of pseudo-time would be another way."""
    model = punch("tet4", depth=0.4, levels=1)
    model = replace(model, contacts=(replace(model.contacts[0], friction=0.2),))
    monkeypatch.setattr(load_stepping, "relax", lambda *a, **k: pytest.fail("relaxed"))
    Analysis(model, Settings(tolerance=1e-6, threads=1)).run()
