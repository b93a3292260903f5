"""Contact of two soft surfaces: uniform stress, friction by hand, exact tangent, balance, a rigid twin."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sparse
from scipy.optimize import brentq
from small_models import block, top_facets

from limbcli.errors import SolveError
from limbcli.feb.law_tags import lame
from limbcli.feb.records import read_records
from limbcli.feb.write import write_feb
from limbcli.fem.analysis import Analysis, Snapshot
from limbcli.fem.contacts.contact_points import NORMAL, TRACTION
from limbcli.fem.contacts.friction_kernels import PUSH, STICKS
from limbcli.fem.equilibrium.settings import Settings
from limbcli.fem.equilibrium.tangent import assemble
from limbcli.fem.linear_solvers.direct import make
from limbcli.fem.linear_solvers.growing_pattern import GrowingPatternSolver
from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.model import Block, Curve, Domain, LimbModel, LogRecord, Material, Mesh, Step, Support, Surface
from limbcli.model.bodies import Contact, Drive, RigidBody
from limbcli.progress import SILENT
from limbcli.solvers.reference import ReferenceSolver

QUICK = Settings(tolerance=1e-9, threads=1)
YOUNG, POISSON = 0.03, 0.3
MU, LAMBDA = lame(YOUNG, POISSON)
SOFT = Material("neo_hooke", {"mu": MU, "lambda": LAMBDA})
HIGH, LOW, SIDE = 3.0, 4.0, 6.0  # mm: heights of the upper and the lower block, and their sides
OVERLAP, EPS = 0.02, 0.5  # mm; MPa/mm


def stacked(
    kind: str, low: tuple[int, int, int], high: tuple[int, int, int], *, upper: Material = SOFT,
    contact: Contact | None = None, side: float = SIDE, shift: float = 0.0,
) -> LimbModel:  # fmt: skip
    """Two blocks, the upper one `OVERLAP` inside the lower one, whose top at z = 0 is the primary surface.

    side : of the upper block; shift : of its corner along x and y
    """
    below = block(kind, low, (SIDE, SIDE, LOW), material=SOFT)
    above = block(kind, high, (side, side, HIGH), material=upper)
    first = len(below.mesh.points)
    points = above.mesh.points + np.array([shift, shift, HIGH - OVERLAP])
    sets = dict(below.mesh.node_sets)
    sets |= {f"upper_{name}": nodes + first for name, nodes in above.mesh.node_sets.items()}
    surfaces = {
        "top": Surface("top", top_facets(below)),
        "bottom": Surface("bottom", {k: f + first for k, f in bottom_facets(above).items()}),
    }
    mesh = Mesh(
        np.concatenate([below.mesh.points, points]),
        (*below.mesh.blocks, Block("upper", kind, above.mesh.blocks[0].cells + first)),
        sets,
        surfaces,
    )
    return LimbModel(
        mesh,
        {"tissue": SOFT, "upper": upper},
        (Domain("tissue", "tissue"), Domain("upper", "upper")),
        contacts=(contact or Contact("top", "bottom", auto_penalty=False, penalty=EPS, search_radius=2.0),),
        curves={"ramp": Curve(((0.0, 0.0), (1.0, 1.0)))},
        steps=(Step(n_steps=1, step_size=1.0),),
    )


def bottom_facets(model: LimbModel) -> dict[str, np.ndarray]:
    """Facets of the cells in the lowest plane, normals downward: those of the block upside down."""
    mesh = model.mesh
    if mesh.blocks[0].kind == "hex8":
        low = set(mesh.node_sets["z0"].tolist())
        cells = mesh.blocks[0].cells[:, [0, 3, 2, 1]]
        return {"quad4": np.array([c for c in cells if set(c.tolist()) <= low])}
    return top_facets(replace(model, mesh=replace(mesh, node_sets={"z1": mesh.node_sets["z0"]})))


def pressed(model: LimbModel, depth: float = 0.3) -> LimbModel:
    """On rollers, so that each block is in uniaxial compression: its top goes down."""
    rollers = [
        Support(f"{which}{axis}0", (axis,)) for which in ("", "upper_") for axis in ("x", "y")
    ]  # fmt: skip
    down = Support("upper_z1", ("z",), -depth, "ramp")
    return replace(model, supports=(*rollers, Support("z0", ("z",)), down))


def uniaxial_pressure(stretch: float) -> float:
    """Axial Cauchy pressure (MPa) of a neo-Hookean bar whose sides are free."""

    def across(t: float) -> float:
        return MU * (t * t - 1.0) + LAMBDA * np.log(t * t * stretch)

    t = brentq(across, 0.5, 2.0)
    return -(MU * (stretch**2 - 1.0) + LAMBDA * np.log(t * t * stretch)) / (t * t * stretch)


def expected_pressure(depth: float) -> float:
    """Of both blocks and the contact's spring between them, whose heights add up."""

    def left(stretch: float) -> float:
        height = LOW + HIGH
        return stretch * height - uniaxial_pressure(stretch) / EPS - (height - OVERLAP - depth)

    return uniaxial_pressure(brentq(left, 0.5, 1.0))


