"""Pressure, traction, body and nodal forces: closed forms, balances, and the tangent by differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import block, cells_of, grid, top_facets

from limbcli.errors import SolveError
from limbcli.fem.analysis import Analysis
from limbcli.fem.equilibrium.settings import Settings
from limbcli.fem.equilibrium.tangent import assemble
from limbcli.fem.motion.state import State
from limbcli.fem.record_fields import cell_fields
from limbcli.fem.system import System
from limbcli.model import Block, Domain, LimbModel, Load, Material, Mesh, Support, Surface
from limbcli.model.bodies import Drive, RigidBody
from limbcli.numbers.math_expressions import Formula

TIGHT = Settings(tolerance=1e-11, threads=1)
NEO = Material("neo_hooke", {"mu": 0.01, "lambda": 0.02}, density=1e-9)
ROLLERS = (Support("x0", ("x",)), Support("y0", ("y",)), Support("z0", ("z",)))
FACES = {
    "tet4": ("tri3", ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))),
    "tet10": ("tri6", ((0, 2, 1, 6, 5, 4), (0, 1, 3, 4, 8, 7), (1, 2, 3, 5, 9, 8), (0, 3, 2, 7, 9, 6))),
    "hex8": (
        "quad4",
        ((4, 5, 6, 7), (0, 3, 2, 1), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    ),
}


def skin_of(kind: str, cells: np.ndarray) -> dict[str, np.ndarray]:
    """The outer facets of all cells: those that only one cell has."""
    name, local = FACES[kind]
    facets = np.concatenate([cells[:, list(each)] for each in local])
    _, inverse, count = np.unique(np.sort(facets, axis=1), axis=0, return_inverse=True, return_counts=True)
    return {name: facets[count[inverse.ravel()] == 1]}


def loaded(model: LimbModel, *loads: Load, supports: tuple[Support, ...] = ROLLERS) -> LimbModel:
    surfaces = {"top": Surface("top", top_facets(model))}
    kind = model.mesh.block("tissue").kind
    surfaces["skin"] = Surface("skin", skin_of(kind, model.mesh.block("tissue").cells))
    mesh = replace(model.mesh, surfaces=surfaces)
    return replace(model, mesh=mesh, loads=loads, supports=supports)


def solve(model: LimbModel):
    analysis = Analysis(model, TIGHT)
    return analysis, analysis.run()[-1]


def column(stress: float, mu: float, lam: float) -> tuple[float, float]:
    """(axial, lateral stretch) of uniaxial Cauchy stress of FEBio's neo-Hookean solid.

    W = mu / 2 (I1 - 3) - mu ln J + lambda / 2 (ln J)^2
    """
    from scipy.optimize import fsolve

    def equations(at):
        a, t = at
        J = a * t * t
        return [
            mu * (a * a - 1) / J + lam * np.log(J) / J - stress,
            mu * (t * t - 1) / J + lam * np.log(J) / J,
        ]

    a, t = fsolve(equations, (1.0, 1.0), xtol=1e-13)
    return float(a), float(t)


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8"])
def test_pressure_on_a_block_gives_the_closed_form_of_its_cauchy_stress(kind: str) -> None:
    """Uniaxial compression: the pressure is that of the deformed, widened face; inner nodes off the grid."""
    model = loaded(block(kind, material=NEO, twist=0.05), Load("pressure", "top", (0.006,), "ramp"))
    analysis, last = solve(model)
    axial, lateral = column(-0.006, 0.01, 0.02)
    x = model.mesh.points
    np.testing.assert_allclose(last.state.u[:, 2], (axial - 1) * (x[:, 2] + 1.0), atol=1e-8)
    np.testing.assert_allclose(last.state.u[:, 0], (lateral - 1) * x[:, 0], atol=1e-8)
    stress = cell_fields(analysis.system, last.state, 0, ("sz", "sx"))
    np.testing.assert_allclose(stress, np.tile([-0.006, 0.0], (len(stress), 1)), atol=1e-9)


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8"])
@pytest.mark.parametrize("on_reference", [False, True])
def test_traction_acts_on_the_deformed_or_the_undeformed_face(kind: str, on_reference: bool) -> None:
    load = Load("traction", "top", (0.0, 0.0, 0.006), "ramp", on_reference)
    model = loaded(block(kind, material=NEO), load)
    analysis, last = solve(model)
    face = (1 + last.state.u[model.mesh.node_sets["x1"][0], 0]) ** 2
    area = 1.0 if on_reference else face
    pull = analysis.system.distributed.forces(last.state.u).sum(axis=0)
    np.testing.assert_allclose(pull, [0, 0, 0.006 * area], atol=1e-12)
    stress = cell_fields(analysis.system, last.state, 0, ("sz",))
    np.testing.assert_allclose(stress, 0.006 * area / face, atol=1e-9)


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8"])
def test_hydrostatic_pressure_on_all_faces_shrinks_the_block_evenly(kind: str) -> None:
    """p = -(mu (t^2 - 1) + lambda ln J) / J at the stretch t in all directions, J = t^3."""
    model = loaded(block(kind, material=NEO, twist=0.05), Load("pressure", "skin", (0.008,), "ramp"))
    _, last = solve(model)
    t = 1 + last.state.u[model.mesh.node_sets["x1"], 0]
    np.testing.assert_allclose(t, t[0], atol=1e-9)
    J = t[0] ** 3
    assert -(0.01 * (t[0] ** 2 - 1) + 0.02 * np.log(J)) / J == pytest.approx(0.008, rel=1e-8)


def sphere(n: int, inner: float, outer: float) -> LimbModel:
    """An octant of a thick sphere of tet10, from a block whose last axis becomes the radius."""
    points, hexes = grid((n, n, n), (1.0, 1.0, 1.0))
    third = [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)], [(0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 1, 0)]
    third = (*third, [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
    a, b, c = points[:, 0], points[:, 1], points[:, 2] + 1.0
    shares = np.stack([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b], axis=1)
    X, cells = [], []
    for corners in third:
        way = shares @ np.array(corners, dtype=float)
        radius = inner + c * (outer - inner)
        X.append(way / np.linalg.norm(way, axis=1, keepdims=True) * radius[:, None])
        cells.append(hexes + (len(X) - 1) * len(points))
    every, inverse = np.unique(np.concatenate(X).round(9), axis=0, return_inverse=True)
    joined = inverse.ravel()[np.concatenate(cells)]
    first = every[joined[0]]
    if np.linalg.det(np.stack([first[1] - first[0], first[3] - first[0], first[4] - first[0]])) < 0:
        joined = joined[:, [0, 3, 2, 1, 4, 7, 6, 5]]
    x, tets = cells_of("tet10", every, joined)
    r = np.linalg.norm(every, axis=1)
    edges = np.array([(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)])
    ends = tets[:, edges]  # move the midside nodes to the mean radius of their edges' ends
    mean = 0.5 * (r[ends[..., 0]] + r[ends[..., 1]])
    x[tets[:, 4:]] *= (mean / np.linalg.norm(x[tets[:, 4:]], axis=-1))[..., None]
    skin = skin_of("tet10", tets)["tri6"]
    inside = (abs(np.linalg.norm(x[skin], axis=2) - inner) < 1e-6).all(axis=1)
    sets = {f"{axis}0": np.flatnonzero(abs(x[:, k]) < 1e-8) for k, axis in enumerate("xyz")}
    mesh = Mesh(x, (Block("tissue", "tet10", tets),), sets, {"bore": Surface("bore", {"tri6": skin[inside]})})
    model = block("tet10")
    return replace(
        model,
        mesh=mesh,
        materials={"tissue": NEO},
        domains=(Domain("tissue", "tissue"),),
        supports=ROLLERS,
    )


def test_a_thick_sphere_under_inner_pressure_widens_as_lame_says() -> None:
    """u(a) = p a^3 / (b^3 - a^3) (a / (3 k) + b^3 / (4 mu a^2)), at a pressure of 1e-4 of the stiffness."""
    a, b, p = 1.0, 2.0, 1e-6
    model = replace(sphere(4, a, b), loads=(Load("pressure", "bore", (p,), "ramp"),))
    _, last = solve(model)
    mu, k = 0.01, 0.02 + 2 / 3 * 0.01
    expected = p * a**3 / (b**3 - a**3) * (a / (3 * k) + b**3 / (4 * mu * a**2))
    bore = np.unique(model.mesh.surfaces["bore"].facets["tri6"])
    outward = (last.state.u[bore] * model.mesh.points[bore]).sum(axis=1) / a
    np.testing.assert_allclose(outward, expected, rtol=0.01)  # the mesh's own error: 4 cells over the wall
    assert outward.mean() == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8", "penta6"])
def test_a_column_under_its_weight_sinks_by_the_closed_form(kind: str) -> None:
    """Held laterally: (lambda + 2 mu) u'' = rho g; the top sinks by rho g h^2 / 2 (lambda + 2 mu)."""
    g, height = 9810.0, 1.0
    model = block(kind, (1, 1, 4), material=NEO)
    load = Load("body force", "", (0.0, 0.0, -g * 1e-2), "ramp")  # small: the closed form is linear
    held = (Support("all", ("x", "y")), Support("z0", ("z",)))
    model = replace(model, loads=(load,), supports=held)
    _, last = solve(model)
    expected = -1e-9 * g * 1e-2 * height**2 / 2 / (0.02 + 2 * 0.01)
    sunk = last.state.u[model.mesh.node_sets["z1"], 2].mean()  # tetrahedra share the weight unevenly
    assert sunk == pytest.approx(expected, rel=5e-3)
    bottom = last.forces.nodal[model.mesh.node_sets["z0"], 2].sum()
    assert bottom == pytest.approx(1e-9 * g * 1e-2, rel=1e-8)  # the base carries the weight


def test_the_column_of_bricks_is_exact_at_its_nodes() -> None:
    model = block("hex8", (1, 1, 4), material=NEO)
    held = (Support("all", ("x", "y")), Support("z0", ("z",)))
    model = replace(model, loads=(Load("body force", "tissue", (0.0, 0.0, -1.0)),), supports=held)
    _, last = solve(model)
    z = model.mesh.points[:, 2] + 1.0
    np.testing.assert_allclose(last.state.u[:, 2], -1e-9 * (z - z**2 / 2) / 0.04, rtol=1e-6, atol=1e-16)


def test_forces_on_nodes_add_up_to_the_reaction() -> None:
    model = block("tet10", material=NEO)
    n = len(model.mesh.node_sets["z1"])
    load = Load("nodal force", "z1", (1e-4 / n, 0.0, 2e-4 / n), "ramp")
    model = replace(model, loads=(load,), supports=(Support("z0", ("x", "y", "z")),))
    _, last = solve(model)
    reaction = last.forces.nodal[model.mesh.node_sets["z0"]].sum(axis=0)
    np.testing.assert_allclose(reaction, [-1e-4, 0.0, -2e-4], atol=1e-12)


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8"])
@pytest.mark.parametrize("load", ["pressure", "traction"])
def test_the_tangent_of_a_following_load_agrees_with_differences(
    kind: str, load: str, rng: np.random.Generator
) -> None:
    """On a face with a free rim, where it is not symmetric, and on nodes tied to a body that is free."""
    value = (0.02,) if load == "pressure" else (0.01, -0.02, 0.015)
    model = loaded(block(kind, material=NEO, twist=0.05), Load(load, "top", value))
    model = replace(
        model,
        bodies=(RigidBody("handle", (0.0, 0.5, 0.0), node_sets=("x0",)),),
        drives=tuple(Drive("handle", dof, "fixed") for dof in ("x", "u")),
        supports=(Support("z0", ("x", "y", "z")),),
    )
    mesh = model.mesh
    low = np.setdiff1d(mesh.node_sets["z0"], mesh.node_sets["x0"])
    model = replace(model, mesh=replace(mesh, node_sets={**mesh.node_sets, "z0": low}))
    system = System(model, threads=1)
    start = system.moved(system.rest(), 0.02 * rng.standard_normal(system.n_unknowns))
    forces = system.forces(start)
    tangent = assemble(system, start, forces.nodal)
    assert tangent.loads is not None
    direction = rng.standard_normal(system.n_unknowns)
    exact = tangent.times(forces.contact, direction)
    h = 1e-6
    up, down = (system.forces(system.moved(start, s * h * direction)).residual for s in (1, -1))
    np.testing.assert_allclose((up - down) / (2 * h), exact, atol=2e-6 * abs(exact).max())
    v = rng.standard_normal(system.X.shape)
    ahead, back = (system.distributed.forces(start.u + s * h * v) for s in (1, -1))
    np.testing.assert_allclose(system.distributed.change(start.u, v), (ahead - back) / (2 * h), atol=1e-9)


def test_a_load_on_a_rigid_body_is_refused() -> None:
    model = block("tet4", material=NEO)
    points = np.concatenate([model.mesh.points, [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]])
    plate = np.arange(len(model.mesh.points), len(points))[None]
    mesh = replace(
        model.mesh,
        points=points,
        blocks=(*model.mesh.blocks, Block("plate", "quad4", plate)),
        surfaces={"plate": Surface("plate", {"quad4": plate})},
    )
    model = replace(
        model,
        mesh=mesh,
        bodies=(RigidBody("plate", (0.5, 0.5, 1.0), ("plate",)),),
        loads=(Load("pressure", "plate", (0.1,)),),
    )
    with pytest.raises(SolveError, match="rigid body 'plate'"):
        System(model, threads=1)


@pytest.mark.parametrize(
    ("load", "what"),
    [
        (Load("pressure", "nowhere", (1.0,)), "unknown surface"),
        (Load("nodal force", "nowhere", (1.0, 0.0, 0.0)), "unknown node set"),
        (Load("body force", "nowhere", (1.0, 0.0, 0.0)), "no part of the tissue"),
    ],
)
def test_a_load_on_what_is_not_there_is_an_error(load: Load, what: str) -> None:
    with pytest.raises(SolveError, match=what):
        System(replace(block("tet4"), loads=(load,)), threads=1)


def test_load_times_follow_the_curve() -> None:
    """Half the load at half the time, and the load of a step acts in this step only."""
    model = loaded(block("tet4", material=NEO), Load("pressure", "top", (0.004,), "ramp", True))
    steps = replace(model.steps[0], n_steps=2, step_size=0.5)
    analysis = Analysis(replace(model, steps=(steps,)), TIGHT)
    half, full = analysis.run()
    reactions = [each.forces.nodal[model.mesh.node_sets["z0"], 2].sum() for each in (half, full)]
    np.testing.assert_allclose(reactions, [0.002, 0.004], rtol=1e-8)
    held = replace(model.steps[0], loads=model.loads)
    state = Analysis(replace(model, loads=(), steps=(held, replace(held, loads=()))), TIGHT).run()[-1].state
    np.testing.assert_allclose(state.u, 0.0, atol=1e-10)
    assert isinstance(state, State)


def resultant(model: LimbModel, time: float = 0.0, u: np.ndarray | None = None) -> np.ndarray:
    """Sum of the loads' nodal forces at a time, with displacements u."""
    system = System(model, threads=1)
    system.at(time)
    return system.distributed.forces(np.zeros_like(system.X) if u is None else u).sum(axis=0)


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8"])
def test_formulas_are_integrated_over_the_undeformed_places(kind: str) -> None:
    """A pressure over the top of a block and a body force in it, whose integrals are known."""
    model = block(kind, (2, 3, 2), (2.0, 3.0, 1.5), material=NEO)
    x = model.mesh.points
    low, size = x.min(axis=0), np.ptp(x, axis=0)
    mean = low[0] + size[0] / 2
    pressure = loaded(model, Load("pressure", "top", (Formula("0.5*X*t"),)))
    expected = -0.5 * mean * 0.4 * size[0] * size[1]
    np.testing.assert_allclose(resultant(pressure, 0.4), [0.0, 0.0, expected], atol=1e-12)
    moved = np.full_like(x, 0.7)  # the formula's X is that of the undeformed state
    np.testing.assert_allclose(resultant(pressure, 0.4, moved), [0.0, 0.0, expected], atol=1e-12)
    weight = loaded(model, Load("body force", "", (0.0, Formula("X + Y"), 2.0)))
    volume = 1e-9 * np.prod(size)
    middle = mean + low[1] + size[1] / 2
    found = resultant(weight) / volume
    np.testing.assert_allclose(found, [0.0, middle, 2.0], atol=1e-9)  # tet10's rule has ten digits


