"""An interference resolved by a penalty that grows: Lame's pressure, friction's limit, balance, tangent."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_models import block, top_facets
from tubes import LENGTH, OUTER, lame_pressure, tube

from limbcli.feb.read import read_feb
from limbcli.feb.write import write_feb
from limbcli.fem.analysis import Analysis, Snapshot
from limbcli.fem.contacts.contact_points import NORMAL, TRACTION
from limbcli.fem.contacts.contact_state import ContactState
from limbcli.fem.equilibrium.linearised import Linearised
from limbcli.fem.equilibrium.settings import Counts, Settings
from limbcli.fem.equilibrium.tangent import assemble
from limbcli.fem.linear_solvers.krylov import gmres
from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.materials import ogden_type
from limbcli.model import Block, Curve, LimbModel, Mesh, Step, Surface
from limbcli.model.bodies import Contact, Drive, RigidBody

SMALL = 0.02  # mm: 0.1 % of the radius
MU, LAME = 0.01, 0.04  # MPa, of the tube's law at rest (c 0.02 MPa, f_kappa 2)
MOVES = ("x", "y", "z", "u", "v", "w")


def last(model: LimbModel) -> tuple[Analysis, Snapshot]:
    """Where a residual stands with friction, 1e-6 of the forces is left."""
    stalled = 1e-6 if model.has_friction else 0.0
    analysis = Analysis(model, Settings(tolerance=1e-7, threads=1, stalled=stalled))
    return analysis, analysis.run()[-1]


def normal_force(analysis: Analysis, end: Snapshot) -> float:
    """N, the sum of the pressures over the current area."""
    (patch,), (points,) = analysis.system.pairs[0].patches, end.forces.contact.points[0]
    size = np.linalg.norm(points[..., NORMAL : NORMAL + 3], axis=2)
    return float((patch.weights * size * points[..., TRACTION]).sum())


def test_the_law_at_rest_is_what_the_closed_form_is_given() -> None:
    parameters = tube(SMALL).materials["tissue"].parameters
    assert 0.5 * (parameters["c1"] + parameters["c2"]) == pytest.approx(MU)
    assert parameters["kappa"] == pytest.approx(LAME)


def test_a_tube_in_a_tight_tube_bears_lames_pressure() -> None:
    analysis, end = last(tube(SMALL, n=(8, 48, 1)))
    pressure = normal_force(analysis, end) / (2 * np.pi * OUTER * LENGTH)
    # 48 chords and 8 cells across: half a per cent; 0.1 % of strain: a tenth of that
    assert pressure == pytest.approx(lame_pressure(SMALL, MU, LAME), rel=0.01)
    assert np.abs(end.forces.bodies[0, :3]).max() < 1e-6 * normal_force(analysis, end)


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
    assert drag == pytest.approx(0.3 * normal_force(analysis, end), rel=1e-4)
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
    system.remember(system.search(start).state)
    state = system.moved(start, 1e-2 * rng.standard_normal(system.n_unknowns))
    forces = system.forces(state)
    assert forces.n_touching > 20
    direction = rng.standard_normal(system.n_unknowns)
    direction[system.n_tissue :] *= 0.1
    exact = assemble(system, state, forces.nodal).times(forces.contact, direction)
    h = 1e-7
    up, down = (system.forces(system.moved(state, s * h * direction)).residual for s in (1, -1))
    np.testing.assert_allclose((up - down) / (2 * h), exact, atol=1e-6 * abs(exact).max())


def turning(friction: float, rng: np.random.Generator) -> tuple[System, ContactState, State]:
    """The tight tube, whose socket is free in all motions and has slid a little."""
    model = replace(tube(1.0, n=(2, 24, 4), friction=friction), drives=())
    system = System(model, threads=1)
    start = system.prescribed(system.rest(), 0.9)
    system.at(0.9)
    system.remember(system.search(start).state)
    step = 2e-2 * rng.standard_normal(system.n_unknowns)
    step[system.n_tissue :] += [0.2, 0.1, 1.0, 0.1, 0.2, 0.1]
    state = system.moved(start, step)
    return system, system.search(state), state


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_the_rows_of_a_socket_that_turns_are_those_of_the_tangent(
    friction: float, rng: np.random.Generator
) -> None:
    """With friction the moments are taken at the skin, the overlap of 1 mm beside the wall."""
    system, contact, _ = turning(friction, rng)
    step = np.concatenate([rng.standard_normal(system.n_tissue), np.zeros(6)])
    exact = system.contact_change(contact, step)[system.n_tissue :]
    rows = system.contact_rows(contact) @ step[: system.n_tissue]
    np.testing.assert_allclose(rows[:3], exact[:3], rtol=1e-9)
    np.testing.assert_allclose(rows[3:], exact[3:], atol=(0.05 if friction else 1e-9) * abs(exact[3:]).max())


def test_a_socket_that_turns_freely_takes_few_more_krylov_iterations_than_a_held_one(
    rng: np.random.Generator,
) -> None:
    system, contact, state = turning(0.3, rng)
    linearised = Linearised(system, Settings(threads=1), Counts())
    forces = system.forces(state)
    linearised.refresh(state, forces)
    rhs, n = rng.standard_normal(system.n_unknowns), system.n_tissue
    linearised.solve(contact, rhs, 1e-6)
    tangent = linearised.tangent
    assert tangent is not None

    def held(v: np.ndarray) -> np.ndarray:
        return tangent.times(contact, np.concatenate([v, np.zeros(6)]))[:n]

    _, n_held, _ = gmres(held, linearised.linear.solve, rhs[:n], tolerance=1e-6)
    assert linearised.counts.krylov <= 1.5 * n_held


def test_a_socket_around_a_whole_limb_is_not_eliminated_last() -> None:
    """Its dense front would outgrow the memory, or cost as much as all the rest."""
    few = System(tube(SMALL, n=(1, 8, 1)), threads=1)
    assert 0 < len(few.within_reach()) < 300
    many = System(tube(SMALL, n=(1, 200, 8)), threads=1)
    assert len(many.within_reach()) == 0
    a_tenth = System(tube(SMALL, n=(12, 60, 6)), threads=1)
    assert 1_000 < len(a_tenth.within_reach()) <= 0.1 * a_tenth.n_tissue
    a_third = System(tube(SMALL, n=(2, 60, 6)), threads=1)
    assert len(a_third.within_reach()) == 0


def test_a_block_between_plates_is_dragged_by_friction_times_the_squeeze() -> None:
    """Nothing else holds it: what one plate gives, the other takes."""
    base = block("hex8", (3, 3, 2), (10.0, 10.0, 8.0), material=ogden_type(c=0.02, f_kappa=2.0, m=2.0))
    cells = base.mesh.block("tissue").cells
    low = np.isin(cells[:, :4], base.mesh.node_sets["z0"]).all(axis=1)
    below = {"quad4": cells[low][:, [0, 3, 2, 1]]}
    n, blocks = len(base.mesh.points), list(base.mesh.blocks)
    corners, surfaces = [], {"top": Surface("top", top_facets(base)), "below": Surface("below", below)}
    for name, z, order in (("upper", -0.3, (0, 3, 2, 1)), ("lower", -7.7, (0, 1, 2, 3))):
        corners += [(x, y, z) for x, y in ((-10.0, -10.0), (20.0, -10.0), (20.0, 20.0), (-10.0, 20.0))]
        facet = n + np.array([order])
        n += 4
        blocks.append(Block(name, "quad4", facet))
        surfaces[f"{name}_face"] = Surface(f"{name}_face", {"quad4": facet})
    contacts = tuple(
        Contact(soft, f"{rigid}_face", name=rigid, penalty=200.0, search_radius=3.0, friction=0.3,
                symmetric=False, penalty_curve="donning")
        for soft, rigid in (("top", "upper"), ("below", "lower"))
    )  # fmt: skip
    held = tuple(Drive(name, dof, "fixed") for name in ("upper", "lower") for dof in MOVES)
    drag = Drive("upper", "x", "displacement", 3.0, "pull")
    squeeze = Step(n_steps=8, step_size=0.125, must_points=(1.0,), drives=held)
    pull = replace(
        squeeze, n_steps=6, step_size=0.5, must_points=(3.0,),
        drives=(*(d for d in held if (d.body, d.dof) != ("upper", "x")), drag),
    )  # fmt: skip
    model = replace(
        base,
        mesh=Mesh(np.concatenate([base.mesh.points, corners]), tuple(blocks), {}, surfaces),
        bodies=(RigidBody("upper", (5.0, 5.0, -0.3), ("upper",)),
                RigidBody("lower", (5.0, 5.0, -7.7), ("lower",))),
        contacts=contacts,
        curves={**tube(SMALL, n=(1, 8, 1)).curves, "pull": Curve(((1.0, 0.0), (4.0, 1.0)))},
        steps=(squeeze, pull),
    )  # fmt: skip
    _, end = last(model)
    upper, lower = end.forces.bodies
    assert abs(upper[2]) > 0.05
    assert abs(upper[0]) == pytest.approx(0.3 * abs(upper[2]), rel=0.01)
    np.testing.assert_allclose(upper[:3] + lower[:3], 0.0, atol=1e-4 * abs(upper[2]))