def last(model: LimbModel) -> tuple[Analysis, Snapshot]:
    analysis = Analysis(model, QUICK)
    return analysis, analysis.run()[-1]


def tractions_of(snapshot: Snapshot) -> np.ndarray:
    return np.concatenate([points[..., TRACTION].ravel() for points in snapshot.forces.contact.points[0]])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8"])
def test_stress_is_uniform_through_meshes_that_do_not_match(kind: str) -> None:
    """Every primary facet lies on one secondary facet, so that its points integrate the reaction exactly."""
    _, end = last(pressed(stacked(kind, (4, 4, 2), (2, 2, 2))))
    pressure = tractions_of(end)
    np.testing.assert_allclose(pressure, expected_pressure(0.3), rtol=1e-8)


def rubbing(kind: str, mu: float, **options: bool) -> LimbModel:
    """Blocks of meshes that do not match, the upper one smaller, on held faces."""
    contact = Contact("top", "bottom", penalty=20.0, search_radius=2.0, friction=mu, **options)
    model = stacked(kind, (3, 3, 2), (2, 2, 2), contact=contact, side=4.7, shift=0.6)
    return replace(model, supports=(Support("z0", ("x", "y", "z")), Support("upper_z1", ("x", "y", "z"))))


def moved_at_random(system: System, rng: np.random.Generator) -> State:
    """A state deep in contact, a step on from the stored one, with points that stick and points that slip."""
    upper = np.isin(np.arange(len(system.X)), system.model.mesh.blocks[1].cells)[:, None]
    begin = system.moved(system.rest(), 2e-2 * rng.standard_normal(system.n_unknowns))
    begin = replace(begin, u=begin.u - np.where(upper, [0.0, 0.0, 0.15], 0.0))
    system.remember(system.search(begin).state)
    drift = np.where(system.X[:, :1] > 3.0, [[0.25, 0.1, 0.0]], [[0.01, 0.005, 0.0]])
    u = begin.u + np.where(upper, drift, 0.0)
    return system.moved(replace(begin, u=u), 5e-3 * rng.standard_normal(system.n_unknowns))


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8"])
@pytest.mark.parametrize("mu", [0.0, 0.4])
def test_tangent_agrees_with_differences(kind: str, mu: float, rng: np.random.Generator) -> None:
    """Of both sides, where points stick, where they slip and, without friction, where the traction fades; the
    matrix of the factor has the same terms."""
    system = System(rubbing(kind, mu), threads=1)
    system.pairs[0].rim = np.where(system.pairs[0].rim > 0, 0.4, 0.0)
    assert system.pairs[0].rim.any() == (mu == 0.0)
    state = moved_at_random(system, rng)
    forces = system.forces(state)
    sticks = np.concatenate([points[..., STICKS].ravel() for points in forces.contact.points[0]])
    assert forces.n_touching > 12
    if mu:
        assert 3 < sticks.sum() < forces.n_touching - 3
    direction = rng.standard_normal(system.n_unknowns)
    exact = assemble(system, state, forces.nodal).times(forces.contact, direction)
    h = 1e-7
    up, down = (system.forces(system.moved(state, s * h * direction)).residual for s in (1, -1))
    np.testing.assert_allclose((up - down) / (2 * h), exact, atol=2e-6 * abs(exact).max())
    change = system.contact_change(forces.contact, direction)
    matrix = system.contact_matrix(forces.contact, system.equations, system.n_tissue)
    np.testing.assert_allclose(matrix @ direction, change, atol=1e-12 * abs(change).max())
    half = system.couplings(forces.contact)
    np.testing.assert_allclose((half - 0.5 * (matrix + matrix.T)).toarray(), 0.0, atol=1e-15)


