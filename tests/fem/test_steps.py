"""Analyses of several steps: what a step begins with, absolute and relative loads, by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import block, punch

from limbcli.errors import SolveError
from limbcli.fem.analysis import Analysis
from limbcli.fem.equilibrium.settings import Settings
from limbcli.fem.motion.kinematics import Kinematics
from limbcli.fem.motion.rigid import AT_REST
from limbcli.fem.motion.state import State
from limbcli.materials import ogden_type
from limbcli.materials.stress import cauchy_stress
from limbcli.model import Curve, Curved, LimbModel, Material, Step, Support
from limbcli.model.bodies import Drive, RigidBody
from limbcli.solvers.session import path_dependent

QUICK = Settings(tolerance=1e-11, threads=1)
CURVES = {"first": Curve(((0.0, 0.0), (1.0, 1.0))), "second": Curve(((1.0, 0.0), (3.0, 1.0)), "smooth")}


def squeezed() -> LimbModel:
    """A cube held sideways, on a held base: its stretch along z is all that can change."""
    model = block("tet10", (1, 1, 1))
    return replace(model, curves=CURVES, supports=(Support("all", ("x", "y")), Support("z0", ("z",))))


def pull(stretch: float, model: LimbModel) -> float:
    """Force on the unit top of the cube in uniaxial strain."""
    F = np.diag([1.0, 1.0, stretch])[None]
    return float(cauchy_stress(model.materials["tissue"], F)[0, 2, 2])


@pytest.mark.parametrize("relative", [False, True])
def test_second_step_starts_where_the_first_ended(relative: bool) -> None:
    """-0.1 in the first; then to (or by) 0.04, on a curve that is 1/2 half-way."""
    model = squeezed()
    steps = (
        Step(2, 0.5, supports=(Support("z1", ("z",), -0.1, "first"),)),
        Step(2, 1.0, supports=(Support("z1", ("z",), 0.04, "second", relative),)),
    )
    model = replace(model, steps=steps)
    snapshots = Analysis(model, QUICK).run()
    assert [s.state.time for s in snapshots] == [0.5, 1.0, 2.0, 3.0]
    base = -0.1 if relative else 0.0
    top = model.mesh.node_sets["z1"]
    for snapshot, expected in zip(snapshots, (-0.05, -0.1, base + 0.02, base + 0.04), strict=True):
        np.testing.assert_allclose(snapshot.state.u[top, 2], expected, atol=1e-12)
        assert snapshot.forces.nodal[top, 2].sum() == pytest.approx(pull(1 + expected, model), rel=1e-9)


@pytest.mark.parametrize("relative", [False, True])
def test_rigid_plate_goes_on_from_the_first_step(relative: bool) -> None:
    """The top tied to a plate: driven down, then up by force control of the same size as by hand."""
    model = squeezed()
    plate = RigidBody("plate", (0.5, 0.5, 0.0), node_sets=("z1",))
    still = tuple(Drive("plate", dof, "fixed") for dof in ("x", "y", "u", "v", "w"))
    base = -0.1 if relative else 0.0
    steps = (
        Step(1, 1.0, drives=(Drive("plate", "z", "displacement", -0.1, "first"),)),
        Step(1, 2.0, drives=(Drive("plate", "z", "displacement", 0.04, "second", relative),)),
    )
    supports = (Support("z0", ("x", "y", "z")), *(Support(k, (k[0],)) for k in ("x0", "x1", "y0", "y1")))
    model = replace(model, bodies=(plate,), drives=still, steps=steps, supports=supports)
    first, second = Analysis(model, QUICK).run()
    assert first.forces.bodies[0, 2] == pytest.approx(pull(0.9, model), rel=1e-9)
    assert second.state.bodies[0].shift[2] == pytest.approx(base + 0.04)
    assert second.forces.bodies[0, 2] == pytest.approx(pull(1.04 + base, model), rel=1e-9)


def test_what_is_relative_through_all_steps_is_so_to_rest() -> None:
    """A support and a plate that no step has for its own: FEBio takes their start once, before any load."""
    model = squeezed()
    plate = RigidBody("plate", (0.5, 0.5, 0.0), node_sets=("z1",))
    drives = (
        *(Drive("plate", dof, "fixed") for dof in ("x", "y", "u", "v", "w")),
        Drive("plate", "z", "displacement", -0.1, "first", relative=True),
    )
    down = replace(model, supports=(*model.supports, Support("z1", ("z",), -0.1, "first", relative=True)))
    for each in (down, replace(model, bodies=(plate,), drives=drives)):
        last = Analysis(replace(each, steps=(Step(1, 0.5), Step(1, 0.5), Step(1, 0.5))), QUICK).run()[-1]
        np.testing.assert_allclose(last.state.u[model.mesh.node_sets["z1"], 2], -0.1, atol=1e-12)


def test_a_force_after_a_displacement_finds_the_same_place() -> None:
    model = squeezed()
    plate = RigidBody("plate", (0.5, 0.5, 0.0), node_sets=("z1",))
    still = tuple(Drive("plate", dof, "fixed") for dof in ("x", "y", "u", "v", "w"))
    force = pull(0.93, model)
    steps = (
        Step(1, 1.0, drives=(Drive("plate", "z", "displacement", -0.1, "first"),)),
        Step(1, 2.0, drives=(Drive("plate", "z", "force", force, "second"),)),
    )
    supports = (Support("z0", ("x", "y", "z")), *(Support(k, (k[0],)) for k in ("x0", "x1", "y0", "y1")))
    model = replace(model, bodies=(plate,), drives=still, steps=steps, supports=supports)
    last = Analysis(model, QUICK).run()[-1]
    assert last.state.bodies[0].shift[2] == pytest.approx(-0.07, abs=1e-9)


def in_two(model: LimbModel, n_first: int) -> LimbModel:
    """The same load in two steps that each state all of it."""
    (step,) = model.steps
    supports, drives = model.supports, model.drives
    parts = [
        replace(step, n_steps=n_first, supports=supports, drives=drives),
        replace(step, n_steps=step.n_steps - n_first, supports=supports[::-1], drives=drives[::-1]),
    ]
    return replace(model, steps=tuple(parts), supports=(), drives=())


def test_a_viscoelastic_law_keeps_its_memory_over_steps() -> None:
    """A ramp of 0.2 s that is then held, of which 0.5 s are a step of their own."""
    model = squeezed()
    tissue = Material("viscoelastic", {"g1": 0.8, "t1": 0.5}, (model.materials["tissue"],))
    pressed = Support("z1", ("z",), -0.2, "press")
    model = replace(
        model,
        materials={"tissue": tissue},
        curves={"press": Curve(((0.0, 0.0), (0.2, 1.0)))},
        supports=(*model.supports, pressed),
        steps=(Step(12, 0.1, adaptive=False),),
    )
    forces = [
        [s.forces.nodal[model.mesh.node_sets["z1"], 2].sum() for s in Analysis(each, QUICK).run()]
        for each in (model, in_two(model, 5))
    ]
    assert forces[0][4] < 1.05 * forces[0][-1] < 0.0  # it relaxes
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-9)


@pytest.mark.parametrize("change", [{}, {"augmented": True, "more": {"maxaug": "1"}}])
def test_a_contact_stays_as_hard_over_steps(change: dict) -> None:
    """Its penalty is that of the tissue at first, though this stiffens; its multipliers are kept."""
    tissue = ogden_type(c=0.005, f_kappa=5.0, m=2.0)
    stiffer = {key: Curved(float(tissue.parameters[key]), "stiff") for key in ("c1", "c2", "kappa")}
    model = punch("hex8", (2, 2, 2), depth=0.5, material=tissue.with_parameters(**stiffer))
    contact = replace(model.contacts[0], penalty=1.0, tolerance=1e-4, **change)
    curves = {**model.curves, "stiff": Curve(((0.0, 1.0), (1.0, 3.0)))}
    model = replace(model, contacts=(contact,), curves=curves, steps=(Step(4, 0.25, adaptive=False),))
    forces = [
        [s.forces.bodies[0, 2] for s in Analysis(each, QUICK).run()] for each in (model, in_two(model, 2))
    ]
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-7)


def test_a_prestrained_viscoelastic_law_relaxes() -> None:
    """Of a prestrain that is none, it is the viscoelastic law itself."""
    model = squeezed()
    viscoelastic = Material("viscoelastic", {"g1": 0.8, "t1": 0.5}, (model.materials["tissue"],))
    nothing = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    pressed = Support("z1", ("z",), -0.2, "first")
    model = replace(model, supports=(*model.supports, pressed), steps=(Step(4, 0.25, adaptive=False),))
    forces = []
    for tissue in (viscoelastic, Material("prestrain", {"F0": nothing, "ramp": 1.0}, (viscoelastic,))):
        each = model.with_material("tissue", tissue)
        assert path_dependent(each)
        snapshots = Analysis(each, QUICK).run()
        forces.append([s.forces.nodal[model.mesh.node_sets["z1"], 2].sum() for s in snapshots])
    assert forces[0][-1] < 1.2 * pull(0.8, model) < 0.0
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-9)


@pytest.mark.parametrize(
    ("driven", "relative", "turn"),
    [
        ({}, False, (0.2, 0.0, 0.0)),
        ({"v": 0.3}, False, (0.0, 0.3, 0.0)),
        ({"u": 0.1, "v": 0.3, "w": 0.0}, True, (0.3, 0.3, 0.0)),
    ],
)
def test_a_second_steps_rotations_are_febios(
    driven: dict[str, float], relative: bool, turn: tuple[float, ...]
) -> None:
    """After 0.2 about x: held; one driven, which takes those that are fixed to 0; all driven from there."""
    model = punch("hex8", (1, 1, 1))
    before = replace(AT_REST, rotation=np.array([0.2, 0.0, 0.0]))
    start = State(1.0, np.zeros_like(model.mesh.points), (before,))
    drives = tuple(
        Drive("probe", dof, "rotation", driven[dof], relative=relative)  # type: ignore[arg-type]
        if dof in driven
        else Drive("probe", dof, "fixed")  # type: ignore[arg-type]
        for dof in "xyzuvw"
    )
    after = Kinematics(model, (), drives, start, []).prescribed(start, 2.0)
    np.testing.assert_allclose(after.bodies[0].rotation, turn, atol=1e-14)


def test_relative_and_absolute_rotations_together_are_refused() -> None:
    model = punch("hex8", (1, 1, 1), depth=0.2)
    drives = (
        *model.drives[:3],
        Drive("probe", "v", "rotation", 0.01, "ramp", relative=True),
        Drive("probe", "w", "rotation", 0.01, "ramp"),
        model.drives[-1],
    )
    model = replace(model, drives=(), steps=(replace(model.steps[0], drives=drives),))
    with pytest.raises(SolveError, match="relative and absolute"):
        Analysis(model, QUICK).run()


@pytest.mark.parametrize("second", ["ramp", None])
def test_loads_on_one_degree_of_freedom_add_up(second: str | None) -> None:
    model = punch("hex8", (2, 2, 2))
    model = replace(model, steps=(Step(1, 1.0, adaptive=False),))
    load = Drive("probe", "z", "force", -0.01, "ramp")
    ends = [
        Analysis(replace(model, drives=(*model.drives[:-1], *loads)), QUICK).run()[-1]
        for loads in ((load, replace(load, curve=second)), (replace(load, value=-0.02),))
    ]
    assert ends[0].forces.bodies[0, 2] == pytest.approx(-0.02, rel=1e-6)
    assert ends[0].state.bodies[0].shift[2] == pytest.approx(ends[1].state.bodies[0].shift[2], rel=1e-6)
