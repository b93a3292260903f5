"""What mesh, crop and contact alone do to a site's curves: tried on the model, before any tissue is blamed.

The working mesh is tied to the site's own where that was run; what is left of the mesh's error,
of the incompressibility that is held, of cut and contact enters the noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from limbcli.case import Case, Site
from limbcli.effects import Effect, effect
from limbcli.effects.base import Parameter, Theta
from limbcli.effects.reading import Curves, log_force_at
from limbcli.effects.tissue import core, thickness, with_core
from limbcli.errors import CaseError, LimbError, SolveError
from limbcli.measurement.indentation import Levels
from limbcli.model import Array, LimbModel
from limbcli.model_io import load_model
from limbcli.progress import Progress
from limbcli.results import read_result
from limbcli.stages.diagnosis_curves import FIRST_M, CurveBook
from limbcli.stages.diagnosis_noise import ModelError
from limbcli.units import mpa_from_kpa

F_KAPPA = 100.0
MATTERS = 0.3  # deviations: what an intervention may move before the model must be mended
USUAL_C = 0.006  # MPa; force and modulus are proportional to it, so that any would do
# Quadratic elements err by the square of their edge: of the difference between two meshes, the finer keeps
# h^2 / (H^2 - h^2); taken half as much again, since neither is far in the asymptotic range.
_SAFETY = 1.5
_LEAST_ERROR, _USUAL_ERROR, _USUAL_EDGE = 0.01, 0.03, 2.5
_ALIKE = 0.8  # correlation of the mesh's error between neighbouring levels
# Half a voxel's edge of first touch: a probe 53 mm long that stands 1 degree otherwise touches 0.5 mm sooner.
_VOXEL_SHARE, _IMAGE_GAIN = 0.5, 0.05
_SURFACE_GEOMETRY = (0.15, 0.02)  # mm, fraction: surfaces that were given are taken for better
_USUAL_THICKNESS = 25.0  # mm, where the beam meets no bone
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
    """A numerical effect tried: ln of the force's change at the levels, and its largest in deviations."""

    name: str
    log_force: Array
    log_speed: Array
    deviations: float
    note: str = ""
    facts: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Tie:
    """From the working mesh to the site's own: ln ratio of force (n,), speeds (n, n_parts), thickness.

    mesh_error : one deviation of ln force at the levels (n_levels,) that the mesh still leaves
    """

    log_force: Array
    log_speed: Array
    thickness_ratio: float
    mesh_error: Array


class Tells(Protocol):
    """Where findings and warnings are noted."""

    data: dict[str, Any]
    warnings: list[str]


