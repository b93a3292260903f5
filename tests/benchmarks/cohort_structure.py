"""What `limbcli cohort` cannot know, and how far it moves c_fat: the slab with other bonds, skin and fascia.

    python -m tests.benchmarks.cohort_structure             # a table for two shapes, 2 minutes

The table of a cohort holds thickness and shortening of each layer, but not whether muscle slides on the
bone, how stiff skin and the fascia over the muscle are, or how near the limb's flanks are. Each lowers fat's
part of the shortening as a stiffer fat does. For one measured ratio of strains, fat over muscle, this gives
the c_fat/c_muscle that explains it under each assumption, and c_muscle relative to that of the bonded slab.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from limbcli.feb.settings import schedule
from limbcli.materials.ogden import ogden_type
from limbcli.model import Block, Domain, LimbModel
from limbcli.solvers.session import ReferenceSession
from limbcli.solvers.session_options import StopWhen
from tests.benchmarks import layered_member as family
from tests.benchmarks.layered_slab import CellCounts, Slab

STRAINS = (0.05, 0.12, 0.2)
RATIOS = (0.5, 1.0, 4.0, 15.0)
FASCIA_SHARE = 0.02  # thickness of the fascia over that of all tissue
# thickness, fat share and skin (as in `family.Member`); a ratio of strains, fat over muscle, at STRAINS[-1]
SHAPES = {"thin, 0.38": ((1.24, 0.147, 0.041), 0.38), "thick, 0.55": ((2.2, 0.136, 0.053), 0.55)}


@dataclass(frozen=True)
class Structure:
    """slides : muscle moves freely along the bone; skin, fascia : c over that of muscle (None: no fascia);
    flank : width of tissue beside the face over the root of its area (None: as in the family)
    """

    slides: bool = False
    flank: float | None = None
    skin: float = 5.0
    fascia: float | None = None


STRUCTURES: Mapping[str, Structure] = {
    "bonded slab (the family)": Structure(),
    "muscle slides on the bone": Structure(slides=True),
    "skin 30 c_muscle": Structure(skin=30.0),
    "sliding, stiff skin": Structure(slides=True, skin=30.0),
    "sliding, stiff skin, fascia": Structure(slides=True, skin=30.0, fascia=30.0),
    "the same, near flanks": Structure(slides=True, flank=0.3, skin=30.0, fascia=30.0),
}


def strains_and_force(member: family.Member, structure: Structure) -> tuple[float, float]:
    """Strain of fat over that of muscle, and force over (c_muscle, face, strain), at the last of STRAINS."""
    slab = member.slab()
    if structure.flank is not None:
        slab = replace(slab, margin=structure.flank * family.ROOT_AREA)
    plan = schedule([each * slab.thickness for each in STRAINS])
    counts = CellCounts(muscle=3) if structure.fascia else CellCounts()
    model = _changed(family._loaded(member, slab, plan, counts), slab, structure)
    session = ReferenceSession(model, threads=1, tolerance=1e-3)
    try:
        found = session.solve(records=True, stop=StopWhen(required=2, patient=False))
    finally:
        session.close()
    answer = family._answer(member, slab, plan, found, False)
    fat, muscle = answer.below_skin[-1] - answer.below_fat[-1], answer.below_fat[-1]
    return float(fat / slab.fat * slab.muscle / muscle), float(answer.force[-1])


def _changed(model: LimbModel, slab: Slab, structure: Structure) -> LimbModel:
    skin = ogden_type(c=structure.skin * family._C, f_kappa=family.F_KAPPA, m=2.0)
    model = replace(model, materials={**model.materials, "skin": skin})
    if structure.slides:
        free = tuple(
            replace(each, dofs=("z",)) if each.node_set == "base" else each for each in model.supports
        )
        model = replace(model, supports=free)
    return _with_fascia(model, slab, structure.fascia) if structure.fascia else model


def _with_fascia(model: LimbModel, slab: Slab, stiffness: float) -> LimbModel:
    """The uppermost of three rows of muscle as a thin stiff layer."""
    top, thin = -(slab.skin + slab.fat), FASCIA_SHARE * slab.thickness
    low = -slab.thickness
    points = model.mesh.points.copy()
    inside = points[:, 2] < top
    before = [low, low + slab.muscle / 3, low + 2 * slab.muscle / 3, top]
    points[inside, 2] = np.interp(points[inside, 2], before, [low, 0.5 * (low + top - thin), top - thin, top])
    muscle = model.mesh.block("tissue")
    is_fascia = points[muscle.cells].mean(axis=1)[:, 2] > top - thin
    parts = (
        Block("tissue", muscle.kind, muscle.cells[~is_fascia]),
        Block("fascia", muscle.kind, muscle.cells[is_fascia]),
    )
    blocks = tuple(
        part for each in model.mesh.blocks for part in (parts if each.name == "tissue" else (each,))
    )
    law = ogden_type(c=stiffness * family._C, f_kappa=family.F_KAPPA, m=2.0)
    return replace(
        model,
        mesh=replace(model.mesh, points=points, blocks=blocks),
        materials={**model.materials, "fascia": law},
        domains=(*model.domains, Domain("fascia", "fascia")),
    )


def explained(
    shape: tuple[float, float, float], measured: float, structure: Structure
) -> tuple[float, float]:
    """c_fat/c_muscle with which the strains are in the measured ratio (by the nearest two of RATIOS), and the
    force over (c_muscle, face, strain) there."""
    found = [strains_and_force(family.Member(*shape, ratio, 2.0), structure) for ratio in RATIOS]
    ln_strain, ln_force = (np.log([each[k] for each in found]) for k in (0, 1))
    k = int(np.clip(np.searchsorted(-ln_strain, -np.log(measured)), 1, len(RATIOS) - 1))
    share = (np.log(measured) - ln_strain[k - 1]) / (ln_strain[k] - ln_strain[k - 1])
    at = [np.log(RATIOS)[k - 1 : k + 1], ln_force[k - 1 : k + 1]]
    ratio, force = (float(np.exp(a + share * (b - a))) for a, b in at)
    return ratio, force


def main() -> None:
    for name, (shape, measured) in SHAPES.items():
        print(f"{name}: assumption | c_fat/c_muscle | c_muscle over that of the bonded slab")
        bonded = None
        for words, structure in STRUCTURES.items():
            ratio, force = explained(shape, measured, structure)
            bonded = bonded or force
            print(f"  {words} | {ratio:.2g} | {bonded / force:.2g}", flush=True)


if __name__ == "__main__":
    main()
