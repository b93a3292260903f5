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
