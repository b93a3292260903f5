"""Numerical effects of mesh, crop and contact on a site's curves, assessed before tissue effects.

The working mesh is corrected to the site's own mesh where possible. The remaining errors of the mesh, the
assumed compressibility, the cut and the contact enter the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case, Site
from limbcli.diagnosis.curves.curve_plan import FIRST_M, where_solved
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.diagnosis.data.noise_parts import COMPRESSIBILITY, FEWEST_SMOOTH, SmoothDepth, readings
from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.mesh_error.mesh_correction import F_KAPPA, START_M, own_run
from limbcli.diagnosis.mesh_error.penetration import LEFT_ERROR, Penetration, penetration
from limbcli.effects import Effect, effect
from limbcli.effects.curves import Curves, depth_at, gaps_filled, log_force_at
from limbcli.effects.effect import Parameter, Theta
from limbcli.effects.far_side import FAR_SIDE, far_side
from limbcli.effects.tissue import core, with_core
from limbcli.effects.turn import TURN
from limbcli.errors import LimbError
from limbcli.measurement.indentation import Levels
from limbcli.model import Array, LimbModel
from limbcli.progress import Progress

USUAL_C = 0.006  # MPa, reference c; arbitrary, as force and modulus are proportional to it
# Remaining uncertainty as a fraction of the change by 5 % more tissue: surfaces and posture leave 4 %.
_THICKNESS_LEFT = 0.8
# Remaining uncertainty as a fraction of the change by freeing the cut, half of which is corrected. In four
# whole limbs and four blocks fixed at 57 mm, the true position differs from half-way by 0.32 (root mean
# square).
_CUT_LEFT = 0.3
# The same for holding the far side: a limb hangs freely or is held, one as likely as the other.
_FAR_SIDE_LEFT = 0.5
_STIFFNESSES = np.geomspace(0.1, 10.0, 81)  # trial values of c, as multiples of the reference c
_DOUBTFUL = 0.15  # uncertainty in ln force, as it enters the noise, from which a warning is given
STIFFER = 4.0  # factor on f_kappa, towards the incompressible limit


def _stiffened(model: LimbModel, theta: Theta) -> LimbModel:
    law = core(model.materials["tissue"])
    return with_core(
        model, law.with_parameters(kappa=float(law.parameters["kappa"]) * theta["kappa_factor"])  # type: ignore[arg-type]
    )  # fmt: skip


INCOMPRESSIBILITY = Effect(
    name=COMPRESSIBILITY.removeprefix("model: "),
    sentence="the compressibility assumed by the diagnosis is not the tissue's",
    kind="numerical",
    source="nearly incompressible limit",
    parameters=(Parameter("kappa_factor", null=1.0, start=STIFFER, low=1.0, high=10.0, typical=STIFFER),),
    apply=_stiffened,
    solves=True,
)


def f_kappa_at(deviations: float) -> float:
    """f_kappa that is this many standard deviations of its prior from the value in the models; inf beyond the
    incompressible limit.

    A deviation is the change to `STIFFER` times the value, and to first order the change by compressibility
    is proportional to that of 1 / f_kappa.

    >>> f_kappa_at(0.0), f_kappa_at(1.0), f_kappa_at(2.0)
    (100.0, 400.0, inf)
    """
    per = 1.0 - deviations * (1.0 - 1.0 / STIFFER)
    return F_KAPPA / per if per > 0 else float("inf")


@dataclass
class Notes:
    """Data and warnings collected while preparing a site, to be written with its results."""

    data: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Intervention:
    """Result of one numerical check: change of ln force and ln speed at the levels.

    deviations : largest change of the force, in standard deviations of the readings
    left : fraction of the change that remains uncertain
    """

    name: str
    log_force: Array
    log_speed: Array
    deviations: float
    note: str = ""
    left: float = 1.0


@dataclass(eq=False)
class NumericalChecks:
    """The numerical checks of one site on its simulations.

    size : mm, of the working mesh's edges; penetration : of the simulated contact, set by `interventions`
    """

    case: Case
    site: Site
    levels: Levels
    simulations: SiteSimulations
    out: Path
    size: float
    notes: Notes
    progress: Progress
    penetration: Penetration | None = None

    @cached_property
    def depth(self) -> Array:
        """Depth (n_levels,) in mm of a smooth curve through the readings; as read if these are too few."""
        protocol = readings(self.levels)
        if len(protocol) < FEWEST_SMOOTH:
            return self.levels.depth
        smooth = np.maximum(SmoothDepth.through(protocol).at(self.levels.force), 0.0)
        return np.where(np.isfinite(self.levels.depth), smooth, np.nan)

    def positions(self) -> list[Effect]:
        """Freeing the cut, and holding the far side if there is tissue behind the bone (not in a layer on a
        bench)."""
        return [effect("crop"), *([FAR_SIDE] if len(far_side(self.simulations.model)) else [])]

    def curves_with(self, numerical: Effect, m: float) -> Curves:
        return self.simulations.curves(m, ((numerical, numerical.start),))

    def interventions(self) -> list[Intervention]:
        """All numerical checks, made at the likely m, as their effects grow with m."""
        found, m = [], self.likely_m
        turn = (TURN,) if isinstance(self.site.long_axis, str) else ()
        always = (effect("contact"), INCOMPRESSIBILITY, effect("thickness"))
        for numerical in (*self.positions(), *always, *turn):
            self.progress.event("note", text=f"numerical check: {numerical.name}")
            try:
                found.append(self._intervene(numerical, m))
            except LimbError as error:
                self.notes.data.setdefault("numerical_not_evaluated", {})[numerical.name] = error.what
        return found + self._locking()

    @cached_property
    def likely_m(self) -> float:
        """The m of `FIRST_M` whose curve, with the best c, fits the measured depths best at the measured
        forces; `START_M` if this cannot be determined."""
        scatter = depth_scatter(self.simulations, self.levels)
        return min(scatter, key=lambda m: scatter[m]) if scatter else START_M

    def _intervene(self, numerical: Effect, m: float) -> Intervention:
        plain_curves = self.simulations.curves(m)
        changed = self.curves_with(numerical, m)
        judged = self._judged(numerical.name, plain_curves, changed, numerical.sentence)
        if numerical.name == "contact":
            self.penetration = penetration(plain_curves, changed)
        # A free cut gives too low a force and a fixed one too high a force: curves are corrected half-way.
        # Reducing the penalty to a quarter lowers the force by 1.5 to 3 times what the remaining gap does.
        # The curves are corrected for this gap; if it is unknown, the whole change counts as uncertain.
        share = {
            "crop": _CUT_LEFT, FAR_SIDE.name: _FAR_SIDE_LEFT,
            "contact": 1.0 if self.penetration is None else LEFT_ERROR,
            "thickness": _THICKNESS_LEFT,
        }  # fmt: skip
        return replace(judged, left=share.get(numerical.name, 1.0))

    def _locking(self) -> list[Intervention]:
        """Locking check if the site's own run has linear elements: its force compared with the working
        tet10."""
        try:
            element, own = own_run(self.site, self.out, c=self.simulations.c)
        except LimbError as error:
            if self.case.model.element == "tet4":
                self.notes.data.setdefault("numerical_not_evaluated", {})["locking"] = error.what
            return []
        if element != "tet4":
            return []
        working = self.simulations.curves(START_M)
        linear = replace(working, force=np.r_[0.0, np.exp(log_force_at(own, working.depth[1:]))])
        judged = self._judged("locking", linear, working, "tet4 against tet10")
        if judged.deviations > decisions.MATTERS_SD:
            self.notes.warnings.append(
                f"linear elements lock here: the force changes by up to {judged.deviations:.1f} deviations "
                "with quadratic ones. This is numerical, not the tissue; the diagnosis continues with tet10."
            )
        return [judged]

    def _judged(self, name: str, before: Curves, after: Curves, note: str) -> Intervention:
        change, speed = change_of(before, after)
        change[0] = change[1]
        at_levels = np.interp(self.depth, before.depth, change)
        speeds = at_depths(self.depth, before, speed)
        noise = self.site.noise
        slope = SmoothDepth.through(readings(self.levels)).slope(self.levels.force)
        deviation = np.hypot(noise.force, slope * noise.depth)
        size = float(np.max(np.abs(at_levels * self.levels.force) / deviation))
        return Intervention(name, at_levels, speeds, size, note)


def change_of(before: Curves, after: Curves) -> tuple[Array, Array]:
    """Change of ln force (n,), 0 at depth 0, and of ln speeds (n, n_parts), between curves of the same
    depths."""
    change = np.zeros(len(before.depth))
    change[1:] = np.log(np.maximum(after.force[1:], 1e-9) / np.maximum(before.force[1:], 1e-9))
    return change, gaps_filled(after.log_speed - before.log_speed)


def at_depths(depth: Array, curves: Curves, table: Array) -> Array:
    """Interpolate a table over the curves' depths to other depths."""
    return np.array([np.interp(depth, curves.depth, column) for column in table.T]).T


