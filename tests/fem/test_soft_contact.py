"""Contact between two soft surfaces: uniform stress, friction by hand, exact tangent, balance, a stiff twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from small_models import block, on, punch, top_facets

from limbcli.errors import SolveError
from limbcli.feb.law_tags import lame
from limbcli.fem.analysis import Analysis, Snapshot
from limbcli.fem.contacts.contact_points import NATURAL, POINT, TRACTION
from limbcli.fem.contacts.friction_kernels import STICKS
from limbcli.fem.equilibrium.newton import Settings
from limbcli.fem.equilibrium.tangent import assemble
from limbcli.fem.linear_solvers.growing import Growing
from limbcli.fem.motion.rigid import rotation_matrix
from limbcli.fem.system import System
from limbcli.model import Block, Curve, Domain, LimbModel, Material, Mesh, Step, Support, Surface
from limbcli.model.bodies import Contact

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
    """Two blocks, the upper one `OVERLAP` inside the lower one, whose top is at z = 0 and the primary surface.

    side : of the upper block; shift : of its corner along x and y
    """
    below = block(kind, low, (SIDE, SIDE, LOW), material=SOFT)
    above = block(kind, high, (side, side, HIGH), material=upper)
    first = len(below.mesh.points)
    points = above.mesh.points + [shift, shift, HIGH - OVERLAP]
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


def moved_at_random(system: System, rng: np.random.Generator):
    """A state deep in contact and one step of slip on from the stored one, with points that stick and slip."""
    begin = system.moved(system.rest(), 2e-2 * rng.standard_normal(system.n_unknowns))
    u = begin.u.copy()
    u[system.model.mesh.blocks[1].cells.ravel().min() :] -= [0.0, 0.0, 0.15]
    begin = replace(begin, u=u)
    system.remember(system.search(begin).state)
    drift = np.where(system.X[:, :1] > 3.0, [[0.25, 0.1, 0.0]], [[0.01, 0.005, 0.0]])
    upper = np.arange(len(system.X)) >= len(system.X) - len(np.unique(system.model.mesh.blocks[1].cells))
    u = begin.u + np.where(upper[:, None], drift, 0.0)
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
