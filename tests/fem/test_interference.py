"""An interference resolved by a penalty that grows: Lame's pressure, friction's limit, balance, tangent."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tubes import LENGTH, OUTER, lame_pressure, tube

from limbcli.bodies import Drive
from limbcli.feb.read import read_feb
from limbcli.feb.write import write_feb
from limbcli.fem.analysis import Analysis, Snapshot
from limbcli.fem.contacts.contact_points import NORMAL, TRACTION
from limbcli.fem.equilibrium.newton import Settings
from limbcli.fem.equilibrium.tangent import assemble
from limbcli.fem.system import System
from limbcli.model import Curve, LimbModel

SMALL = 0.02  # mm: 0.1 % of the radius
MU, LAME = 0.01, 0.04  # MPa, of the tube's law at rest (c 0.02 MPa, f_kappa 2)
MOVES = ("x", "y", "z", "u", "v", "w")


def last(model: LimbModel) -> tuple[Analysis, Snapshot]:
    """Where a residual stands with friction, 1e-6 of the forces is left."""
    stalled = 1e-6 if model.has_friction else 0.0
    analysis = Analysis(model, Settings(tolerance=1e-7, threads=1, stalled=stalled))
    return analysis, analysis.run()[-1]


def normal_force(analysis: Analysis) -> float:
    """N, the sum of the pressures over the current area."""
    (patch,) = analysis.system.pairs[0].patches
    size = np.linalg.norm(patch.state[..., NORMAL : NORMAL + 3], axis=2)
    return float((patch.weights * size * patch.state[..., TRACTION]).sum())


def test_the_law_at_rest_is_what_the_closed_form_is_given() -> None:
    parameters = tube(SMALL).materials["tissue"].parameters
    assert 0.5 * (parameters["c1"] + parameters["c2"]) == pytest.approx(MU)
    assert parameters["kappa"] == pytest.approx(LAME)


def test_a_tube_in_a_tight_tube_bears_lames_pressure() -> None:
    analysis, end = last(tube(SMALL, n=(8, 48, 1)))
    pressure = normal_force(analysis) / (2 * np.pi * OUTER * LENGTH)
    # 48 chords and 8 cells across: half a per cent; 0.1 % of strain: a tenth of that
    assert pressure == pytest.approx(lame_pressure(SMALL, MU, LAME), rel=0.01)
    assert np.abs(end.forces.bodies[0, :3]).max() < 1e-6 * normal_force(analysis)


def pulled(friction: float, way: float) -> LimbModel:
    """The tight tube, which is then drawn along its axis; the inner wall holds the soft one."""
    model = tube(1.0, n=(4, 24, 2), friction=friction)
    donning = replace(model.steps[0], drives=tuple(Drive("socket", dof, "fixed") for dof in MOVES))
    pull = (
        *(Drive("socket", dof, "fixed") for dof in MOVES if dof != "z"),
        Drive("socket", "z", "displacement", way, "pull"),
    )
    pulling = replace(donning, n_steps=2, step_size=0.5, drives=pull)
    curves = {**model.curves, "pull": Curve(((1.0, 0.0), (2.0, 1.0)))}
    return replace(model, drives=(), steps=(donning, pulling), curves=curves)


def test_drawn_along_its_axis_it_resists_with_friction_times_the_normal_force() -> None:
    analysis, end = last(pulled(0.3, 4.0))
    drag = float(end.forces.bodies[0, 2])
    assert drag == pytest.approx(0.3 * normal_force(analysis), rel=1e-4)
    held = end.forces.nodal.sum(axis=0)
    assert abs(held + end.forces.bodies[0, :3]).max() < 1e-4 * drag


def test_a_growing_penalty_is_written_and_read(tmp_path: Path) -> None:
    model = tube(SMALL, n=(1, 8, 1), friction=0.3)
    again = read_feb(write_feb(model, tmp_path / "model.feb"))
    assert again.contacts == model.contacts
    assert again.contacts[0].penalty_curve == "donning"
    assert 'penalty lc="' in (tmp_path / "model.feb").read_text()


def test_the_penalty_follows_its_curve() -> None:
    system = System(tube(SMALL, n=(1, 8, 1)), threads=1)
    (patch,) = system.pairs[0].patches
    first = patch.eps.copy()
    system.at(1.0)
    np.testing.assert_allclose(patch.eps, 1e4 * first)
    system.at(0.0)
    np.testing.assert_allclose(patch.eps, first)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_the_tangent_of_a_concave_rigid_side_agrees_with_differences(
    friction: float, rng: np.random.Generator
) -> None:
    model = tube(1.0, n=(2, 12, 1), friction=friction)
    model = replace(model, drives=model.drives[:2])  # the socket is free along and about its axis, too
    system = System(model, threads=1)
    start = system.prescribed(system.rest(), 0.9)
    system.at(0.9)
    system.forces(start)
    system.remember(replace(start, hints=system.hints()))
    state = system.moved(start, 1e-2 * rng.standard_normal(system.n_unknowns))
    forces = system.forces(state)
    assert forces.n_touching > 20
    direction = rng.standard_normal(system.n_unknowns)
    direction[system.n_tissue :] *= 0.1
    exact = assemble(system, state, forces.nodal).times(state, direction)
    h = 1e-7
    up, down = (system.forces(system.moved(state, s * h * direction)).residual for s in (1, -1))
    np.testing.assert_allclose((up - down) / (2 * h), exact, atol=1e-6 * abs(exact).max())


def test_a_socket_around_a_whole_limb_is_not_eliminated_last() -> None:
    """Its dense front would outgrow the memory."""
    few = System(tube(SMALL, n=(1, 8, 1)), threads=1)
    assert 0 < len(few.within_reach()) < 300
    many = System(tube(SMALL, n=(1, 200, 8)), threads=1)
    assert len(many.within_reach()) == 0