def large_uncertainty(interventions: Sequence[Intervention]) -> str | None:
    """A warning if the numerical uncertainty is a large part of the force, as mostly over thin tissue."""
    worst = {
        each.name: each.left * float(np.max(np.abs(each.log_force)))
        for each in interventions
        if each.name != "locking" and each.left * np.max(np.abs(each.log_force)) > _DOUBTFUL
    }
    if not worst:
        return None
    parts = ", ".join(f"{name} {100 * np.expm1(change):.0f} %" for name, change in worst.items())
    return (
        f"numerical uncertainty is a large part of the force here ({parts}): interpret the verdict with "
        "caution, and measure where there is more tissue over the bone"
    )


def depth_scatter(simulations: SiteSimulations, levels: Levels) -> dict[float, float]:
    """For each m of `FIRST_M`: mean square difference (mm2) between the measured depths and the model's at
    the measured forces, for the best c.

    Empty if fewer than two levels have a force and a depth above zero, or nothing can be solved.
    """
    force, depth = levels.force, levels.depth
    rising = (force > 0) & (depth > 0)
    found: dict[float, float] = {}
    if rising.sum() < 2:
        return found
    for m, curves in where_solved(simulations.curves, FIRST_M).items():
        off = [depth[rising] - depth_at(curves, force[rising] / times) for times in _STIFFNESSES]
        found[m] = min(float(np.mean(each**2)) for each in off)
    return found
