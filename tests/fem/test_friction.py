"""Coulomb friction under the probe: exact tangent, stick and slip by hand, energy, FEBio's own forces."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from small_models import block, punch

from limbcli.errors import SolveError
from limbcli.fem.analysis import Analysis, Snapshot
from limbcli.fem.contacts import friction_kernels
from limbcli.fem.contacts.contact_points import GAP, TRACTION
from limbcli.fem.contacts.contact_state import ContactState
from limbcli.fem.derivatives.parameters import LawParameter
from limbcli.fem.derivatives.sensitivity import sensitivities
from limbcli.fem.equilibrium.newton import Newton
from limbcli.fem.equilibrium.settings import LoadStep, Settings
from limbcli.fem.equilibrium.tangent import assemble
from limbcli.fem.linear_solvers.krylov import gmres
from limbcli.fem.motion.state import Forces, State
from limbcli.fem.system import System
from limbcli.materials import ogden_type
from limbcli.model import Curve, Curved, ElementMap, LimbModel, Material, Step, Support, Value
from limbcli.model.bodies import Drive
from limbcli.solvers.reference import prepare
from limbcli.solvers.session import ReferenceSession
from limbcli.solvers.session_options import StopWhen
from limbcli.solvers.session_parameters import nudged

QUICK = Settings(tolerance=1e-8, threads=1)


def rubbing(model: LimbModel, mu: float = 0.3) -> LimbModel:
    contacts = tuple(replace(each, friction=mu, symmetric=False) for each in model.contacts)
    return replace(model, contacts=contacts)


def dragged(x: float, *, mu: float = 0.3) -> LimbModel:
    """One brick, its nodes free to move up and down only, pressed by 0.5 mm, the plate then pulled by x."""
    drives = (
        *(Drive("probe", dof, "fixed") for dof in ("y", "u", "v", "w")),
        Drive("probe", "z", "displacement", -0.45, "press"),
        Drive("probe", "x", "displacement", x, "pull"),
    )
    model = punch("hex8", (1, 1, 1), drives=drives, width=40.0)
    curves = {"press": Curve(((0.0, 0.0), (1.0, 1.0))), "pull": Curve(((1.0, 0.0), (2.0, 1.0)))}
    supports = (*model.supports, Support("all", ("x", "y")))
    steps = (Step(n_steps=2, step_size=1.0),)
    return rubbing(replace(model, curves=curves, supports=supports, steps=steps), mu)


def last(model: LimbModel) -> tuple[Analysis, Snapshot]:
    analysis = Analysis(model, QUICK)
    return analysis, analysis.run()[-1]


@pytest.mark.slow
def test_slipping_brick_resists_with_mu_times_pressure() -> None:
    _, end = last(dragged(2.0))
    force = end.forces.bodies[0]
    assert force[2] < 0
    assert force[0] == pytest.approx(-0.3 * force[2], rel=1e-9)
    assert force[1] == pytest.approx(0.0, abs=1e-9 * abs(force[2]))


def test_sticking_brick_resists_with_the_penalty() -> None:
    analysis, end = last(dragged(1e-4))
    eps = analysis.system.pairs[0].patches[0].eps[0]
    assert end.forces.bodies[0, 0] == pytest.approx(eps * 120.0 * 1e-4, rel=1e-9)
    assert end.forces.bodies[0, 0] < -0.3 * end.forces.bodies[0, 2]


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8"])
@pytest.mark.parametrize(("free", "pulled"), [(False, False), (True, False), (False, True)])
def test_tangent_agrees_with_differences(
    kind: str, free: bool, pulled: bool, rng: np.random.Generator
) -> None:
    """Sticking and slipping points, some of them new; a body that turns as well; multipliers."""
    model = rubbing(punch(kind, (3, 2, 2)), 0.2 if free else 0.03)
    if free:
        model = replace(model, drives=(Drive("probe", "z", "force", -0.01, "ramp"),))
    system = System(model, threads=1)
    state = system.prescribed(system.rest(), 0.1)
    state = system.moved(state, 1e-2 * rng.standard_normal(system.n_unknowns))
    system.remember(system.search(state).state)
    if pulled:  # shear of the size of what friction bears
        for patch, pull in zip(system.pairs[0].patches, system.pairs[0].pulls, strict=True):
            pull[:] = 0.003 * patch.eps[:, None, None] * rng.standard_normal(pull.shape)
    step = 1.2e-2 * rng.standard_normal(system.n_unknowns)
    state = system.moved(system.prescribed(state, 0.14), step)
    forces = system.forces(state)
    sticks = [points[..., friction_kernels.STICKS] > 0 for points in forces.contact.points[0]]
    n_sticking = sum(int(each.sum()) for each in sticks)
    assert 2 < n_sticking < forces.n_touching - 2
    direction = rng.standard_normal(system.n_unknowns)
    direction[system.n_tissue :] *= 0.1
    exact = assemble(system, state, forces.nodal).times(forces.contact, direction)
    h = 1e-7
    up, down = (system.forces(system.moved(state, s * h * direction)).residual for s in (1, -1))
    np.testing.assert_allclose((up - down) / (2 * h), exact, atol=1e-6 * abs(exact).max())


@pytest.mark.slow
def test_a_factor_serves_where_all_skin_slips(rng: np.random.Generator) -> None:
    """That shear follows pressure makes the symmetric part of a slip's tangent indefinite. It is not in the
    factor: with it, GMRES needed 103 iterations here, and did not converge on a whole limb."""
    model = replace(dragged(3.0), mesh=punch("tet10", (3, 3, 2), width=40.0).mesh)
    contacts = tuple(replace(each, penalty=400.0) for each in model.contacts)
    analysis = Analysis(
        replace(model, supports=model.supports[:1], contacts=contacts), replace(QUICK, linear="superlu")
    )
    state = analysis.run()[-1].state
    system, linearised = analysis.system, analysis.newton.linearised
    forces = system.forces(state)
    contact = forces.contact
    assert not any((points[..., friction_kernels.STICKS] > 0).any() for points in contact.points[0])
    linearised.refresh(state, forces)
    tangent, inverse = linearised.tangent, linearised.inverse
    assert tangent is not None
    assert inverse is not None
    _, n, reached = gmres(
        lambda v: tangent.times(contact, v), inverse, rng.standard_normal(system.n_unknowns),
        tolerance=1e-8, max_iterations=200,
    )  # fmt: skip
    assert reached <= 1e-8
    assert n < 30


def test_traction_does_not_jump_where_a_point_begins_to_slip(rng: np.random.Generator) -> None:
    """Facets that are not parallel to the plate, dragged under it by small steps: all points stick at first
    and slip in the end. Held by a spring to where they touched, they jumped by 0.02 mm of penetration."""
    system = System(rubbing(punch("tet4", (3, 2, 2)), 0.5), threads=1)
    state = system.prescribed(system.rest(), 0.5)
    state = system.moved(state, 0.15 * rng.standard_normal(system.n_unknowns))
    system.remember(system.search(state).state)
    found = []
    for shift in np.linspace(0.0, 0.4, 801):
        dragged_by = np.where(system.coupled[:, None], [shift, 0.5 * shift, 0.0], 0.0)
        found.append(system.search(replace(state, u=state.u + dragged_by)).points[0][0])
    sticks = [points[points[..., TRACTION] > 0, friction_kernels.STICKS].mean() for points in found]
    assert sticks[0] == 1.0
    assert sticks[-1] == 0.0
    tractions = np.stack([points[..., friction_kernels.PUSH : friction_kernels.PUSH + 3] for points in found])
    change = np.linalg.norm(np.diff(tractions, axis=0), axis=-1)
    eps = system.pairs[0].patches[0].eps[:, None]
    # a step of 0.5 um along each axis; the normals are at most 45 degrees from the plate's
    assert (change / eps).max() < 3.0 * 0.4 / 800


@pytest.mark.parametrize(("x", "mu", "slips"), [(0.02, 0.9, False), (3.0, 0.3, True)])
def test_augmented_friction_gives_nearly_what_a_stiff_penalty_gives(x: float, mu: float, slips: bool) -> None:
    """A block that sticks in part or slips under a plate, by a penalty that alone leaves a large gap."""
    model = replace(dragged(x, mu=mu), mesh=punch("hex8", (2, 2, 2), width=40.0).mesh)
    model = replace(model, supports=model.supports[:1])

    def end(**change: object) -> tuple[np.ndarray, float]:
        contacts = tuple(replace(each, **change) for each in model.contacts)
        _, at_end = last(replace(model, contacts=contacts))
        found = [points for pair in at_end.forces.contact.points for points in pair]
        stick = np.mean([(points[..., friction_kernels.STICKS] > 0).mean() for points in found])
        return at_end.forces.bodies[0, :3], float(stick)

    stiff, sticking = end(penalty=400.0)
    soft, _ = end(penalty=2.0)
    augmented, still = end(penalty=2.0, augmented=True, tolerance=1e-4, more={"maxaug": "40"})
    assert (sticking == 0.0) == slips == (still == 0.0)
    assert np.abs(soft - stiff).max() > 0.2 * np.abs(stiff).max()
    # both depend on the way; a stiff penalty alone forgets the shear of the step before
    np.testing.assert_allclose(augmented, stiff, atol=0.15 * np.abs(stiff).max())


def test_an_augmentation_without_an_equilibrium_is_taken_in_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every one is refused at first: half of each leads to the same, in more augmentations."""
    closing = {
        "augmented": True,
        "tolerance": 0.0,
        "gap_tolerance": 0.02,
        "penalty": 5.0,
        "more": {"maxaug": "40"},
    }
    model = dragged(0.2, mu=0.5)
    model = replace(model, contacts=tuple(replace(each, **closing) for each in model.contacts))
    _, plain = last(model)
    find, calls = Newton.equilibrate, []

    def refuse(self: Newton, guess: State, load_step: LoadStep, **options: object) -> tuple[State, Forces]:
        again = "forces" not in options and not (calls and calls[-1])
        calls.append(again)
        if again:
            raise self.failure(self.forces(guess), load_step, 0, "refused")
        return find(self, guess, load_step, **options)

    monkeypatch.setattr(Newton, "equilibrate", refuse)
    _, end = last(model)
    assert sum(calls) > 4
    assert abs(end.forces.contact.points[0][0][..., GAP]).max() <= 0.02
    assert end.forces.error <= 1e-8
    np.testing.assert_allclose(
        end.forces.bodies, plain.forces.bodies, atol=0.03 * abs(plain.forces.bodies).max()
    )


