"""Pressures of their own on the way to equilibrium; warm starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import block, punch

from limbcli.errors import SolveError
from limbcli.fem.analysis import Analysis
from limbcli.fem.equilibrium.settings import Settings
from limbcli.fem.equilibrium.tangent import assemble
from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.fem.warm_start import Solved, WarmStart, even_step
from limbcli.materials import ogden_type
from limbcli.model import LimbModel, Support

STIFF = ogden_type(c=0.01, f_kappa=300.0, m=4.0)


def held(kind: str = "tet10") -> System:
    model = block(kind, twist=0.05, material=STIFF)
    return System(replace(model, supports=(Support("z0", ("x", "y", "z")),)), threads=1)


def bent(system: System, rng: np.random.Generator, size: float = 0.02) -> State:
    return State(0.0, np.where(system.free, size * rng.standard_normal(system.X.shape), 0.0), ())


def test_linear_volumes_are_the_derivative_of_det_f(rng: np.random.Generator) -> None:
    system = held()
    state, v = bent(system, rng), rng.standard_normal(system.X.shape)
    (now,) = system.linear_volumes(state, np.zeros_like(v))
    h = 1e-6
    up, down = (system.linear_volumes(replace(state, u=state.u + s * h * v), 0 * v)[0] for s in (1, -1))
    np.testing.assert_allclose(system.linear_volumes(state, v)[0] - now, (up - down) / (2 * h), atol=1e-7)


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8"])
def test_tangent_at_pressures_of_their_own(kind: str, rng: np.random.Generator) -> None:
    """It is the derivative of the force with those pressures, plus lame cof F (x) cof F: the condensed one.

    Both change by what a pressure change at held displacements does, so the difference of tangents at two
    pressures is the derivative of the difference of forces.
    """
    system = held(kind)
    state, v = bent(system, rng), np.zeros_like(system.X)
    direction = rng.standard_normal(system.n_unknowns)
    v[system.free] = direction
    (J,) = system.linear_volumes(state, np.zeros_like(v))
    pressure = 0.3 * rng.standard_normal(J.shape) / system.operands[0].lame[0]

    def shift(u: np.ndarray) -> np.ndarray:
        """Forces of the fixed pressure alone: those at volumes J(u) + pressure/lame."""
        (there,) = system.linear_volumes(replace(state, u=u), np.zeros_like(u))
        return system.volume_force(replace(state, u=u, volumes=(there + pressure,)))

    h = 1e-6
    differences = (shift(state.u + h * v) - shift(state.u - h * v))[system.free] / (2 * h)
    own = replace(state, volumes=(J + pressure,))
    nodal = system.forces(state).nodal
    exact = assemble(system, own, nodal).tissue_times(direction)
    exact -= assemble(system, state, nodal).tissue_times(direction)
    np.testing.assert_allclose(differences, exact, atol=1e-6 * abs(exact).max())
    times = system.tangent_times(own, v) - system.tangent_times(state, v)
    np.testing.assert_allclose(times[system.free], exact, atol=1e-10 * abs(exact).max())


def deep(f_kappa: float = 1000.0) -> LimbModel:
    """A nearly incompressible block, pressed by a quarter of its height in one step."""
    model = punch("tet10", (4, 3, 3), depth=2.5, material=ogden_type(c=0.01, f_kappa=f_kappa, m=2.0))
    step = replace(model.steps[0], n_steps=1, step_size=1.0, must_points=())
    return replace(model, steps=(step,))


def iterations(model: LimbModel, *, volume_ratios: bool) -> tuple[int, float]:
    analysis = Analysis(model, Settings(tolerance=1e-7, threads=1, volume_ratios=volume_ratios))
    try:
        last = analysis.run()[-1]
        return analysis.totals().iterations, float(last.forces.bodies[0, 2])
    finally:
        analysis.close()


@pytest.mark.slow
def test_pressures_of_their_own_save_iterations_and_change_no_answer() -> None:
    with_them, force = iterations(deep(), volume_ratios=True)
    try:
        without, same = iterations(deep(), volume_ratios=False)
    except SolveError:
        return
    assert with_them < 0.75 * without
    assert force == pytest.approx(same, rel=1e-5)


def test_a_warm_start_is_better_than_the_level_it_came_from() -> None:
    """With du/dkappa by differences: the guess for another bulk stiffness leaves a far smaller residual."""
    model = deep(100.0)
    analysis = Analysis(model, Settings(tolerance=1e-9, threads=1))

    def solved(f_kappa: float, start: WarmStart | None = None) -> State:
        law = ogden_type(c=0.01, f_kappa=f_kappa, m=2.0)
        analysis.model = model.with_material("tissue", law)
        return analysis.run(guesses=start.guess if start else None)[-1].state

    near, base = solved(100.1), solved(100.0)
    key = ("tissue", "kappa")
    slope = (near.u - base.u) / 0.001
    warm = WarmStart()
    lame = tuple(o.lame for o in analysis.system.operands)
    warm.keep(Solved({key: 1.0}, {base.time: base}, {base.time: {key: slope}}, lame))
    warm.at({key: 4.0})
    solved(400.0)
    system = analysis.system
    guess = warm.guess(system, base.time)
    assert guess is not None
    system.at(base.time)
    moved = system.forces(system.prescribed(guess, base.time))
    plain = system.forces(base)
    assert np.linalg.norm(moved.iterated) < 0.1 * np.linalg.norm(plain.residual)
    assert warm.guess(system, 0.123) is None, "a level that no solve had"
    analysis.close()


def test_steps_are_measured_as_the_response_changes() -> None:
    assert even_step("kappa", 2.0, 1e12) == pytest.approx(2.0), "incompressible is a finite way off"
    assert even_step("kappa", 1.0, 1.001) == pytest.approx(0.001, rel=2e-3)
    assert even_step("m1", 2.0, 3.0) == pytest.approx(2.0 * np.log(1.5))
    assert even_step("c1", 3.0, 5.0) == 2.0
