"""What mesh, crop and contact alone do to a site's curves: tried on the model, before any tissue is blamed.

The working mesh is corrected to the site's own where that was run; what is left of the mesh's error,
of the incompressibility that is held, of cut and contact enters the noise.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case, Site
from limbcli.diagnostics import thresholds
from limbcli.effects import Effect, effect
from limbcli.effects.base import Parameter, Theta
from limbcli.effects.curves import Curves, depth_at, log_force_at
from limbcli.effects.tissue import core, with_core
from limbcli.errors import LimbError, SolveError
from limbcli.measurement.indentation import Levels
from limbcli.model import Array, LimbModel
from limbcli.progress import Progress
from limbcli.stages.diagnosis.curves.penetration import LEFT_ERROR, Penetration, penetration
from limbcli.stages.diagnosis.curves.site_simulations import FIRST_M, SiteSimulations
from limbcli.stages.diagnosis.data.noise import FEWEST_SMOOTH, SmoothDepth, readings
from limbcli.stages.diagnosis.mesh_error.mesh_comparison import MeshComparison, ResultNotes, at_depths
from limbcli.stages.diagnosis.mesh_error.mesh_correction import START_M, MeshCorrection, SiteMeshRun, own_run

USUAL_C = 0.006  # MPa; force and modulus are proportional to it, so that any would do
_THICKNESS_LEFT = 0.8  # of what 5 % more tissue change: surfaces and posture leave 4 %
# Of what freeing the cut changes, half is put right. Four limbs as a whole and four blocks held at 57 mm lie
# 0.32 of the way beside the middle, root mean square.
_CUT_LEFT = 0.3
_STIFFNESSES = np.geomspace(0.1, 10.0, 81)  # times the reference c
_STIFFER = 4.0  # times f_kappa: towards the incompressible limit


def _stiffened(model: LimbModel, theta: Theta) -> LimbModel:
    law = core(model.materials["tissue"])
    return with_core(
        model, law.with_parameters(kappa=float(law.parameters["kappa"]) * theta["kappa_factor"])  # type: ignore[arg-type]
    )  # fmt: skip


INCOMPRESSIBILITY = Effect(
    name="f-kappa",
    sentence="the compressibility assumed by the diagnosis is not the tissue's",
    kind="numerical",
    source="nearly incompressible limit",
    parameters=(Parameter("kappa_factor", null=1.0, start=_STIFFER, low=1.0, high=10.0, typical=_STIFFER),),
    apply=_stiffened,
    solves=True,
)


@dataclass(frozen=True, eq=False)
class Intervention:
    """A numerical effect tried: ln of the force's change at the levels, and its largest in deviations.

    left : the share of the change that is still uncertain
    """

    name: str
    log_force: Array
    log_speed: Array
    deviations: float
    note: str = ""
    left: float = 1.0
    facts: dict[str, Any] = field(default_factory=dict)


class NumericalChecks:
    """The numerical checks of one site on its simulations."""

    def __init__(
        self, case: Case, site: Site, levels: Levels, simulations: SiteSimulations, *, out: Path, size: float,
        notes: ResultNotes, progress: Progress,
    ):  # fmt: skip
        self.case, self.site, self.levels, self.simulations = case, site, levels, simulations
        self.out, self.size, self.notes, self.progress = out, size, notes, progress
        self.depth = smooth_depth(levels)
        self.penetration: Penetration | None = (
            None  # of the contact that the curves have; known after interventions
        )

    def correction(self, *, solves: bool = True) -> MeshCorrection:
        """To the site's own mesh, and a limb that is not cut; `solves`: by simulations."""
        several, freed = self._compared_at(), {}
        if solves:
            crop = effect("crop")
            for m in several:
                with contextlib.suppress(SolveError):  # told where it is tried as an intervention
                    freed[m] = self.simulations.curves(m, ((crop, crop.start),))
        return MeshComparison(
            self.site, self.depth, self.simulations, out=self.out, size=self.size, several=several,
            notes=self.notes, progress=self.progress,
        ).correction(solves=solves, freed=freed)  # fmt: skip

    def _compared_at(self) -> list[float]:
        """The likely m first; with maps, whose difference between meshes grows with m, another one too."""
        likely = self.likely_m
        if self.site.swe_maps is None:
            return [likely]
        return [likely, *(m for m in FIRST_M if m != likely and self._is_solved(m))]

    def _is_solved(self, m: float) -> bool:
        try:
            self.simulations.curves(m)
        except SolveError:
            return False
        return True

    def _at_levels(self, curves: Curves, table: Array) -> Array:
        return at_depths(self.depth, curves, table)

    def _own_run(self) -> SiteMeshRun:
        return own_run(self.site, self.out, c=self.simulations.c)

    # ------------------------------------------------------------ interventions

    def interventions(self) -> list[Intervention]:
        """Each tried at the m that is nearest to the tissue's, as their effects grow with it."""
        found, m = [], self.likely_m
        for numerical in (effect("crop"), effect("contact"), INCOMPRESSIBILITY, effect("thickness")):
            self.progress.event("note", text=f"numerical check: {numerical.name}")
            try:
                found.append(self._intervene(numerical, m))
            except LimbError as error:
                self.notes.data.setdefault("numerical_not_evaluated", {})[numerical.name] = error.what
        return found + self._locking()

    @cached_property
    def likely_m(self) -> float:
        """The m whose depths at the measured forces, for any c, are nearest to the measured ones, of those
        solved first."""
        scatter = depth_scatter(self.simulations, self.levels)
        return min(scatter, key=lambda m: scatter[m]) if scatter else START_M

    def _intervene(self, numerical: Effect, m: float) -> Intervention:
        plain_curves = self.simulations.curves(m)
        changed = self.simulations.curves(m, ((numerical, numerical.start),))
        judged = self._judged(numerical.name, plain_curves, changed, numerical.sentence)
        if numerical.name == "contact":
            self.penetration = penetration(plain_curves, changed)
        # With the cut free the force is too low, held it is too high: curves are put half-way.
        # What a quarter of the penalty takes from the force is one and a half times to three times what the
        # gap still takes, which the curves are corrected for; if that is not known, it is counted whole.
        share = {
            "crop": _CUT_LEFT, "contact": 1.0 if self.penetration is None else LEFT_ERROR,
            "thickness": _THICKNESS_LEFT,
        }  # fmt: skip
        return replace(judged, left=share.get(numerical.name, 1.0))

    def _locking(self) -> list[Intervention]:
        """Where the site's own run is of linear elements: what it gives against the working tet10."""
        try:
            own = self._own_run()
        except LimbError as error:
            if self.case.model.element == "tet4":
                self.notes.data.setdefault("numerical_not_evaluated", {})["locking"] = error.what
            return []
        if own.element != "tet4":
            return []
        working = self.simulations.curves(START_M)
        nothing = np.zeros((len(own.depth) + 1, 0))
        theirs = Curves(np.r_[0.0, own.depth], np.r_[0.0, own.force], nothing, np.zeros(0))
        linear = replace(working, force=np.r_[0.0, np.exp(log_force_at(theirs, working.depth[1:]))])
        judged = self._judged("locking", linear, working, "tet4 against tet10")
        if judged.deviations > thresholds.MATTERS_SD:
            self.notes.warnings.append(
                f"linear elements lock here: the force changes by up to {judged.deviations:.1f} deviations "
                "with quadratic ones. This is numerical, not the tissue; the diagnosis continues with tet10."
            )
        return [judged]

    def _judged(self, name: str, before: Curves, after: Curves, note: str) -> Intervention:
        change = np.zeros(len(before.depth))
        change[1:] = np.log(np.maximum(after.force[1:], 1e-9) / np.maximum(before.force[1:], 1e-9))
        change[0] = change[1]
        at_levels = np.interp(self.depth, before.depth, change)
        speed = np.nan_to_num(after.log_speed - before.log_speed)
        speeds = self._at_levels(before, speed)
        noise = self.site.noise
        slope = SmoothDepth.through(readings(self.levels)).slope(self.levels.force)
        deviation = np.hypot(noise.force, slope * noise.depth)
        size = float(np.max(np.abs(at_levels * self.levels.force) / deviation))
        return Intervention(name, at_levels, speeds, size, note)


