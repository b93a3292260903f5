"""Solids without contact: patch test, tangent, invariance, rates, locking, balances."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import simpson
from small_models import block

from limbcli.errors import MeshError, SolveError
from limbcli.feb.read import read_feb
from limbcli.feb.records import read_records
from limbcli.fem.analysis import Analysis
from limbcli.fem.elements.element import shape
from limbcli.fem.elements.quadrature import rule
from limbcli.fem.equilibrium.settings import Settings
from limbcli.fem.equilibrium.tangent import assemble
from limbcli.fem.motion.state import State
from limbcli.fem.record_fields import cell_fields, gauss_fields
from limbcli.fem.system import System
from limbcli.materials import ogden_type
from limbcli.materials.energy import energy_density
from limbcli.model import CellKind, LimbModel, Material, NodeMap, Step, Support

KINDS = ("tet4", "tet10", "hex8", "penta6")
UNCOUPLED = Material("mooney_rivlin", {"c1": 0.002, "c2": 0.001, "kappa": 1.0})
TIGHT = Settings(tolerance=1e-11, threads=1)


def driven(model: LimbModel, node_set: str, field: np.ndarray) -> LimbModel:
    """Displacements `field` (n, 3) prescribed at a node set, with the ramp."""
    supports = tuple(
        Support(node_set, (axis,), NodeMap(f"u{axis}", node_set, field[:, k]), "ramp")
        for k, axis in enumerate("xyz")
    )
    return replace(model, supports=supports)


def solve(model: LimbModel, settings: Settings = TIGHT):
    analysis = Analysis(model, settings)
    return analysis, analysis.run()[-1]


@pytest.mark.parametrize("kind", KINDS)
def test_patch_test(kind: str) -> None:
    """Linear displacements at the boundary give one F, though inner nodes are off the grid."""
    model = block(kind, (3, 3, 3), twist=0.06)
    H = np.array([[0.1, 0.05, 0.0], [0.0, -0.08, 0.1], [0.02, 0.0, 0.12]])
    outer = model.mesh.node_sets["outer"]
    analysis, last = solve(driven(model, "outer", model.mesh.points[outer] @ H.T))
    np.testing.assert_allclose(last.state.u, model.mesh.points @ H.T, atol=1e-9)
    stress = cell_fields(analysis.system, last.state, 0, ("sx", "sy", "sz", "sxy", "syz", "sxz"))
    np.testing.assert_allclose(stress, np.broadcast_to(stress[0], stress.shape), atol=1e-11)


@pytest.mark.parametrize(
    ("kind", "material"), [*((kind, None) for kind in KINDS), ("hex8", UNCOUPLED), ("penta6", UNCOUPLED)]
)
def test_tangent_agrees_with_differences_at_a_random_state(
    kind: str, material: Material | None, rng: np.random.Generator
) -> None:
    """Of the default law, and with one pressure in each cell."""
    model = block(kind, material=material, twist=0.05)
    system = System(replace(model, supports=(Support("z0", ("x", "y", "z")),)), threads=1)
    u = np.where(system.free, 0.02 * rng.standard_normal(system.X.shape), 0.0)
    state = State(0.0, u, ())
    direction = rng.standard_normal(system.n_unknowns)
    forces = system.forces(state)
    exact = assemble(system, state, forces.nodal).times(forces.contact, direction)
    v = np.zeros_like(u)
    v[system.free] = direction
    h = 1e-6
    up, down = (system.forces(State(0.0, u + s * h * v, ())).residual for s in (1, -1))
    np.testing.assert_allclose((up - down) / (2 * h), exact, atol=1e-6 * abs(exact).max())
    np.testing.assert_allclose(system.tangent_times(state, v)[system.free], exact, atol=1e-12)


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8"])
def test_two_threads_give_the_tangent_of_one(kind: str, rng: np.random.Generator) -> None:
    """To the last bit: both add up the same cells in the same order, and share what both add to."""
    model = block(kind, (6, 5, 4), twist=0.05)
    systems = [System(model, threads=n) for n in (1, 2)]
    u = 0.02 * rng.standard_normal(systems[0].X.shape)
    one, two = (system.stiffness(State(0.0, u, ())) for system in systems)
    assert np.array_equal(one, two)
    assert len(systems[0].halves[0].shared) < len(one) / 2


def test_rigid_motion_leaves_no_force(rng: np.random.Generator) -> None:
    system = System(block("tet10"), threads=1)
    Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    Q *= np.sign(np.linalg.det(Q))
    state = State(0.0, system.X @ (Q - np.eye(3)).T + 3.0, ())
    assert abs(system.internal(state)[0]).max() < 1e-14


def test_turned_block_gives_turned_forces(rng: np.random.Generator) -> None:
    model = block("tet10", twist=0.05)
    Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    Q *= np.sign(np.linalg.det(Q))
    u = 0.02 * rng.standard_normal(model.mesh.points.shape)
    turned = replace(model, mesh=replace(model.mesh, points=model.mesh.points @ Q.T))
    f, g = (System(m, threads=1).internal(State(0.0, d, ()))[0] for m, d in ((model, u), (turned, u @ Q.T)))
    np.testing.assert_allclose(g, f @ Q.T, atol=1e-13)


def test_internal_forces_and_moments_balance(rng: np.random.Generator) -> None:
    system = System(block("tet10", twist=0.05), threads=1)
    u = 0.03 * rng.standard_normal(system.X.shape)
    f = system.internal(State(0.0, u, ()))[0]
    np.testing.assert_allclose(f.sum(axis=0), 0, atol=1e-14)
    np.testing.assert_allclose(np.cross(system.X + u, f).sum(axis=0), 0, atol=1e-14)


@pytest.mark.parametrize(
    ("kind", "rate"), [("tet4", 2.0), pytest.param("tet10", 3.0, marks=pytest.mark.slow)]
)
def test_error_falls_at_the_element_rate(kind: str, rate: float) -> None:
    """Manufactured small displacement u: the L2 error of the solution is of order h^rate.

    The body is driven by u's values on its surface and by the body force that u needs; here u is
    a harmonic, divergence-free field, which needs none in the linear limit.
    """
    errors = []
    sizes = (2, 4) if kind == "tet10" else (4, 8)
    for n in sizes:
        model = block(kind, (n, n, n), material=ogden_type(c=0.005, f_kappa=1.0, m=2.0))
        X = model.mesh.points
        x, y = X[:, 0], X[:, 1]
        # grad of the harmonic exp(2x) cos(2y), scaled: curl- and divergence-free
        amplitude = 1e-7
        exact = amplitude * np.stack(
            [np.exp(2 * x) * np.cos(2 * y), -np.exp(2 * x) * np.sin(2 * y), 0 * x], axis=1
        )
        outer = model.mesh.node_sets["outer"]
        analysis, last = solve(driven(model, "outer", exact[outer]), Settings(tolerance=1e-7, threads=1))
        errors.append(_l2_error(analysis.system, last.state.u, amplitude))
    slope = np.log2(errors[0] / errors[1])
    assert slope > rate - 0.25


def _l2_error(system: System, u: np.ndarray, amplitude: float) -> float:
    from limbcli.fem.elements.element import shape
    from limbcli.fem.elements.quadrature import rule

    group = system.groups[0]
    N, _ = shape(group.kind, rule("tet10")[0])
    X = np.einsum("gn,cni->cgi", N, system.X[group.cells])
    U = np.einsum("gn,cni->cgi", N, u[group.cells])
    x, y = X[..., 0], X[..., 1]
    exact = amplitude * np.stack(
        [np.exp(2 * x) * np.cos(2 * y), -np.exp(2 * x) * np.sin(2 * y), 0 * x], axis=-1
    )
    volume = group.weight.sum(axis=1)
    return float(np.sqrt((((U - exact) ** 2).sum(-1).mean(-1) * volume).sum()))


def _squash(kind: str, f_kappa: float) -> float:
    """Force to press the top of a block with a bonded base by 10 %."""
    model = block(kind, (3, 3, 3), material=ogden_type(c=0.005, f_kappa=f_kappa, m=2.0))
    supports = (
        Support("z0", ("x", "y", "z")),
        Support("z1", ("z",), -0.1, "ramp"),
    )
    _, last = solve(replace(model, supports=supports), Settings(tolerance=1e-8, threads=1))
    return -float(last.forces.nodal[model.mesh.node_sets["z1"], 2].sum())


def test_tet10_does_not_lock_and_tet4_does() -> None:
    soft, stiff = (_squash("tet10", f) for f in (50.0, 1000.0))
    assert stiff / soft < 1.05
    soft, stiff = (_squash("tet4", f) for f in (50.0, 1000.0))
    assert stiff / soft > 1.5


def test_loading_and_unloading_returns_the_work() -> None:
    """Work of the reactions over a load cycle equals the stored energy, up and down."""
    model = block("tet10", (1, 1, 1))
    supports = (Support("z0", ("x", "y", "z")), Support("z1", ("z",), -0.3, "ramp"))
    curve = replace(model.curves["ramp"], points=((0.0, 0.0), (1.0, 1.0), (2.0, 0.0)))
    step = replace(model.steps[0], n_steps=40, step_size=0.05)
    model = replace(model, supports=supports, curves={"ramp": curve}, steps=(step,))
    analysis = Analysis(model, Settings(tolerance=1e-10, threads=1))
    top = model.mesh.node_sets["z1"]
    snapshots = analysis.run()
    force = np.array([0.0, *(s.forces.nodal[top, 2].sum() for s in snapshots)])
    path = np.array([0.0, *(s.state.u[top[0], 2] for s in snapshots)])
    work = simpson(force[:21], x=path[:21])
    back = simpson(force[20:], x=path[20:])
    F, _ = gauss_fields(analysis.system, snapshots[19].state, 0)
    energy = (energy_density(analysis.system.operands[0], F) * analysis.system.groups[0].weight).sum()
    assert work == pytest.approx(energy, rel=1e-4)  # Simpson's rule over 20 steps
    assert back == pytest.approx(-work, rel=1e-9)


def test_the_energy_of_a_tensed_muscle_is_febios(golden: Path) -> None:
    """At FEBio's displacements; what the muscle's own tension does is no energy stored in the tissue. Counted
    as such it had been up to half of the largest."""
    folder = golden / "effect-contraction"
    model = read_feb(folder / "model.feb")
    nodes, cells = (read_records(folder / name) for name in ("nodes.csv", "elements.csv"))
    system = System(model, threads=1)
    system.at(cells.times[-1])
    u = np.zeros_like(system.X)
    u[nodes.ids - 1] = nodes.values[-1, :, :3]
    sed = cell_fields(system, replace(system.rest(), u=u), 0, ("sed",))[:, 0]
    (record,) = (each for each in model.records if each.kind == "element")
    expected = cells.values[-1, :, record.fields.index("sed")][: len(sed)]
    np.testing.assert_allclose(sed, expected, atol=1e-6 * expected.max())


@pytest.mark.parametrize("kind", ["tet10", "hex8"])
def test_logged_places_and_principal_stresses_are_means_over_the_integration_points(
    kind: CellKind, rng: np.random.Generator
) -> None:
    """As FEBio logs them: a moved tet10's nodes lie elsewhere on average, and where the stress turns within
    a cell the principal values of its mean are smaller."""
    model = block(kind, (1, 1, 1))
    system = System(model, threads=1)
    u = 0.05 * rng.standard_normal(model.mesh.points.shape)
    state = replace(system.rest(), u=u)
    found = cell_fields(system, state, 0, ("x", "y", "z", "s1", "s2", "s3"))
    N, _ = shape(kind, rule(kind)[0])
    x = (model.mesh.points + u)[model.mesh.block("tissue").cells]
    np.testing.assert_allclose(found[:, :3], np.einsum("gk,cki->cgi", N, x).mean(axis=1), atol=1e-14)
    _, stress = gauss_fields(system, state, 0)
    for row, points in zip(found[:, 3:], stress, strict=True):
        np.testing.assert_allclose(row, np.mean([np.linalg.eigvalsh(s)[::-1] for s in points], axis=0))


def test_two_regions_in_series_share_the_load() -> None:
    """A stiff and a soft layer, uniaxial: the stress is the same in both."""
    model = block("hex8", (1, 1, 2))
    cells = model.mesh.block("tissue").cells
    from limbcli.model import Block, Domain, Mesh

    mesh = Mesh(
        model.mesh.points,
        (Block("low", "hex8", cells[:1]), Block("high", "hex8", cells[1:])),
        model.mesh.node_sets,
    )
    soft, stiff = (Material("neo_hooke", {"mu": mu, "lambda": 0.0}) for mu in (0.001, 0.01))
    model = replace(
        model,
        mesh=mesh,
        materials={"soft": soft, "stiff": stiff},
        domains=(Domain("low", "soft"), Domain("high", "stiff")),
        supports=(
            Support("z0", ("z",)), Support("x0", ("x",)), Support("y0", ("y",)),
            Support("x1", ("x",)), Support("y1", ("y",)), Support("z1", ("z",), -0.2, "ramp"),
        ),
    )  # fmt: skip
    analysis, last = solve(model)
    sz = [cell_fields(analysis.system, last.state, k, ("sz",))[0, 0] for k in (0, 1)]
    assert sz[0] == pytest.approx(sz[1], rel=1e-8)


def test_inverted_reference_cell_is_an_error() -> None:
    model = block("tet4")
    cells = model.mesh.blocks[0].cells.copy()
    cells[3] = cells[3][[1, 0, 2, 3]]
    mesh = replace(model.mesh, blocks=(replace(model.mesh.blocks[0], cells=cells),))
    with pytest.raises(MeshError, match=r"1 cells.*\n.*element 4,"):
        System(replace(model, mesh=mesh), threads=1)
    ids = 100 + np.arange(len(cells))
    with pytest.raises(MeshError, match="element 103,"):
        System(replace(model, mesh=replace(mesh, cell_ids=ids)), threads=1)


def test_a_plate_that_turns_as_a_rigid_body_is_at_equilibrium_without_forces() -> None:
    """All acting forces vanish, and lambda too, so that neither gives the residual a scale."""
    model = block(
        "hex8", (4, 4, 1), (4.0, 4.0, 1.0), material=Material("neo_hooke", {"mu": 0.5, "lambda": 0.0})
    )
    x = model.mesh.points
    edge, far = ((np.hypot(x[:, 0] - a, x[:, 1] - a) < 1e-9) for a in (0.0, 4.0))
    sets = {**model.mesh.node_sets, "edge": np.flatnonzero(edge), "far": np.flatnonzero(far)}
    supports = (Support("z0", ("z",)), Support("edge", ("x", "y")), Support("far", ("y",), 1.0, "ramp"))
    model = replace(model, mesh=replace(model.mesh, node_sets=sets), supports=supports)
    _, last = solve(replace(model, steps=(Step(n_steps=2, step_size=0.5),)))
    turned = x + last.state.u
    np.testing.assert_allclose(np.linalg.norm(turned[far, :2], axis=1), 4 * np.sqrt(2), rtol=1e-9)
    assert abs(last.forces.nodal).max() < 1e-12


def test_free_block_is_a_singular_matrix_with_a_fix() -> None:
    model = replace(block("tet4"), supports=(Support("z1", ("z",), -0.1, "ramp"),))
    with pytest.raises(SolveError) as caught:
        Analysis(model, Settings(threads=1)).run()
    assert "fix:" in str(caught.value)


def test_impossible_load_stops_with_load_step_and_place() -> None:
    """A block squeezed to less than nothing: steps are cut, then the error names load step and place."""
    model = block("tet4", (1, 1, 1))
    supports = (Support("z0", ("x", "y", "z")), Support("z1", ("z",), -1.5, "ramp"))
    with pytest.raises(SolveError, match="load step 1 of 1") as caught:
        Analysis(replace(model, supports=supports), Settings(threads=1)).run()
    assert "mm" in str(caught.value)
    assert caught.value.facts["level"] == 1