@pytest.mark.slow
@pytest.mark.parametrize("n_steps", [1, 40])
def test_augmented_friction_bears_its_share_of_the_pressure_however_small_the_steps(n_steps: int) -> None:
    """A step much shorter than the slip that the penalty needs for the full shear."""
    model = dragged(2.0)
    augmented = {"augmented": True, "tolerance": 1e-3, "penalty": 0.5}
    contacts = tuple(replace(each, **augmented) for each in model.contacts)
    steps = (Step(n_steps=2 * n_steps, step_size=1.0 / n_steps),)
    _, end = last(replace(model, contacts=contacts, steps=steps))
    force = end.forces.bodies[0]
    assert force[0] == pytest.approx(-0.3 * force[2], rel=1e-6)


def test_far_from_equilibrium_a_slip_is_resisted_along_its_way_too() -> None:
    """By mu p / |y| in every direction of the face, so that no iteration overshoots."""
    model = dragged(2.0)
    system = System(model, threads=1)
    pressed = system.prescribed(system.rest(), 1.0)
    system.remember(system.search(pressed).state)
    slipped = system.prescribed(pressed, 2.0)
    forces = system.forces(slipped)
    drag = abs(float(forces.bodies[0, 0]))
    assert drag > 0.0

    def resistance(along: int, *, far: bool) -> float:
        motions = np.zeros((1, 6))
        motions[0, along] = 1.0
        contact = replace(forces.contact, full_tangent=not far)
        _, bodies = system.contact_times(contact, np.zeros_like(system.X), motions)
        return -float(bodies[0, along])

    assert resistance(0, far=False) == pytest.approx(0.0, abs=1e-9 * drag)
    assert resistance(1, far=False) == pytest.approx(-drag / 2.0, rel=1e-9)
    assert resistance(0, far=True) == pytest.approx(-drag / 2.0, rel=1e-9)


