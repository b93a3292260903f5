"""Contact with a rigid body: exact tangent, balance, FEBio's own forces, free and tied bodies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_models import block, punch

from limbcli.errors import SolveError
from limbcli.feb.read import read_feb
from limbcli.feb.records import read_records
from limbcli.fem.analysis import Analysis
from limbcli.fem.contacts.contact import make_pairs
from limbcli.fem.contacts.contact_points import FACET, GAP, TRACTION
from limbcli.fem.equilibrium.settings import Settings
from limbcli.fem.equilibrium.tangent import assemble
from limbcli.fem.motion.rigid import BodyState, rotation_matrix, spring_forces, whole_rotation
from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.materials.stress import _evaluate, penalty_modulus
from limbcli.model import LimbModel, Step, Support, Surface
from limbcli.model.bodies import Drive, RigidBody, Spring
from limbcli.progress import Progress

QUICK = Settings(tolerance=1e-8, threads=1)


def free_probe(model: LimbModel) -> LimbModel:
    return replace(model, drives=(Drive("probe", "z", "force", -0.01, "ramp"),))


def on_a_spring(model: LimbModel) -> LimbModel:
    """The base tied to a bone that hangs on a spring; all of the bone's motions free."""
    bone = RigidBody("bone", (6.0, 5.0, -8.0), node_sets=("z0",))
    ground = RigidBody("ground", (6.0, 5.0, -30.0))
    spring = Spring("support", "ground", "bone", 0.05, (6.0, 5.0, -20.0), (6.0, 5.5, -8.0), 12.0)
    held = tuple(Drive("ground", dof, "fixed") for dof in ("x", "y", "z", "u", "v", "w"))
    return replace(
        model,
        bodies=(*model.bodies, bone, ground),
        springs=(spring,),
        supports=(),
        drives=model.drives + held,
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8"])
@pytest.mark.parametrize("change", [lambda m: m, free_probe, on_a_spring])
def test_tangent_agrees_with_differences(kind: str, change, rng: np.random.Generator) -> None:
    """With the non-symmetric contact terms, rotations of bodies, tied nodes and springs."""
    system = System(change(punch(kind, (3, 2, 2))), threads=1)
    state = system.prescribed(system.rest(), 0.1)
    step = 2e-2 * rng.standard_normal(system.n_unknowns)
    state = system.moved(state, step)
    forces = system.forces(state)
    assert forces.n_touching > 3
    direction = rng.standard_normal(system.n_unknowns)
    direction[system.n_tissue :] *= 0.1
    exact = assemble(system, state, forces.nodal).times(forces.contact, direction)
    h = 1e-7
    up, down = (system.forces(system.moved(state, s * h * direction)).residual for s in (1, -1))
    np.testing.assert_allclose((up - down) / (2 * h), exact, atol=1e-6 * abs(exact).max())


def test_turns_weigh_as_much_in_a_large_model_as_in_a_small_one(rng: np.random.Generator) -> None:
    """Ten times as large, all forces are a hundred times as large: the relative residual is the same, which
    it is not if moments in N mm stand beside forces."""
    small, factor = on_a_spring(punch("tet4", (3, 2, 2))), 10.0
    (spring,), (contact,) = small.springs, small.contacts
    large = replace(
        small,
        mesh=replace(small.mesh, points=factor * small.mesh.points),
        bodies=tuple(
            replace(each, center_of_mass=tuple(factor * np.array(each.center_of_mass)))
            for each in small.bodies
        ),
        springs=(
            replace(
                spring, stiffness=factor * spring.stiffness, free_length=factor * spring.free_length,
                insertion_a=tuple(factor * np.array(spring.insertion_a)),
                insertion_b=tuple(factor * np.array(spring.insertion_b)),
            ),
        ),
        drives=tuple(replace(each, value=factor * each.value) for each in small.drives),
        contacts=(replace(contact, search_radius=factor * contact.search_radius),),
    )  # fmt: skip
    step, errors = None, []
    for model, size in ((small, 1.0), (large, factor)):
        system = System(model, threads=1)
        step = 2e-2 * rng.standard_normal(system.n_unknowns) if step is None else step
        state = system.moved(system.prescribed(system.rest(), 0.1), size * step)
        errors.append(system.forces(state).error)
    assert errors[1] == pytest.approx(errors[0], rel=1e-9)


def test_probe_force_balances_the_base() -> None:
    model = punch("tet4")
    last = Analysis(model, QUICK).run()[-1]
    base = last.forces.nodal[model.mesh.node_sets["z0"]].sum(axis=0)
    assert last.forces.bodies[0, 2] < 0  # pressed down from outside
    np.testing.assert_allclose(base + last.forces.bodies[0, :3], 0, atol=1e-6 * abs(base[2]))


def test_force_control_is_the_inverse_of_displacement_control() -> None:
    model = punch("tet4", depth=0.6)
    pressed = Analysis(model, QUICK).run()[-1]
    force = pressed.forces.bodies[0, 2]
    others = (d for d in model.drives if d.dof != "z")
    drives = (*others, Drive("probe", "z", "force", force, "ramp"))
    driven = Analysis(replace(model, drives=drives), QUICK).run()[-1]
    assert driven.state.bodies[0].shift[2] == pytest.approx(pressed.state.bodies[0].shift[2], rel=1e-5)


def test_turned_scene_gives_turned_force(rng: np.random.Generator) -> None:
    """Everything rotated, probe and its way too: the force rotates with it."""
    model = punch("tet4", (3, 2, 2), depth=0.4, levels=1)
    Q = rotation_matrix(np.array([0.4, -0.3, 0.2]))
    center = np.array(model.bodies[0].center_of_mass)
    body = replace(model.bodies[0], center_of_mass=tuple(Q @ center))
    way = Q @ np.array([0.0, 0.0, model.drives[-1].value])
    drives = tuple(Drive("probe", d, "displacement", float(way[k]), "ramp") for k, d in enumerate("xyz"))
    drives += tuple(Drive("probe", d, "fixed") for d in "uvw")
    mesh = replace(model.mesh, points=model.mesh.points @ Q.T)
    turned = replace(model, mesh=mesh, bodies=(body,), drives=drives)
    # facets with normals off the axes get another automatic penalty: give both a plain one
    plain = replace(model.contacts[0], auto_penalty=False, penalty=0.05)
    first, second = (
        Analysis(replace(m, contacts=(plain,)), QUICK).run()[-1].forces.bodies[0] for m in (model, turned)
    )
    np.testing.assert_allclose(second[:3], Q @ first[:3], atol=1e-5 * abs(first[2]))


def test_rotations_follow_each_other_like_their_matrices(rng: np.random.Generator) -> None:
    """Also beyond half a turn and beyond a whole one."""
    for _ in range(20):
        first, second = rng.uniform(-3, 3, (2, 3))
        both = whole_rotation(second, first)
        np.testing.assert_allclose(
            rotation_matrix(both), rotation_matrix(second) @ rotation_matrix(first), atol=1e-13
        )


def test_spring_is_in_balance_and_pulls() -> None:
    model = on_a_spring(punch("tet4"))
    system = System(model, threads=1)
    both = {b.name: (b, BodyState(np.array([0.0, 0.0, 0.1]), np.zeros(3))) for b in system.bodies}
    both["ground"] = (both["ground"][0], BodyState(np.zeros(3), np.zeros(3)))
    on_a, on_b, _ = spring_forces(model.springs[0], both)
    np.testing.assert_allclose(on_a[:3], -on_b[:3])
    line = np.array([0.0, 0.5, 12.1])
    tension = 0.05 * (np.linalg.norm(line) - 12.0)
    np.testing.assert_allclose(on_b[:3], -tension * line / np.linalg.norm(line), rtol=1e-12)


def test_one_and_two_threads_agree() -> None:
    one, two = (
        Analysis(
            punch("tet10", (3, 2, 2), depth=0.3, levels=1), replace(QUICK, tolerance=1e-11, threads=n)
        ).run()[-1]
        for n in (1, 2)
    )
    np.testing.assert_allclose(one.state.u, two.state.u, atol=1e-9)
    assert one.forces.bodies[0, 2] == pytest.approx(two.forces.bodies[0, 2], rel=1e-9)


def test_probe_without_contact_that_is_free_is_named() -> None:
    model = punch("tet4", (2, 2, 2))
    points = model.mesh.points.copy()
    points[-4:, 2] += 3.0  # lifted off the skin
    others = (d for d in model.drives if d.dof != "z")
    drives = (*others, Drive("probe", "z", "force", -0.1, "ramp"))
    lifted = replace(model, mesh=replace(model.mesh, points=points), drives=drives)
    with pytest.raises(SolveError, match="'probe' moves freely along 'z'"):
        Analysis(lifted, QUICK).run()


@pytest.mark.parametrize("kind", ["tet4", "tet10"])
@pytest.mark.parametrize("height", [0.02, 2.0])
def test_a_probe_that_touches_nothing_at_first_gives_the_force_of_one_that_does(
    kind: str, height: float
) -> None:
    """The way down counts for nothing; a level in the air has no force."""
    below = punch(kind, (3, 2, 2), levels=1)
    points = below.mesh.points.copy()
    points[-4:, 2] += 0.05 + height
    *held, down = below.drives
    above = replace(
        below,
        mesh=replace(below.mesh, points=points),
        bodies=(replace(below.bodies[0], center_of_mass=(6.0, 5.0, height)),),
        drives=(*held, replace(down, value=down.value - 0.05 - height)),
        steps=(replace(below.steps[0], must_points=(0.5 * height / (1.0 + height), 1.0)),),
    )
    in_air, pressed = Analysis(above, QUICK).run()
    assert in_air.forces.n_touching == 0
    assert abs(in_air.forces.bodies).max() == 0.0
    expected = Analysis(below, QUICK).run()[-1].forces.bodies[0, 2]
    assert pressed.forces.bodies[0, 2] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("first", [0.5, 1.0])
def test_a_probe_from_afar_does_not_pass_the_skin_unseen(first: float) -> None:
    """Increments on the way in the air are no longer than contact is searched for; as are FEBio's steps."""
    model = punch("tet4", (3, 2, 2), levels=1)
    points = model.mesh.points.copy()
    points[-4:, 2] += 3.0
    *held, down = model.drives
    above = replace(
        model,
        mesh=replace(model.mesh, points=points),
        bodies=(replace(model.bodies[0], center_of_mass=(6.0, 5.0, 2.95)),),
        drives=(*held, replace(down, value=down.value - 3.0)),
        contacts=(replace(model.contacts[0], search_radius=0.3),),
        steps=(Step(n_steps=50, step_size=0.02, must_points=(first,)),),
    )
    expected = Analysis(model, QUICK).run()[-1].forces.bodies[0, 2]
    assert Analysis(above, QUICK).run()[-1].forces.bodies[0, 2] == pytest.approx(expected, rel=1e-5)


def test_the_depth_that_is_told_is_that_of_the_body_in_contact() -> None:
    model = punch("tet4", (2, 2, 2), depth=0.4, levels=1)
    bone = RigidBody("bone", (6.0, 5.0, -25.0), node_sets=("z0",))
    held = tuple(Drive("bone", dof, "fixed") for dof in "xyzuvw")
    both = replace(model, bodies=(bone, *model.bodies), drives=(*held, *model.drives), supports=())
    depths: list[float] = []
    Analysis(both, QUICK, Progress(lambda kind, facts: depths.append(facts["depth"]))).run()
    assert depths[-1] == pytest.approx(0.4)


def test_a_body_under_force_has_a_load_and_no_depth() -> None:
    model = punch("tet4", (2, 2, 2), depth=0.4, levels=1)
    (down,) = [each for each in model.drives if each.kind == "displacement"]
    pushed = Drive(down.body, "z", "force", -0.02, down.curve)
    others = [each for each in model.drives if each is not down]
    told: list[tuple[float | None, str]] = []
    listener = Progress(lambda _kind, facts: told.append((facts["depth"], facts["aim"])))
    Analysis(replace(model, drives=(*others, pushed)), QUICK, listener).run()
    assert told[-1] == (None, "force 0.02 N")


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_gap_does_not_jump_where_the_wall_bends(friction: float) -> None:
    """A roof, its ridge down, and the block moved under it by small steps. Kept by the plane of the slope
    that it had left for a hundredth of that, a point's gap jumped by 0.015 mm."""
    model = punch("tet4")
    first, n = int(model.mesh.blocks[-1].cells.min()), len(model.mesh.points)
    ridge = np.array([(6.0, y, -1.55) for y in model.mesh.points[[first, first + 2], 1]])
    slopes = np.array([[first, first + 2, n + 1, n], [n, n + 1, first + 3, first + 1]])
    mesh = replace(
        model.mesh, points=np.concatenate([model.mesh.points, ridge]),
        blocks=(*model.mesh.blocks[:-1], replace(model.mesh.blocks[-1], cells=slopes)),
        surfaces={**model.mesh.surfaces, "face": Surface("face", {"quad4": slopes})},
    )  # fmt: skip
    contacts = tuple(replace(each, friction=friction) for each in model.contacts)
    system = System(replace(model, mesh=mesh, contacts=contacts), threads=1)
    state, gaps, facets = system.rest(), [], []
    for shift in np.linspace(0.0, 2.0, 1001):
        moved = replace(state, u=np.where(system.coupled[:, None], [shift, 0.0, 0.0], 0.0))
        contact = system.search(moved)
        state = contact.state
        gaps.append(contact.points[0][0][..., GAP])
        facets.append(contact.points[0][0][..., FACET])
    assert (np.ptp(facets, axis=0) == 1.0).sum() > 3
    assert np.abs(np.diff(gaps, axis=0)).max() == pytest.approx(0.002 * 1.5 / 8.0, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_forces_are_a_function_of_the_state(friction: float, rng: np.random.Generator) -> None:
    """Whatever is evaluated in between; so is the tangent of the contact that was found there."""
    model = punch("tet10", (3, 2, 2))
    contact = replace(model.contacts[0], friction=friction)
    system = System(replace(model, contacts=(contact,)), threads=1)
    state = system.moved(system.prescribed(system.rest(), 0.2), 1e-2 * rng.standard_normal(system.n_unknowns))
    v = rng.standard_normal(system.n_unknowns)
    first = system.forces(state)
    change = system.contact_change(first.contact, v)
    deeper = system.forces(system.prescribed(state, 0.9))
    assert first.n_touching > 0
    assert np.abs(deeper.residual - first.residual).max() > np.abs(first.residual).max()
    np.testing.assert_array_equal(system.forces(state).residual, first.residual)
    np.testing.assert_array_equal(system.contact_change(first.contact, v), change)


def test_the_penalty_of_a_curved_triangle_is_along_the_normal_of_its_first_corner(
    rng: np.random.Generator,
) -> None:
    """As in FEBio 4.11: its stiffness depends on the direction. Area and volume are the curved ones."""
    model = punch("tet10", (3, 2, 2))
    x = model.mesh.points.copy()
    ((_, skin),) = model.mesh.surfaces[model.contacts[0].primary].facets.items()
    bent = np.unique(skin[:, 3:])
    x[bent, 2] += 0.3 * rng.uniform(-1.0, 1.0, len(bent))
    system = System(replace(model, mesh=replace(model.mesh, points=x)), threads=1)
    (patch,) = system.pairs[0].patches
    a, b, c, ab, _, ca = np.moveaxis(x[patch.facets], 1, 0)
    normal = np.cross(4 * ab - 3 * a - b, 4 * ca - 3 * a - c)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    program = system.groups[0].material.program(1, system.curve_at_first)
    S, C = np.zeros((1, 6)), np.zeros((1, 6, 6))
    _evaluate(np.eye(3)[None], program.ops, program.par[:1], S, C, True)
    E = penalty_modulus(np.repeat(C, len(normal), axis=0), normal)
    assert E.max() > 1.05 * E.min()
    volumes = system.groups[0].weight[patch.cell].sum(axis=1)
    np.testing.assert_allclose(patch.eps, model.contacts[0].penalty * E * patch.areas / volumes, rtol=1e-9)


def test_augmentations_go_on_as_febios() -> None:
    """Until multipliers and gap settle, within minaug and maxaug; without a tolerance there are none."""
    model = punch("hex8", (2, 2, 2), depth=0.5, levels=1)
    (step,) = model.steps
    model = replace(
        model, steps=(replace(step, n_steps=1, step_size=step.n_steps * step.step_size, dt_max=None),)
    )
    soft = replace(model.contacts[0], penalty=0.5, tolerance=0.1, augmented=True)

    def gap(more: dict[str, str] | None = None, **change: object) -> float:
        """The largest (mm) of the points that press at the end."""
        analysis = Analysis(replace(model, contacts=(replace(soft, more=more or {}, **change),)), QUICK)
        contact = analysis.run()[-1].forces.contact
        found = [points for pair in contact.points for points in pair]
        return max(float(points[points[..., TRACTION] > 0, GAP].max()) for points in found)

    plain = gap(augmented=False)
    assert gap(tolerance=0.0) == gap({"maxaug": "0"}) == plain
    settled = gap()
    assert settled < gap({"maxaug": "1"}) < plain
    assert gap({"maxaug": "50"}, gap_tolerance=1e-3) <= 1e-3 < settled
    assert gap({"maxaug": "50"}, gap_tolerance=1e-3, tolerance=0.0) <= 1e-3
    assert gap({"minaug": "8"}) < settled / 2


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"two_pass": True}, "two_pass"),
        ({"more": {"tension": "1"}}, "tension"),
        ({"more": {"node_reloc": "1"}}, "node_reloc"),
        ({"augmented": True, "more": {"smooth_aug": "1"}}, "smooth_aug"),
    ],
)
def test_contact_that_is_not_supported_is_named(change: dict, word: str) -> None:
    model = punch("tet4", (2, 2, 2))
    model = replace(model, contacts=(replace(model.contacts[0], **change),))
    system = System(replace(model, contacts=()), threads=1)
    with pytest.raises(SolveError, match=word):
        make_pairs(model, system.groups, system.bodies)


