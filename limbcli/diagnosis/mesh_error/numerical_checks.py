"""Numerical effects of mesh, crop and contact on a site's curves, and the errors of its models in the noise.

The working mesh is corrected to the site's own mesh where possible. The remaining errors of the mesh, the
assumed compressibility, the cut, the contact and the geometry enter the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limbcli.case import Case, Site
from limbcli.diagnosis.curves.curve_plan import FIRST_M, where_solved
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.diagnosis.data.noise_parts import (
    COMPRESSIBILITY,
    IN_MEAN,
    STRAIN,
    USUAL_THICKNESS,
    KnownErrors,
    ModelError,
)
from limbcli.diagnosis.data.rows import FEWEST_SMOOTH, SmoothDepth, known_levels, readings
from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.mesh_error.mesh_correction import (
    F_KAPPA,
    LEFT_ERROR,
    START_M,
    MeshCorrection,
    Penetration,
    change_of,
    own_run,
    penetration,
)
from limbcli.effects import Effect, effect
from limbcli.effects.curves import Curves, depth_at, gaps_filled, log_force_at
from limbcli.effects.effect import Parameter, Theta
from limbcli.effects.far_side import FAR_SIDE, far_side
from limbcli.effects.tissue import core, with_core
from limbcli.effects.turn import TURN
from limbcli.errors import LimbError
from limbcli.measurement.indentation import Levels
from limbcli.model import Array, LimbModel
from limbcli.numbers.modes import at_depths
from limbcli.numbers.significant_digits import short
from limbcli.progress import Progress
from limbcli.results import data_if_there

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
_ALIKE = 0.8  # correlation of the mesh error between neighbouring levels
# Standard deviation of the depth at first touch: in voxel edges of imaged surfaces, and in mm of given ones.
# For comparison, a probe 53 mm long that is tilted by 1 degree touches 0.5 mm earlier.
_TOUCH_VOXELS, _TOUCH_MM = 0.5, 0.2
# Standard deviation of ln force, common to all levels, besides compressibility, cut, far side and thickness.
# At true c, m and f_kappa our force is off that of FEBio's records without noise by 4 % (root mean square,
# thirteen sites) in the first 60 % of the depth, by 7 and 13 % at strains of 0.27 and 0.35
# (`tests/benchmarks/map_errors.py`).
_GAIN = 0.07
# Relative standard deviation of the force if no fit varied an assumed geometry: as of parametric limbs.
USUAL_GAIN = 0.15
_STRAIN = 0.02  # relative standard deviation of all strains: posture, the scanner's scale of depths


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

    size : mm, of the working mesh's edges
    """

    case: Case
    site: Site
    levels: Levels
    simulations: SiteSimulations
    out: Path
    size: float
    notes: Notes
    progress: Progress

    @cached_property
    def depth(self) -> Array:
        """Depth (n_levels,) in mm of a smooth curve through the readings; as read if these are too few."""
        protocol = readings(self.levels)
        if len(protocol) < FEWEST_SMOOTH:
            return self.levels.depth
        smooth = np.maximum(SmoothDepth.through(protocol).at(self.levels.force), 0.0)
        return np.where(np.isfinite(self.levels.depth), smooth, np.nan)

    def positions(self) -> list[Effect]:
        """Freeing the cut, and holding the far side if there is tissue behind the bone (none on a bench)."""
        return [effect("crop"), *([FAR_SIDE] if len(far_side(self.simulations.model)) else [])]

    def curves_with(self, numerical: Effect, m: float) -> Curves:
        return self.simulations.curves(m, ((numerical, numerical.start),))

    def interventions(self) -> list[Intervention]:
        """All numerical checks, made at the likely m, as their effects grow with m."""
        found = []
        turn = (TURN,) if isinstance(self.site.long_axis, str) else ()
        always = (effect("contact"), INCOMPRESSIBILITY, effect("thickness"))
        for numerical in (*self.positions(), *always, *turn):
            self.progress.event("note", text=f"numerical check: {numerical.name}")
            try:
                found.append(self._intervene(numerical))
            except LimbError as error:
                self.notes.data.setdefault("numerical_not_evaluated", {})[numerical.name] = error.what
        return found + self._locking()

    @cached_property
    def likely_m(self) -> float:
        """The m of `FIRST_M` whose curve, with the best c, fits the depths best; else `START_M`."""
        rising = (self.levels.force > 0) & (self.levels.depth > 0)
        force, depth = self.levels.force[rising], self.levels.depth[rising]
        if len(depth) < 2:
            return START_M
        scatter = {
            m: min(float(np.mean((depth - depth_at(curves, force / c)) ** 2)) for c in _STIFFNESSES)
            for m, curves in where_solved(self.simulations.curves, FIRST_M).items()
        }
        return min(scatter, key=lambda m: scatter[m], default=START_M)

    def _intervene(self, numerical: Effect) -> Intervention:
        plain_curves, changed = self.curves, self.curves_with(numerical, self.likely_m)
        judged = self._judged(numerical.name, plain_curves, changed, numerical.sentence)
        # A free cut gives too low a force and a fixed one too high a force: curves are corrected half-way.
        # Reducing the penalty to a quarter lowers the force by 1.5 to 3 times what the remaining gap does.
        # The curves are corrected for this gap; if it is unknown, the whole change counts as uncertain.
        left = {"crop": _CUT_LEFT, FAR_SIDE.name: _FAR_SIDE_LEFT, "thickness": _THICKNESS_LEFT}
        if numerical.name == "contact" and self.penetration is not None:
            return replace(judged, left=LEFT_ERROR)
        return replace(judged, left=left.get(numerical.name, 1.0))

    @cached_property
    def penetration(self) -> Penetration | None:
        """Of the probe into the simulated skin; None where it cannot be told."""
        with suppress(LimbError):
            return penetration(self.curves, self.curves_with(effect("contact"), self.likely_m))
        return None

    def _locking(self) -> list[Intervention]:
        """The force of the site's own run, if of linear elements, against that of the working tet10."""
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
        change = change_of(before, after)
        change[0, 0] = change[1, 0]
        moved = at_depths(change.T, before.depth, self.depth)
        noise = self.site.noise
        slope = SmoothDepth.through(readings(self.levels)).slope(self.levels.force)
        deviation = np.hypot(noise.force, slope * noise.depth)
        size = float(np.max(np.abs(moved[:, 0] * self.levels.force) / deviation))
        return Intervention(name, moved[:, 0], moved[:, 1:], size, note)

    # ------------------------------------------------------------ errors of the models

    @cached_property
    def curves(self) -> Curves:
        """Without effects, at the likely m."""
        return self.simulations.curves(self.likely_m)

    @property
    def has_bone(self) -> bool:
        return self.curves.thickness > 0

    def known_errors(self, correction: MeshCorrection, interventions: Sequence[Intervention]) -> KnownErrors:
        """What is known of how far the models of this site are off, for the noise of its data."""
        thickness = self.curves.thickness if self.has_bone else USUAL_THICKNESS
        keep = known_levels(self.levels)
        # derivative (n, 1 + n_parts) of ln speeds with depth, in 1/mm; where a part is not shown, that at the
        # depths next to it
        shown, rise = np.isfinite(self.curves.log_speed), np.full(self.curves.log_speed.shape, np.nan)
        for k in np.flatnonzero(shown.sum(axis=0) >= 2).tolist():
            here = shown[:, k]
            rise[here, k] = np.gradient(self.curves.log_speed[here, k], self.curves.depth[here])
        return KnownErrors(
            errors=self._errors(correction, interventions, thickness), map_share=correction.map_share,
            map_slopes=at_depths(gaps_filled(rise)[:, 1:].T, self.curves.depth, self.depth[keep]),
            thickness=thickness, bone_as_shown=bool(self.case.imaging.assumed),
        )  # fmt: skip

    def _errors(
        self, correction: MeshCorrection, interventions: Sequence[Intervention], thickness: float
    ) -> list[ModelError]:
        """Of numerical changes, the depth at first touch, all strains by the thickness, a common factor on
        the force, and the mesh; without maps also of mean speeds, by the mesh and the width of the region."""
        found = [
            ModelError(f"model: {each.name}", each.left * each.log_force, each.left * each.log_speed)
            for each in interventions if each.name != "locking"
        ]  # fmt: skip
        image = data_if_there(self.out, "segment").get("image")
        spacing = image.get("spacing_mm") if isinstance(image, dict) else None
        touch = _TOUCH_VOXELS * float(np.prod(spacing)) ** (1 / 3) if spacing else _TOUCH_MM
        assumed, warning = assumed_gain(self.case, self.site, self.out)
        self.notes.warnings.extend([warning] if warning else [])
        strain, gain = float(np.hypot(touch / thickness, _STRAIN)), float(np.hypot(_GAIN, assumed))
        found += [
            self._error("model: depth at first touch", depth=touch),
            self._error(STRAIN, strain=strain),
            self._error("model: gain of the force by the geometry", force=gain),
            self._error("model: mesh", force=correction.mesh_error, correlation=_ALIKE),
        ]
        if self.site.swe_maps is not None:
            return found
        windows, curves = self.simulations.windows, self.curves
        speeds = np.nan_to_num(np.exp(curves.log_speed[:, 1:]))  # 0 where a part is not shown
        n_shown = np.maximum(np.count_nonzero(speeds, axis=1), 1)
        mean, mean_square = speeds.sum(axis=1) / n_shown, (speeds**2).sum(axis=1) / n_shown
        spread = np.sqrt(np.maximum(mean_square / np.maximum(mean, 1e-9) ** 2 - 1.0, 0.0))
        spread, width = (
            np.interp(self.depth, curves.depth, each)
            for each in (spread, windows.width_uncertainty(curves.log_speed))
        )
        of_spread = np.nan_to_num(IN_MEAN * spread * self.depth / thickness)
        mesh = np.hypot(correction.speed_error, of_spread)
        return [
            *found,
            self._error("model: mesh, in the mean speed", mean_speed=mesh),
            self._error("model: width of the window", mean_speed=width),
        ]

    def _error(
        self, name: str, *, force: Array | float = 0.0, mean_speed: Array | float = 0.0, **more: Any
    ) -> ModelError:
        """An error of ln force and of ln mean speed at the levels, (n_levels,) or the same at all."""
        log_speed = np.zeros((len(self.levels), len(self.simulations.windows.depths)))
        log_speed[:, 0] = np.nan_to_num(mean_speed)
        return ModelError(name, np.zeros(len(log_speed)) + force, log_speed, **more)

    def parts_seen(self) -> NDArray[np.bool_]:
        """Parts of the region (n_parts,) that the models without effects show at every depth. Others come
        into view under load at the edges of the face, or lie at bone: the models err more in them at all
        depths."""
        seen = np.ones(self.simulations.windows.n_parts, dtype=bool)
        for curves in where_solved(self.simulations.curves, FIRST_M).values():
            seen &= np.isfinite(curves.log_speed[:, 1:]).all(axis=0)
        return seen