def test_where_a_slip_has_turned_its_way_is_resisted_until_the_dual_shear_has_turned_too() -> None:
    """One search after the turn w points along the old slip: mu p (1 + 1) / |y|. The next one is exact."""
    model = dragged(2.0)
    pull = Curve(((1.0, 0.0), (2.0, 1.0), (3.0, -0.25)))
    system = System(replace(model, curves={**model.curves, "pull": pull}), threads=1)
    pressed = system.prescribed(system.rest(), 1.0)
    system.remember(system.search(pressed).state)
    forward, back = (system.prescribed(pressed, time) for time in (2.0, 3.0))
    drag = abs(float(system.forces(forward).bodies[0, 0]))
    motions = np.eye(1, 6)

    def resistance(contact: ContactState) -> float:
        return -float(system.contact_times(contact, np.zeros_like(system.X), motions)[1][0, 0])

    slips = system.search(forward)
    turned = system.search(back, before=slips)
    again = system.search(back, before=turned)
    found = [resistance(each) for each in (slips, turned, again)]
    assert found == pytest.approx([0.0, -2 * drag / 0.5, 0.0], abs=1e-9 * drag)


def indented(mu: float, *, cycle: bool = False) -> LimbModel:
    """A narrow plate pressed into a soft block, in steps, and drawn back where asked for."""
    model = punch("tet4", (6, 5, 3), depth=0.9, width=6.0, material=ogden_type(c=0.005, f_kappa=5.0, m=2.0))
    points = ((0.0, 0.0), (1.0, 1.0))
    if cycle:
        points = ((0.0, 0.0), (0.3, 0.25), (0.6, 1.0), (0.9, 0.25))
    steps = (Step(n_steps=9, step_size=0.1) if cycle else Step(n_steps=4, step_size=0.25),)
    return rubbing(replace(model, curves={"ramp": Curve(points)}, steps=steps), mu)