def large_uncertainty(interventions: Sequence[Intervention]) -> str | None:
    """A warning where numerical uncertainty is a large part of the force: over thin tissue, mostly."""
    worst = {
        each.name: each.left * float(np.max(np.abs(each.log_force)))
        for each in interventions
        if each.name != "locking" and each.left * np.max(np.abs(each.log_force)) > thresholds.DOUBTFUL
    }
    if not worst:
        return None
    parts = ", ".join(f"{name} {100 * np.expm1(change):.0f} %" for name, change in worst.items())
    return (
        f"numerical uncertainty is a large part of the force here ({parts}): interpret the verdict with "
        "caution, and measure where there is more tissue over the bone"
    )


def depth_scatter(simulations: SiteSimulations, levels: Levels) -> dict[float, float]:
    """By m, of those solved first: mean square (mm2) of measured depths less those at the measured forces,
    for the best c. Empty where fewer than two levels have force and depth, or nothing is solved."""
    force, depth = levels.force, levels.depth
    rising = (force > 0) & (depth > 0)
    found: dict[float, float] = {}
    if rising.sum() < 2:
        return found
    for m in FIRST_M:
        try:
            curves = simulations.curves(m)
        except SolveError:
            continue
        off = [depth[rising] - depth_at(curves, force[rising] / times) for times in _STIFFNESSES]
        found[m] = min(float(np.mean(each**2)) for each in off)
    return found


def smooth_depth(levels: Levels) -> Array:
    """mm (n_levels,) of a smooth curve through the readings, where there are enough of them."""
    protocol = readings(levels)
    if len(protocol) < FEWEST_SMOOTH:
        return levels.depth
    smooth = np.maximum(SmoothDepth.through(protocol).at(levels.force), 0.0)
    return np.where(np.isfinite(levels.depth), smooth, np.nan)