@pytest.mark.parametrize("mu", [0.0, 0.4])
def test_what_one_side_bears_the_other_gives_back(mu: float, rng: np.random.Generator) -> None:
    """Forces balance, and their moments but for the couple of friction over the penetration."""
    system = System(rubbing("tet10", mu), threads=1)
    state = moved_at_random(system, rng)
    contact = system.search(state)
    nodal, _ = system.contact_forces(contact)
    x = system.X + state.u
    size = np.abs(nodal).sum()
    np.testing.assert_allclose(nodal.sum(axis=0), 0.0, atol=1e-14 * size)
    upper = np.unique(system.model.mesh.blocks[1].cells)
    assert np.linalg.norm(nodal[upper].sum(axis=0)) > 0.01 * size
    moment = np.cross(x, nodal).sum(axis=0)
    if not mu:
        np.testing.assert_allclose(moment, 0.0, atol=1e-12 * size)
    assert np.linalg.norm(moment) < 0.2 * np.linalg.norm(nodal[upper].sum(axis=0))


def test_a_dragged_block_slips_at_mu_times_the_force() -> None:
    """Pressed, then dragged over the lower one further than both can shear: Coulomb's law of the face."""
    mu = 0.3
    contact = Contact("top", "bottom", penalty=20.0, search_radius=2.0, friction=mu)
    model = stacked("hex8", (3, 3, 1), (2, 2, 1), contact=contact, side=9.0, shift=-2.0)
    curves = {"press": Curve(((0.0, 0.0), (1.0, 1.0))), "drag": Curve(((0.0, 0.0), (1.0, 0.0), (5.0, 1.0)))}
    supports = (
        Support("all", ("x", "y", "z")),  # of the lower block: the normals of its face stay alike
        Support("upper_z1", ("z",), -0.3, "press"),
        Support("upper_z1", ("x",), 1.2, "drag"),
        Support("upper_z1", ("y",)),
    )
    _, end = last(replace(model, supports=supports, curves=curves, steps=(Step(n_steps=5, step_size=1.0),)))
    force = end.forces.nodal[model.mesh.node_sets["upper_z1"]].sum(axis=0)
    assert not any((points[..., STICKS] > 0).any() for points in end.forces.contact.points[0])
    assert force[2] < -1e-3
    points = end.forces.contact.points[0][0]
    points = points[points[..., TRACTION] > 0]
    size = np.linalg.norm(points[..., NORMAL : NORMAL + 3], axis=1, keepdims=True)
    nu = points[..., NORMAL : NORMAL + 3] / size
    along = points[..., PUSH : PUSH + 3] - points[..., TRACTION, None] * nu
    np.testing.assert_allclose(np.linalg.norm(along, axis=1), mu * points[..., TRACTION], rtol=1e-9)
    assert -force[0] / force[2] == pytest.approx(mu, rel=2e-3)


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_a_secondary_surface_that_is_given_its_motion_is_a_rigid_one(mu: float) -> None:
    """Of the same facets, moved by prescribed displacements and as a rigid body: the same response."""
    contact = Contact("top", "bottom", penalty=20.0, search_radius=2.0, friction=mu)
    base = stacked("tet4", (3, 3, 2), (2, 2, 1), contact=contact, side=8.0, shift=-1.0)
    way, steps = {"x": 0.1, "z": -0.4}, (Step(n_steps=3, step_size=1.0 / 3),)
    held = Support("z0", ("x", "y", "z"))
    given = tuple(Support("upper_all", (axis,), size, "ramp") for axis, size in way.items())
    soft = replace(base, supports=(held, *given, Support("upper_all", ("y",))), steps=steps)
    kind, facets = next(iter(base.mesh.surfaces["bottom"].facets.items()))
    mesh = replace(base.mesh, blocks=(base.mesh.blocks[0], Block("plate", kind, facets)))
    fixed = tuple(Drive("plate", dof, "fixed") for dof in ("y", "u", "v", "w"))
    moved = tuple(Drive("plate", axis, "displacement", size, "ramp") for axis, size in way.items())
    rigid = replace(
        base, mesh=mesh, materials={"tissue": SOFT}, domains=base.domains[:1], supports=(held,), steps=steps,
        bodies=(RigidBody("plate", (3.0, 3.0, 0.0), ("plate",)),), drives=(*fixed, *moved),
    )  # fmt: skip
    (_, one), (_, other) = last(soft), last(rigid)
    pushed = one.forces.nodal[base.mesh.node_sets["z0"]].sum(axis=0)
    np.testing.assert_allclose(pushed, -other.forces.bodies[0, :3], atol=1e-6 * abs(pushed).max())
    tissue = np.unique(base.mesh.blocks[0].cells)
    np.testing.assert_allclose(one.state.u[tissue], other.state.u[tissue], atol=1e-6)