def test_without_friction_nothing_changes() -> None:
    _, none = last(indented(0.0))
    _, little = last(indented(1e-7))
    np.testing.assert_allclose(little.forces.bodies[0], none.forces.bodies[0], atol=1e-6)
    np.testing.assert_allclose(little.state.u, none.state.u, atol=1e-5)


def work(model: LimbModel) -> tuple[float, float]:
    """(N mm) of the probe from a quarter of its depth down and back, by the trapezoid rule; and down."""
    snapshots = Analysis(model, QUICK).run()[2:]
    z = np.array([s.state.bodies[0].shift[2] for s in snapshots])
    force = np.array([s.forces.bodies[0, 2] for s in snapshots])
    parts = 0.5 * (force[1:] + force[:-1]) * np.diff(z)
    return float(parts.sum()), float(parts[: len(parts) // 2].sum())


def test_a_closed_cycle_costs_work_with_friction_only() -> None:
    free, spent = work(indented(0.0, cycle=True))
    lost, _ = work(indented(0.4, cycle=True))
    assert abs(free) < 1e-6 * spent
    assert lost > 2e-3 * spent


def test_derivatives_are_differenced_and_never_taken_as_exact() -> None:
    """c scales all stresses and the penalty, hence the force with c."""
    model = indented(0.3)
    session = ReferenceSession(model, threads=1, tolerance=1e-9)
    wrt = [("tissue", name) for name in ("c1", "c2", "kappa")]
    result = session.solve(wrt=wrt)
    assert result.differenced
    values = model.materials["tissue"].parameters
    total = sum(values[name] * result.force_gradient["tissue", name] for _, name in wrt)
    np.testing.assert_allclose(total, result.must_points.forces, rtol=2e-3)
    analysis, end = last(model)
    with pytest.raises(SolveError, match="friction"):
        sensitivities(analysis.newton, end.state, end.forces, [LawParameter("tissue", {"c1": 1.0})])


def test_a_residual_that_stands_will_do_with_friction_alone() -> None:
    """Between stick and slip the pressure of a point jumps: the last digits may have no equilibrium."""
    for model, expected in ((indented(0.3), 1e-4), (indented(0.0), 0.0)):
        analysis = prepare(model, threads=1)
        assert analysis.settings.stalled == pytest.approx(expected)
        analysis.close()
    analysis = prepare(indented(0.3), threads=1, stalled=1e-2)
    assert analysis.settings.stalled == 1e-2
    analysis.close()


def test_a_block_far_from_the_probe_is_left_alone() -> None:
    model = block("tet4", (2, 2, 2))
    assert not model.remembers
    assert indented(0.1).remembers


def test_differenced_solves_take_all_that_was_asked() -> None:
    """Levels, the force that is enough, tied parameters, and which solves lead."""
    model = indented(0.3)
    with closing(ReferenceSession(model, threads=1, tolerance=1e-9)) as session:
        first = session.solve(
            stop=StopWhen(last=2), wrt=[("tissue", "m1-m2"), ("tissue", "m1"), ("tissue", "m2")]
        )
        led = session.kept_levels
        assert led is first.levels
        by = first.force_gradient
        assert len(first.must_points.times) == len(by["tissue", "m1"]) == 2
        tied, apart = by["tissue", "m1-m2"], by["tissue", "m1"] - by["tissue", "m2"]
        np.testing.assert_allclose(tied, apart, rtol=1e-3, atol=1e-3 * abs(by["tissue", "m1"]).max())
        enough = 0.9 * float(first.must_points.forces[0])
        short = session.solve(wrt=[("tissue", "c1")], stop=StopWhen(enough_force=enough), keep_levels=False)
        assert len(short.must_points.times) == len(short.force_gradient["tissue", "c1"]) == 1
        assert session.kept_levels is led
        assert session.model is model


def test_parameters_are_moved_wherever_they_are() -> None:
    """In wrapped laws and mixtures; maps along their weights, curves' factors, a prestrain's gradient."""
    law = ogden_type(c=0.005, f_kappa=5.0, m=-2.0)
    base = indented(0.3)
    n = len(base.mesh.block("tissue").cells)
    nothing = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    own = law.with_parameters(c1=ElementMap("c", "tissue", np.full(n, 0.004)), kappa=Curved(0.2, "ramp"))
    mixture = Material("mixture", {}, (law, own))
    wrapped = Material("viscoelastic", {"g1": 0.5, "t1": 1.0}, (mixture,))
    model = base.with_material("tissue", Material("prestrain", {"F0": nothing, "ramp": 1.0}, (wrapped,)))
    key = "tissue"

    def inner(changed: LimbModel, k: int) -> Mapping[str, Value]:
        (viscoelastic,) = changed.materials[key].parts
        assert viscoelastic.parameters == wrapped.parameters
        return viscoelastic.parts[0].parts[k].parameters

    changed, step = nudged(model, (key, "0.m1"), 0.1)  # up, though it is negative
    assert inner(changed, 0)["m1"] == pytest.approx(float(law.parameters["m1"]) + step)
    changed, step = nudged(model, (key, "1.kappa"), -0.1)
    assert inner(changed, 1)["kappa"] == Curved(0.2 - step, "ramp")
    weights = np.linspace(0.0, 2.0, n)
    changed, step = nudged(model, (key, "1.c1"), 0.1, along=weights)
    assert step == pytest.approx(0.1 * 0.004 / 2.0)
    np.testing.assert_allclose(inner(changed, 1)["c1"].values, 0.004 + step * weights)
    changed, step = nudged(model, (key, "F0a"), 0.1, along=np.diag([1.0, 0.0, -1.0]))
    assert changed.materials[key].parameters["F0"][::4] == pytest.approx((1.0 + step, 1.0, 1.0 - step))
    for name, words in (("m1", "several"), ("c9", "None"), ("F0", "weights")):
        with pytest.raises(SolveError, match=words):
            nudged(model, (key, name), 0.1)