def large_uncertainty(interventions: Sequence[Intervention]) -> str | None:
    """A warning if the numerical uncertainty is a large part of the force, as mostly over thin tissue."""
    left = {each.name: each.left * float(np.max(np.abs(each.log_force))) for each in interventions}
    worst = {name: each for name, each in left.items() if name != "locking" and each > _DOUBTFUL}
    if not worst:
        return None
    parts = ", ".join(f"{name} {100 * np.expm1(change):.0f} %" for name, change in worst.items())
    return (
        f"numerical uncertainty is a large part of the force here ({parts}): interpret the verdict with "
        "caution, and measure where there is more tissue over the bone"
    )


def assumed_gain(case: Case, site: Site, out: Path) -> tuple[float, str]:
    """Standard deviation of ln force from an assumed geometry, and a warning; 0 if it was imaged."""
    words = case.imaging.assumed
    if not words:
        return 0.0, ""
    uncertainty = data_if_there(out, "fit", site=site.name).get("geometry_uncertainty") or {}
    found = uncertainty.get("gain_fraction")
    if uncertainty.get("words") != words or found is None:
        return USUAL_GAIN, (
            f"{words}. No fit has varied it: its uncertainty is taken as {100 * USUAL_GAIN:g} % of the force "
            f"at site {site.name}; run `limbcli fit`, then diagnose again"
        )
    return float(found), (
        f"{words}. From the fit's geometry variations, {short(100 * float(found), 2)} % of "
        f"the force at site {site.name} is uncertain, treated as one common factor; a change with depth is "
        "not allowed for"
    )