def test_a_formula_without_variables_is_the_number(rng: np.random.Generator) -> None:
    loads = (Load("pressure", "top", (0.3,)), Load("pressure", "top", (Formula("0.1 + 0.2"),)))
    model = block("tet10", (2, 2, 2), material=NEO, twist=0.1)
    forces, tangents = [], []
    u = 0.05 * rng.standard_normal(model.mesh.points.shape)
    for load in loads:
        system = System(loaded(model, load), threads=1)
        forces.append(system.distributed.forces(u))
        tangents.append(system.distributed.surfaces[0].blocks(system.X + u))
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(tangents[1], tangents[0], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8"])
def test_a_force_over_a_surface_keeps_its_sum(kind: str, rng: np.random.Generator) -> None:
    model = loaded(
        block(kind, material=NEO, twist=0.1), Load("surface force", "skin", (1.0, -2.0, 0.5), None, True)
    )
    u = 0.05 * rng.standard_normal(model.mesh.points.shape)
    np.testing.assert_allclose(resultant(model, u=u), [1.0, -2.0, 0.5], rtol=1e-12)


def test_a_nodal_force_follows_its_formula_of_time() -> None:
    model = block("hex8", (1, 1, 1), material=NEO)
    model = replace(model, loads=(Load("nodal force", "z0", (Formula("t"), 0.0, 0.0)),))
    n = len(model.mesh.node_sets["z0"])
    np.testing.assert_allclose(resultant(model, 0.5), [0.5 * n, 0.0, 0.0], rtol=1e-12)
    assert not resultant(model, 0.0).any()