def test_facets_need_cells_behind_them() -> None:
    model = punch("tet4", (2, 2, 2))
    other = block("tet4", (2, 2, 2), (12.0, 10.0, 8.0)).mesh.blocks[0]
    mesh = replace(model.mesh, blocks=(replace(other, cells=other.cells[:6]), model.mesh.blocks[1]))
    with pytest.raises(SolveError, match="no cell behind"):
        System(replace(model, mesh=mesh, supports=(Support("z1", ("x", "y", "z")),)), threads=1)


@pytest.mark.parametrize(
    ("folder", "tolerance"),
    [
        ("punch-tet4", 1e-8),
        ("punch-tet4-penalty-x10", 1e-8),
        ("punch-tet4-tilt7", 1e-8),
        ("punch-tet10-quarter", 1e-8),
        ("punch-tet10-deep", 1e-8),
        ("effect-map", 1e-8),
        ("effect-skin", 1e-8),
        ("effect-fibre", 1e-8),
        ("effect-contraction", 1e-8),
        ("punch-tet10-tilt7", 1e-5),
        ("punch-tet4-feb-probe", 1e-3),  # lines that meet two facets at once: FEBio keeps an earlier one
    ],
)
def test_force_from_febios_displacements_is_febios(golden: Path, folder: str, tolerance: float) -> None:
    """The contact law alone, point by point: force and moments from the logged displacements."""
    model = read_feb(next((golden / folder).glob("model.feb*")))
    nodes = next((golden / folder).glob("nodes.csv*"))
    if nodes.suffix == ".gz":
        import gzip

        text = gzip.decompress(nodes.read_bytes()).decode()
        table = np.array(
            [line.split(",") for line in text.splitlines() if not line.startswith("*")], dtype=float
        )
        time = float(next(line for line in text.splitlines() if line.startswith("*Time")).split("=")[1])
    else:
        found = read_records(nodes)
        table, time = np.column_stack([found.ids, found.values[-1]]), found.times[-1]
    body = read_records(golden / folder / "rigid_body.csv")
    expected = body.values[np.argmin(abs(body.times - time))][0, 6:12]
    system = System(model, threads=1)
    system.at(time)
    state = system.prescribed(system.rest(), time)
    u = state.u.copy()
    u[: len(table)] = table[:, 1:4]
    ours = system.forces(system.followed(State(time, u, state.bodies))).bodies[0]
    np.testing.assert_allclose(ours[:3], expected[:3], atol=tolerance * abs(expected[2]))
    np.testing.assert_allclose(ours[3:], expected[3:], atol=100 * tolerance * abs(expected[2]))
