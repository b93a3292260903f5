"""The family of models behind `cohort`: a layered slab under the probe, simulated with the reference solver
for a range of geometries and tissue parameters.

All quantities are scaled by the probe's face: lengths by the square root of its area, forces by its area and
the muscle's c. One family is therefore valid for every probe of about these proportions. Its parameters:

    thickness  total thickness, skin to bone, divided by the root of the face's area
    fat_share  fat thickness divided by that of fat and muscle
    skin       skin thickness divided by the root of the face's area
    ratio      c_fat / c_muscle
    m          exponent, of all three layers

Fixed: skin five times as stiff as muscle, f_kappa 100, a face four times as long as wide, no friction, a flat
rigid base to which the tissue adheres, free flanks at a distance of one thickness plus one root of the area
from the face.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.errors import SolveError
from limbcli.feb.settings import Schedule, robust_contact, robust_step, schedule
from limbcli.inference.layered_family import SKIN_RATIO
from limbcli.materials.ogden import ogden_type
from limbcli.meshing.probe import ProbeShape
from limbcli.model import Array, IntArray, LimbModel, LogRecord
from limbcli.model.bodies import Drive
from limbcli.progress import SILENT, Progress
from limbcli.solvers.session import ReferenceSession, SessionResult
from limbcli.solvers.session_options import StopWhen
from tests.benchmarks.layered_slab import LAYERS, QUARTER, CellCounts, Slab, slab_model

ROOT_AREA = 20.0  # mm, square root of the face's area at which the family is solved
ASPECT, EDGE_SHARE = 4.0, 0.12
F_KAPPA = 100.0
PENALTY = 80.0
STRAINS = (0.05, 0.12, 0.2, 0.3, 0.4)
_C = 0.01  # MPa, c of the muscle in the simulations; answers are divided by it
_LARGEST_STRIDE_S = 0.3
_RECORD = "axis.csv"
_FEWEST = 2
# Terms of the derivatives by ln ratio and ln m: (material, parameter, derivative of the parameter).
_BY_RATIO = (("fat", "c1", 0.5), ("fat", "c2", 0.5), ("fat", "kappa", F_KAPPA))
_BY_M = tuple((layer, "m1-m2", 1.0) for layer in LAYERS)


@dataclass(frozen=True)
class Member:
    """One set of parameters of the family."""

    thickness: float
    fat_share: float
    skin: float
    ratio: float
    m: float

    def slab(self) -> Slab:
        """The slab in mm, under a face of area ROOT_AREA squared."""
        whole, skin = self.thickness * ROOT_AREA, self.skin * ROOT_AREA
        fat = self.fat_share * (whole - skin)
        probe = ProbeShape(
            ROOT_AREA * np.sqrt(ASPECT), ROOT_AREA / np.sqrt(ASPECT), EDGE_SHARE * ROOT_AREA, wall=ROOT_AREA
        )
        return Slab(skin, fat, whole - skin - fat, probe, whole + ROOT_AREA)


@dataclass(frozen=True, eq=False)
class Answer:
    """A member's response at strains (n,) of the total thickness.

    force : divided by c_muscle, the face's area and the strain
    below_skin, below_fat : displacement of the layers' borders divided by that of the skin
    *_slopes : (n, 2) derivatives by ln ratio and ln m (for the force, those of its logarithm)
    """

    strain: Array
    force: Array
    below_skin: Array
    below_fat: Array
    force_slopes: Array
    below_skin_slopes: Array
    below_fat_slopes: Array


def solve_member(
    member: Member,
    *,
    counts: CellCounts = CellCounts(),
    strains: Sequence[float] = STRAINS,
    tolerance: float = 1e-3,
    gradients: bool = True,
    progress: Progress = SILENT,
) -> Answer:
    """Simulate the indentation of a member up to the last strain that the solver reaches.

    Raises
    ------
    SolveError
        If fewer than two of the strains are reached.
    """
    slab = member.slab()
    plan = schedule([each * slab.thickness for each in strains])
    model = _loaded(member, slab, plan, counts)
    session = ReferenceSession(model, progress=progress, threads=1, tolerance=tolerance)
    wrt = [(material, name) for material, name, _ in (*_BY_RATIO, *_BY_M)] if gradients else []
    try:
        found = session.solve(
            records=True, field_gradients=gradients, wrt=wrt, stop=StopWhen(required=_FEWEST, patient=False)
        )
    finally:
        session.close()
    return _answer(member, slab, plan, found, gradients)


def _loaded(member: Member, slab: Slab, plan: Schedule, counts: CellCounts) -> LimbModel:
    c = {"skin": SKIN_RATIO * _C, "fat": member.ratio * _C, "tissue": _C}
    laws = {name: ogden_type(c=c[name], f_kappa=F_KAPPA, m=member.m) for name in LAYERS}
    model = slab_model(slab, laws, counts=counts, start=plan.start)
    return replace(
        model,
        contacts=tuple(replace(robust_contact(each), penalty=PENALTY) for each in model.contacts),
        drives=(*model.drives, Drive("probe", "z", "displacement", -1.0, "travel")),
        curves={"travel": plan.curve()},
        steps=(replace(robust_step(plan, "tet10"), dt_max=_LARGEST_STRIDE_S),),
        records=(LogRecord("node", ("uz",), _RECORD, model.mesh.node_sets["axis"]),),
    )


def _answer(member: Member, slab: Slab, plan: Schedule, found: SessionResult, gradients: bool) -> Answer:
    levels = np.array(plan.times)
    times = found.must_points.times
    keep = np.array([bool(np.min(np.abs(levels - each)) < 1e-9) for each in times])
    if keep.sum() < _FEWEST:
        raise SolveError("too few levels", where=str(member), fix="solve with a finer mesh")
    depth, force = found.must_points.depths[keep], QUARTER * found.must_points.forces[keep]
    table = found.simulation.nodes[_RECORD]
    rows = [int(np.argmin(np.abs(table.times - each))) for each in times[keep]]
    sunk = -_from_surface(table.column("uz")[rows], table.items)
    strain = depth / slab.thickness
    empty = np.full((len(strain), 2), np.nan)
    slopes = (empty, empty, empty)
    if gradients:
        slopes = _slopes(member, found, keep, depth, force)
    scale = _C * ROOT_AREA**2 * strain
    return Answer(strain, force / scale, sunk[:, 1] / depth, sunk[:, 2] / depth, *slopes)


def _from_surface(values: Array, items: IntArray) -> Array:
    """Columns in the order surface, below skin, below fat; node numbers on the axis increase with height."""
    return np.asarray(values[:, np.argsort(items)[::-1]])


def _slopes(
    member: Member, found: SessionResult, keep: Array, depth: Array, force: Array
) -> tuple[Array, Array, Array]:
    """Derivatives (n, 2) by ln ratio and ln m of ln force and of both borders' relative displacements."""
    moved = (
        [(key, rate * member.ratio * _C) for *key, rate in _BY_RATIO],
        [(key, rate * member.m) for *key, rate in _BY_M],
    )
    by_force, by_skin, by_fat = [], [], []
    for parts in moved:
        total = np.zeros(len(depth))
        sunk = np.zeros((len(depth), 3))
        for (material, name), rate in parts:
            key = (material, name)
            total += rate * QUARTER * found.force_gradient[key][keep]
            table = found.field_gradient[key][_RECORD]
            sunk -= rate * _from_surface(table.column("uz")[keep], table.items)
        by_force.append(total / force)
        by_skin.append(sunk[:, 1] / depth)
        by_fat.append(sunk[:, 2] / depth)
    return np.stack(by_force, 1), np.stack(by_skin, 1), np.stack(by_fat, 1)