def test_a_factor_grows_only_by_entries_that_have_no_place(rng: np.random.Generator) -> None:
    n = 8
    base = sparse.csr_array(np.triu(np.diag(np.arange(4.0, 4 + n)) + np.diag(np.ones(n - 1), 1)))
    solver = GrowingPatternSolver(base.indptr, base.indices, partial(make, kind="superlu"))
    full = base + sparse.triu(base, 1).T
    for (i, j), analyses in (((1, 5), 2), ((1, 5), 2), ((0, 1), 2), ((2, 7), 3), ((1, 5), 3)):
        more = sparse.csr_array(([0.5, 0.5], ([i, j], [j, i])), shape=(n, n))
        solver.factor(base.data, more)
        b = rng.standard_normal(n)
        np.testing.assert_allclose((full + more) @ solver.solve(b), b, atol=1e-12)
        assert solver.n_analyses == analyses
    assert solver.n_factorisations == 5


def test_a_model_file_with_two_soft_surfaces_runs(tmp_path: Path) -> None:
    model = pressed(stacked("tet4", (2, 2, 1), (1, 1, 1)))
    feb = write_feb(
        replace(model, records=(LogRecord("node", ("x", "y", "z"), "nodes.csv"),)), tmp_path / "m.feb"
    )
    ReferenceSolver(threads=1).run(feb, progress=SILENT)
    x = read_records(tmp_path / "nodes.csv").values[-1]
    lower = np.isclose(model.mesh.points[:, 2], 0.0)
    _, end = last(model)
    np.testing.assert_allclose(x[lower], (model.mesh.points + end.state.u)[lower], atol=1e-5)
    assert x[lower, 2].max() < -0.1


def test_a_soft_secondary_surface_needs_cells() -> None:
    model = stacked("tet4", (2, 2, 1), (1, 1, 1))
    alone = replace(model, mesh=replace(model.mesh, blocks=model.mesh.blocks[:1]), domains=model.domains[:1])
    with pytest.raises(SolveError, match="neither of one rigid body nor of the tissue"):
        System(alone, threads=1)
