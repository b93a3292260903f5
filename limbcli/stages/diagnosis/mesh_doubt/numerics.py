"""What mesh, crop and contact alone do to a site's curves: tried on the model, before any tissue is blamed.

The working mesh is tied to the site's own where that was run; what is left of the mesh's error,
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
from numpy.typing import NDArray

from limbcli.case import Case, Site
from limbcli.diagnostics import thresholds
from limbcli.effects import Effect, effect
from limbcli.effects.base import Parameter, Theta
from limbcli.effects.reading import Curves, depth_at, log_force_at
from limbcli.effects.tissue import core, with_core
from limbcli.errors import LimbError, SolveError
from limbcli.measurement.indentation import Levels
from limbcli.model import Array, LimbModel
from limbcli.progress import Progress
from limbcli.results import read_result
from limbcli.stages.diagnosis.curves.curves import FIRST_M, CurveBook
from limbcli.stages.diagnosis.curves.penetration import LEFT_ERROR, Penetration, penetration
from limbcli.stages.diagnosis.data.data import USUAL_THICKNESS
from limbcli.stages.diagnosis.data.noise import FEWEST_SMOOTH, IN_MEAN, ModelError, SmoothDepth, readings
from limbcli.stages.diagnosis.mesh_doubt.mesh_ratio import START_M, OwnRun, Tie, own_run
from limbcli.stages.diagnosis.mesh_doubt.mesh_ties import Tells, Tying, at_depths
from limbcli.stages.geometry_gain import assumed_gain

USUAL_C = 0.006  # MPa; force and modulus are proportional to it, so that any would do
_ALIKE = 0.8  # correlation of the mesh's error between neighbouring levels
# Half a voxel's edge of first touch: a probe 53 mm long that stands 1 degree otherwise touches 0.5 mm sooner.
_VOXEL_SHARE, _IMAGE_GAIN = 0.5, 0.05
_SURFACE_GEOMETRY = (0.3, 0.04)  # mm, fraction: surfaces that were given are taken for better
_THICKNESS_LEFT = 0.8  # of what 5 % more tissue change: surfaces and posture leave 4 %
_CUT_LEFT = 0.2  # of what freeing the cut changes: half of it is put right
_STRAIN = 0.03  # of all strains: posture, the volume of a limb on another day
_MAP_STRAIN = 0.08  # the same of a map's pattern alone: how fast it grows differs between meshes
_STIFFNESSES = np.geomspace(0.1, 10.0, 81)  # times the reference c
_STIFFER = 4.0  # times f_kappa: towards the incompressible limit


def _stiffened(model: LimbModel, theta: Theta) -> LimbModel:
    law = core(model.materials["tissue"])
    return with_core(
        model, law.with_parameters(kappa=float(law.parameters["kappa"]) * theta["kappa_factor"])  # type: ignore[arg-type]
    )  # fmt: skip


INCOMPRESSIBILITY = Effect(
    name="f-kappa",
    sentence="the compressibility that the diagnosis holds is not the tissue's",
    kind="numerical",
    source="nearly incompressible limit",
    parameters=(Parameter("kappa_factor", null=1.0, start=_STIFFER, low=1.0, high=10.0, typical=_STIFFER),),
    apply=_stiffened,
    solves=True,
)


@dataclass(frozen=True, eq=False)
class Intervention:
    """A numerical effect tried: ln of the force's change at the levels, and its largest in deviations.

    left : the share of the change that is still in doubt
    """

    name: str
    log_force: Array
    log_speed: Array
    deviations: float
    note: str = ""
    left: float = 1.0
    facts: dict[str, Any] = field(default_factory=dict)


class Numerics:
    """The numerical checks of one site on one book of curves."""

    def __init__(
        self, case: Case, site: Site, levels: Levels, book: CurveBook, *, out: Path, size: float,
        notes: Tells, progress: Progress,
    ):  # fmt: skip
        self.case, self.site, self.levels, self.book = case, site, levels, book
        self.out, self.size, self.notes, self.progress = out, size, notes, progress
        self.depth = smooth_depth(levels)
        self.penetration: Penetration | None = (
            None  # of the contact that the curves have; known after interventions
        )

    def tie(self, *, solves: bool = True) -> Tie:
        """To the site's own mesh, and a limb that is not cut; `solves`: by simulations."""
        several, freed = self._tied_at(), {}
        if solves:
            crop = effect("crop")
            for m in several:
                with contextlib.suppress(SolveError):  # told where it is tried as an intervention
                    freed[m] = self.book.curves(m, ((crop, crop.start),))
        return Tying(
            self.site, self.depth, self.book, out=self.out, size=self.size, several=several,
            notes=self.notes, progress=self.progress,
        ).tie(solves=solves, freed=freed)  # fmt: skip

    def _tied_at(self) -> list[float]:
        """The likely m first; with maps, whose difference between meshes grows with m, another one too."""
        likely = self.likely_m
        if self.site.swe_maps is None:
            return [likely]
        return [likely, *(m for m in FIRST_M if m != likely and self._is_solved(m))]

    def _is_solved(self, m: float) -> bool:
        try:
            self.book.curves(m)
        except SolveError:
            return False
        return True

    def _at_levels(self, curves: Curves, table: Array) -> Array:
        return at_depths(self.depth, curves, table)

    def _own_run(self) -> OwnRun:
        return own_run(self.site, self.out, c=self.book.c)

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
        force, depth = self.levels.force, self.levels.depth
        rising = (force > 0) & (depth > 0)
        if rising.sum() < 2:
            return START_M
        scatter = {}
        for m in FIRST_M:
            try:
                curves = self.book.curves(m)
            except SolveError:
                continue
            off = [depth[rising] - depth_at(curves, force[rising] / times) for times in _STIFFNESSES]
            scatter[m] = min(float(np.mean(each**2)) for each in off)
        return min(scatter, key=lambda m: scatter[m])

    def _intervene(self, numerical: Effect, m: float) -> Intervention:
        plain_curves = self.book.curves(m)
        changed = self.book.curves(m, ((numerical, numerical.start),))
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
        working = self.book.curves(START_M)
        nothing = np.zeros((len(own.depth) + 1, 0))
        theirs = Curves(np.r_[0.0, own.depth], np.r_[0.0, own.force], nothing, np.zeros(0))
        linear = replace(working, force=np.r_[0.0, np.exp(log_force_at(theirs, working.depth[1:]))])
        judged = self._judged("locking", linear, working, "tet4 against tet10")
        if judged.deviations > thresholds.MATTERS_SD:
            self.notes.warnings.append(
                f"linear elements lock here: the force changes by up to {judged.deviations:.1f} deviations "
                "with quadratic ones. That is numerical, not tissue; the diagnosis goes on with tet10."
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
        slope = measured_slope(self.levels)
        deviation = np.hypot(noise.force, slope * noise.depth)
        size = float(np.max(np.abs(at_levels * self.levels.force) / deviation))
        return Intervention(name, at_levels, speeds, size, note)

    # ------------------------------------------------------------ as noise

    def _growth(self) -> list[ModelError]:
        """How fast a map's pattern grows with depth."""
        if self.site.swe_maps is None:
            return []
        curves = self.book.curves(self.likely_m)
        rise = np.nan_to_num(np.gradient(curves.log_speed, curves.depth, axis=0))
        moved = (
            _MAP_STRAIN
            * np.nan_to_num(self.depth)[:, None]
            * at_depths(np.nan_to_num(self.depth), curves, rise)
        )
        return [ModelError("model: growth of the maps' pattern", np.zeros(len(self.levels)), moved)]

    def map_slopes(self) -> Array:
        """1/mm (n_levels used, n_parts): how the model's ln speeds change with depth at the levels."""
        curves = self.book.curves(self.likely_m)
        rise = np.nan_to_num(np.gradient(curves.log_speed[:, 1:], curves.depth, axis=0))
        keep = np.isfinite(self.levels.force) & np.isfinite(self.levels.depth)
        return at_depths(self.depth[keep], curves, rise)

    def parts_seen(self) -> NDArray[np.bool_]:
        """Parts of the region (n_parts,) that the models without effects show at every depth."""
        seen = np.ones(len(self.book.windows.depths) - 1, dtype=bool)
        for m in FIRST_M:
            with contextlib.suppress(SolveError):
                seen &= np.isfinite(self.book.curves(m).log_speed[:, 1:]).all(axis=0)
        return seen

    def noise(self, tie: Tie, interventions: Sequence[Intervention]) -> list[ModelError]:
        """What of all this the data have to allow for."""
        errors = [
            ModelError(f"model: {each.name}", each.left * each.log_force, each.left * each.log_speed)
            for each in interventions if each.name != "locking"
        ]  # fmt: skip
        errors += self._geometry()
        no_force = np.zeros(len(self.levels))
        no_speed = np.zeros((len(self.levels), len(self.book.windows.depths)))
        return [
            *errors,
            ModelError("model: mesh", tie.mesh_error, no_speed, correlation=_ALIKE),
            *self._mean_speed(tie, no_force),
        ]

    def _mean_speed(self, tie: Tie, no_force: Array) -> list[ModelError]:
        """Of the means, where there are no maps: the mesh, and how wide the region is that they are of."""
        if self.site.swe_maps is not None:
            return []
        curves = self.book.curves(self.likely_m)
        width = np.interp(self.depth, curves.depth, self.book.windows.width_doubt(curves.log_speed))
        strain = IN_MEAN * np.nan_to_num(self.depth) / self.thickness
        return [
            ModelError(
                "model: mesh, in the mean speed", no_force, self._in_mean(np.hypot(tie.speed_error, strain))
            ),
            ModelError("model: width of the window", no_force, self._in_mean(width)),
        ]

    def _in_mean(self, deviation: Array) -> Array:
        table = np.zeros((len(self.levels), len(self.book.windows.depths)))
        table[:, 0] = np.nan_to_num(deviation)
        return table

    @property
    def thickness(self) -> float:
        """mm of tissue under the probe, as far as it is known."""
        thick = self.book.curves(self.likely_m).thickness
        return thick if np.isfinite(thick) and thick > 0 else USUAL_THICKNESS

    def _geometry(self) -> list[ModelError]:
        """What the surfaces' own error does: to the depth at first touch, to the thickness and with it to all
        strains, and to the force as a whole."""
        spacing = read_spacing(self.out)
        touch, gain = _SURFACE_GEOMETRY
        if spacing is not None:
            touch, gain = _VOXEL_SHARE * float(np.prod(spacing)) ** (1 / 3), _IMAGE_GAIN
        assumed, warning = assumed_gain(self.case, self.site, self.out)
        if warning and warning not in self.notes.warnings:
            self.notes.warnings.append(warning)
        gain = float(np.hypot(gain, assumed))
        strain = float(np.hypot(touch / self.thickness, _STRAIN))
        n = len(self.levels)
        none = np.zeros((n, len(self.book.windows.depths)))
        return [
            ModelError("model: depth at first touch", np.zeros(n), none, depth=touch),
            ModelError("model: strain by the thickness", np.zeros(n), none, strain=strain),
            *self._growth(),
            ModelError("model: gain of the force by the geometry", np.full(n, gain), none),
        ]


def too_doubtful(interventions: Sequence[Intervention]) -> str | None:
    """A warning where numerical doubt is a large part of the force: over thin tissue, mostly."""
    worst = {
        each.name: each.left * float(np.max(np.abs(each.log_force)))
        for each in interventions
        if each.name != "locking" and each.left * np.max(np.abs(each.log_force)) > thresholds.DOUBTFUL
    }
    if not worst:
        return None
    parts = ", ".join(f"{name} {100 * np.expm1(change):.0f} %" for name, change in worst.items())
    return (
        f"numerical doubt is a large part of the force here ({parts}): take the verdict with care, and "
        "measure where there is more tissue over the bone"
    )


def read_spacing(out: Path) -> list[float] | None:
    """mm between the voxels that the surfaces were made of; None where surfaces were given."""
    try:
        image = read_result(out, "segment").data.get("image")
    except LimbError:
        return None
    found = image.get("spacing_mm") if isinstance(image, dict) else None
    return [float(each) for each in found] if found else None


def smooth_depth(levels: Levels) -> Array:
    """mm (n_levels,) of a smooth curve through the readings, where there are enough of them."""
    protocol = readings(levels)
    if len(protocol) < FEWEST_SMOOTH:
        return levels.depth
    smooth = np.maximum(SmoothDepth.through(protocol).at(levels.force), 0.0)
    return np.where(np.isfinite(levels.depth), smooth, np.nan)


def measured_slope(levels: Levels) -> Array:
    """N/mm along the measured curve, level by level (n,); 0 where depth does not grow."""
    apart = np.maximum.accumulate(levels.depth) + 1e-6 * np.arange(len(levels))
    slope = np.gradient(levels.force, apart)
    rising = np.diff(np.maximum.accumulate(levels.depth), prepend=-1.0) > 1e-3
    return np.asarray(np.where(rising, np.nan_to_num(slope, posinf=0.0, neginf=0.0), 0.0))