class Numerics:
    """The numerical checks of one site on one book of curves."""

    def __init__(
        self, case: Case, site: Site, levels: Levels, book: CurveBook, *, out: Path, size: float,
        notes: Tells, progress: Progress,
    ):  # fmt: skip
        self.case, self.site, self.levels, self.book = case, site, levels, book
        self.out, self.size, self.notes, self.progress = out, size, notes, progress

    # ------------------------------------------------------------ the tie to the site's own mesh

    def tie(self) -> Tie:
        """To the finished `run` (f_kappa 100, m 2) of the site's own mesh; without it, a usual error."""
        working = self.book.curves(2.0)
        n, n_levels = len(working.depth), len(self.levels)
        try:
            element, depth, force = self._start_run()
        except LimbError as error:
            self.notes.warnings.append(f"the working mesh is not tied to the site's own: {error.what}")
        else:
            if element == "tet10":
                return self._tied(working, depth, force)
            self.notes.warnings.append(
                f"the site's own run has {element} elements and is not used to tie the working mesh to it"
            )
        usual = _USUAL_ERROR * (self.size / _USUAL_EDGE) ** 2
        return Tie(np.zeros(n), np.zeros_like(working.log_speed), 1.0, np.full(n_levels, usual))

    def _tied(self, working: Curves, depth: Array, force: Array) -> Tie:
        ratio = np.log(np.maximum(force, 1e-9)) - log_force_at(working, depth)
        at = np.maximum(working.depth, depth[0])
        log_force = np.interp(at, depth, ratio)
        log_force[0] = 0.0
        own = read_result(self.out, "mesh", site=self.site.name)
        h = float(own.data.get("size_under_probe_mm", _USUAL_EDGE))
        left = _SAFETY * h**2 / max(self.size**2 - h**2, h**2)
        error = np.maximum(left * np.abs(np.interp(self.levels.depth, depth, ratio)), _LEAST_ERROR)
        theirs, ours = thickness(load_model(own.folder / "model.npz")), working.thickness
        tall = theirs / ours if np.isfinite(theirs) and np.isfinite(ours) and ours > 0 else 1.0
        self.notes.data["working_mesh_force_ratio"] = np.exp(ratio)
        return Tie(log_force, np.zeros_like(working.log_speed), tall, error)

    def _start_run(self) -> tuple[str, Array, Array]:
        """Element, depths and forces of the site's own run at the start values, scaled to the reference c.

        Raises
        ------
        CaseError
            If there is none, or it was made with other start values.
        """
        ran = read_result(self.out, "run", site=self.site.name)
        built = read_result(self.out, "build-feb", site=self.site.name)
        if built.data.get("f_kappa") != F_KAPPA or built.data.get("m") != 2.0:
            raise CaseError(
                "the site's own run was made with other start values than f_kappa 100, m 2",
                where=str(ran.folder), fix="run `limbcli build-feb` and `limbcli run` without options",
            )  # fmt: skip
        table = np.loadtxt(ran.path("force_depth"), delimiter=",", skiprows=1, ndmin=2)
        depth, force = table[:, 1], table[:, 2]
        rising = np.flatnonzero((np.diff(depth, prepend=0.0) > 1e-6) & (force > 0))
        if len(rising) < 2:
            raise CaseError(
                "the site's own run has fewer than two depths with a force", where=str(ran.folder),
                fix="run `limbcli run` again",
            )  # fmt: skip
        scale = self.book.c / mpa_from_kpa(float(built.data["c_kpa"]))
        return str(built.data.get("element")), depth[rising], force[rising] * scale

    # ------------------------------------------------------------ interventions

    def interventions(self) -> list[Intervention]:
        """Each tried at the m that is nearest to the tissue's, as their effects grow with it."""
        found, m = [], self._likely_m()
        for numerical in (effect("crop"), effect("contact"), INCOMPRESSIBILITY):
            self.progress.event("note", text=f"numerical check: {numerical.name}")
            try:
                found.append(self._intervene(numerical, m))
            except LimbError as error:
                self.notes.data.setdefault("numerical_not_evaluated", {})[numerical.name] = error.what
        return found + self._locking()

    def _likely_m(self) -> float:
        """The m whose force, for any c, follows the measured one most closely, of those solved first."""
        force, depth = self.levels.force, self.levels.depth
        rising = (force > 0) & (depth > 0)
        if rising.sum() < 2:
            return FIRST_M[0]
        scatter = {}
        for m in FIRST_M:
            try:
                off = np.log(force[rising]) - log_force_at(self.book.curves(m), depth[rising])
            except SolveError:
                continue
            scatter[m] = float(np.cov(off, aweights=force[rising]))
        return min(scatter, key=lambda m: scatter[m])

    def _intervene(self, numerical: Effect, m: float) -> Intervention:
        plain_curves = self.book.curves(m)
        changed = self.book.curves(m, ((numerical, numerical.start),))
        return self._judged(numerical.name, plain_curves, changed, numerical.sentence)

    def _locking(self) -> list[Intervention]:
        """Where the site's own run is of linear elements: what it gives against the working tet10."""
        try:
            element, depth, force = self._start_run()
        except LimbError as error:
            if self.case.model.element == "tet4":
                self.notes.data.setdefault("numerical_not_evaluated", {})["locking"] = error.what
            return []
        if element != "tet4":
            return []
        working = self.book.curves(2.0)
        own = Curves(np.r_[0.0, depth], np.r_[0.0, force], np.zeros((len(depth) + 1, 0)), np.zeros(0))
        linear = replace(working, force=np.r_[0.0, np.exp(log_force_at(own, working.depth[1:]))])
        judged = self._judged("locking", linear, working, "tet4 against tet10")
        if judged.deviations > MATTERS:
            self.notes.warnings.append(
                f"linear elements lock here: the force changes by up to {judged.deviations:.1f} deviations "
                "with quadratic ones. That is numerical, not tissue; the diagnosis goes on with tet10."
            )
        return [judged]

    def _judged(self, name: str, before: Curves, after: Curves, note: str) -> Intervention:
        change = np.zeros(len(before.depth))
        change[1:] = np.log(np.maximum(after.force[1:], 1e-9) / np.maximum(before.force[1:], 1e-9))
        change[0] = change[1]
        at_levels = np.interp(self.levels.depth, before.depth, change)
        speed = np.nan_to_num(after.log_speed - before.log_speed)
        speeds = np.array([np.interp(self.levels.depth, before.depth, column) for column in speed.T]).T
        noise = self.site.noise
        slope = measured_slope(self.levels)
        deviation = np.hypot(noise.force, slope * noise.depth)
        size = float(np.max(np.abs(at_levels * self.levels.force) / deviation))
        return Intervention(name, at_levels, speeds, size, note)

    # ------------------------------------------------------------ as noise

    def noise(self, tie: Tie, interventions: list[Intervention]) -> list[ModelError]:
        """What of all this the data have to allow for."""
        # With the cut free the force is too low, fixed it is too high: half the difference is the doubt.
        # What a quarter of the penalty takes from the force is one and a half times to three times what the
        # gap still takes; counted whole, as it is of one sign, which a deviation does not know.
        share = {"crop": 0.5, "contact": 1.0, INCOMPRESSIBILITY.name: 1.0}
        errors = [
            ModelError(f"model: {each.name}", share[each.name] * each.log_force,
                       share[each.name] * each.log_speed)
            for each in interventions if each.name in share
        ]  # fmt: skip
        errors += self._geometry()
        speeds = np.zeros((len(self.levels), tie.log_speed.shape[1]))
        return [*errors, ModelError("model: mesh", tie.mesh_error, speeds, correlation=_ALIKE)]

    def _geometry(self) -> list[ModelError]:
        """What the surfaces' own error does: to the depth at first touch, to the thickness and with it to all
        strains, and to the force as a whole."""
        spacing = read_spacing(self.out)
        touch, gain = _SURFACE_GEOMETRY
        if spacing is not None:
            touch, gain = _VOXEL_SHARE * float(np.prod(spacing)) ** (1 / 3), _IMAGE_GAIN
        thick = self.book.curves(2.0).thickness
        strain = touch / thick if np.isfinite(thick) and thick > 0 else touch / _USUAL_THICKNESS
        n = len(self.levels)
        none = np.zeros((n, len(self.book.windows.depths)))
        return [
            ModelError("model: depth at first touch", np.zeros(n), none, depth=touch),
            ModelError("model: strain by the thickness", np.zeros(n), none, strain=strain),
            ModelError("model: gain of the force by the geometry", np.full(n, gain), none),
        ]


def read_spacing(out: Path) -> list[float] | None:
    """mm between the voxels that the surfaces were made of; None where surfaces were given."""
    try:
        image = read_result(out, "segment").data.get("image")
    except LimbError:
        return None
    found = image.get("spacing_mm") if isinstance(image, dict) else None
    return [float(each) for each in found] if found else None


def measured_slope(levels: Levels) -> Array:
    """N/mm along the measured curve, level by level (n,); 0 where depth does not grow."""
    apart = np.maximum.accumulate(levels.depth) + 1e-6 * np.arange(len(levels))
    slope = np.gradient(levels.force, apart)
    rising = np.diff(np.maximum.accumulate(levels.depth), prepend=-1.0) > 1e-3
    return np.asarray(np.where(rising, np.nan_to_num(slope, posinf=0.0, neginf=0.0), 0.0))
