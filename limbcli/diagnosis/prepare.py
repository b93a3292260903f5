"""Preparation of a site for the diagnosis: working mesh, curves, numerical checks, data.

Every simulation is cached in `<out>/diagnose/.work-<site>`, so that an interrupted diagnosis can be
resumed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from limbcli.case import Case, Site
from limbcli.case.noting import with_values
from limbcli.diagnosis.curves.curve_plan import FIRST_M, Reach, nearest_m, where_solved
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.diagnosis.data.held_forces import held_forces
from limbcli.diagnosis.data.rows import ExtraMeasurement, SiteReadings, deepest, readings
from limbcli.diagnosis.data.site_data import SiteData, site_data
from limbcli.diagnosis.data.windows import Windows
from limbcli.diagnosis.drainage import NAME as POROELASTICITY
from limbcli.diagnosis.drainage import DrainageSolver, drained
from limbcli.diagnosis.forward_model.surrogate import SiteCurves
from limbcli.diagnosis.mesh_error.mesh_correction import F_KAPPA, MeshCorrection, mesh_correction, own_layers
from limbcli.diagnosis.mesh_error.numerical_checks import USUAL_C, Intervention, Notes, NumericalChecks
from limbcli.effects.effect import Effect
from limbcli.errors import CaseError, LimbError, MeasurementError
from limbcli.files.atomic import sha256
from limbcli.measurement.indentation import read_trace
from limbcli.measurement.shear_modulus import shear_modulus_from_wave_speed
from limbcli.meshing.frame import LARGEST_SLOPE_DEG
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_model import MeshOptions, site_model
from limbcli.model import LimbModel
from limbcli.model.npz_file import load_model, save_model
from limbcli.model.patient_frame import patient_from_model
from limbcli.progress import Progress
from limbcli.results import data_if_there, plain, read_result
from limbcli.site_model.element_fibres import with_fibres
from limbcli.site_model.layer_readings import LayerReadings, layer_readings
from limbcli.site_model.mesh_checks import check_within_tissue, measured_skin_bone
from limbcli.site_model.segmented_limb import read_limb, site_position
from limbcli.site_model.site_levels import levels_of, maps_of
from limbcli.site_model.site_states import one_state
from limbcli.solvers.material_lines import material_lines
from limbcli.version import __version__

STAGE = "diagnose"
_N_DEPTHS = 6  # number of equal depth steps down to the depth needed
# Depth needed as a multiple of the deepest reading. One further depth, as depths may be read too small: mm
# beyond it, at most this fraction of the tissue thickness.
_BEYOND, _FURTHER, _FURTHER_SHARE = 1.05, 2.5, 0.075
_ROUND = 0.5  # mm, to which the depth needed is rounded up
_TIMES_FORCE = 4.0  # simulated force over the largest reading: tissue may be softer than the speed implies
# mm, smallest edge lengths at curved surfaces (bone is approximated coarsely), and at thin bones and clefts;
# shorter where such facets lose a bone near the face
_BENDS, _THIN = 8.0, 6.0
# mm per mm, mm: as short edges as in the site's own mesh, to which this one is corrected, cost more nodes
_GROWTH, _REACH = 0.35, 2.0
# work of a solve with the probe turned, which serves a proposal alone: in mean solves of the site without
# effects; smallest mean assumed
_TURNED_TIMES, _LEAST_MEAN = 3.0, 500.0
_LAYERS, _FINEST, _COARSEST = 3.0, 2.5, 5.0  # elements between skin and bone; mm, limits of their edge length


@dataclass(frozen=True)
class WorkingMesh:
    """Options of the working mesh.

    size, far_size : mm, edges under the probe and far from it (size None: from `size_for`)
    interventions : whether numerical effects such as crop and contact are simulated
    """

    size: float | None = None
    far_size: float = 14.0
    interventions: bool = True


def prepare(
    case: Case, site: Site, effects: Mapping[str, Effect], *, out: Path, mesh: WorkingMesh,
    extras: Sequence[ExtraMeasurement] = (), draining: DrainageSolver | None = None, progress: Progress,
) -> Prepared:  # fmt: skip
    """Mesh the site, solve without effects, run the numerical checks, and stack the data.

    draining : solver for draining tissue; None: poroelasticity is not simulated

    Raises CaseError if `segment` has not been run; MeasurementError if the levels cannot be used; SolveError
    if the model without effects cannot be solved.
    """
    making = Preparation(case, site, out, mesh, progress)
    simulations, refused = making.simulated(), dict[str, LimbError]()
    interventions: Sequence[Intervention] = ()
    try:
        where_solved(simulations.curves, FIRST_M)  # failures are reported where the curves are used
        numerics = NumericalChecks(
            case=case, site=site, levels=making.levels, simulations=simulations, out=out, size=making.size,
            notes=making.notes, progress=progress,
        )  # fmt: skip
        correction = mesh_correction(numerics, solves=mesh.interventions)
        if mesh.interventions:
            interventions = numerics.interventions()
        data = making.data(numerics, correction, interventions, extras)
        if POROELASTICITY in effects and draining is not None:
            try:
                drains = drained(
                    draining, data.seen.held, simulations, deepest=simulations.needed, keep=making.work,
                    notes=making.notes, progress=progress,
                )  # fmt: skip
                effects = {**effects, POROELASTICITY: drains}
            except LimbError as error:
                refused[POROELASTICITY] = error
    except LimbError:
        simulations.close()
        raise
    curves = SiteCurves(
        data, simulations, effects, correction=correction,
        penetration=numerics.penetration if mesh.interventions else None, refused=refused, progress=progress,
    )  # fmt: skip
    return Prepared(
        site=site, size=making.size, notes=making.notes, simulations=simulations, curves=curves,
        interventions=interventions,
    )  # fmt: skip


def turned_by_90(
    case: Case, prepared: Prepared, *, out: Path, mesh: WorkingMesh, progress: Progress
) -> SiteCurves:
    """Curves of the same measurement with the probe's long side turned by 90 degrees; raises MeshError or
    SolveError if the place cannot be meshed or simulated so, or only with several times the usual work."""
    site, known = prepared.site, prepared.curves
    other = with_values(site, name=f"{site.name}-turned", long_axis=_across(site, prepared.simulations.model))
    progress.event("note", text=f"{site.name} with the probe turned by 90 degrees")
    simulations = Preparation(case, other, out, replace(mesh, size=prepared.size), progress).simulated()
    simulations.work.at_most = _TURNED_TIMES * max(prepared.simulations.work.mean, _LEAST_MEAN)
    curves = SiteCurves(
        known.site, simulations, known.effects, penetration=known.penetration, refused=known.refused,
        progress=progress,
    )  # fmt: skip
    nearest = sorted(known.nodes, key=lambda m: abs(np.log(m / known.changes.m)))
    try:
        curves.solve_nodes(nearest[:2])
        curves.changes.m = nearest_m(curves.nodes, known.changes.m)
    finally:
        simulations.close()
    return curves


def size_for(skin_bone: float | None) -> float:
    """Edge length under the probe (mm): a third of the distance to the bone, limited to 2.5 to 5.

    >>> size_for(None), size_for(34.0), size_for(9.0), size_for(4.0)
    (5.0, 5.0, 3.0, 2.5)
    """
    return _COARSEST if skin_bone is None else float(np.clip(skin_bone / _LAYERS, _FINEST, _COARSEST))


def _across(site: Site, model: LimbModel) -> str | tuple[float, float, float]:
    """Direction across the probe's long axis: along the limb if the probe was across it, and vice versa."""
    if isinstance(site.long_axis, str):
        return "axial" if site.long_axis == "transverse" else "transverse"
    x, y, z = patient_from_model(model)[:3, 1].tolist()
    return x, y, z


@dataclass(frozen=True, eq=False, kw_only=True)
class Prepared:
    """One site: its data and curves, the numerical checks on its mesh, and notes to report.

    size : mm, of the working mesh's edges under the probe
    """

    site: Site
    size: float
    notes: Notes
    simulations: SiteSimulations
    curves: SiteCurves
    interventions: Sequence[Intervention]


class Preparation:
    """Makes a site's working mesh, simulations and data."""

    def __init__(self, case: Case, site: Site, out: Path, mesh: WorkingMesh, progress: Progress):
        self.case, self.site, self.out, self.mesh, self.progress = case, site, out, mesh, progress
        self.work = out / STAGE / f".work-{site.name}"
        self.levels = levels_of(site)
        self.maps = maps_of(site, self.levels)
        self.windows = Windows.usual(case.probe.length) if self.maps is None else Windows.of_maps(self.maps)
        checks = data_if_there(self.out, "mesh", site=self.site.name).get("checks", {})
        seen = checks.get("skin_bone_mm")
        self.skin_bone = float(seen) if seen is not None else measured_skin_bone(self.site)
        check_within_tissue(float(np.max(self.levels.depth)), self.skin_bone, site)
        self.size = size_for(self.skin_bone) if mesh.size is None else mesh.size
        self.layers: LayerReadings | None = None  # in the working mesh, once it is made
        self.notes = Notes()
        if site.states:
            self.notes.warnings.append(one_state(site))

    def simulated(self) -> SiteSimulations:
        """Simulations down to the deepest reading and beyond, of a reference stiffness and at rounded depths,
        so that other measurements of the same place can reuse them."""
        needed = _ROUND * float(np.floor(_BEYOND * deepest(readings(self.levels)) / _ROUND) + 1.0)
        depths = needed / _N_DEPTHS * np.r_[0.5, np.arange(1, _N_DEPTHS + 1)]
        thick = self.skin_bone
        further = _FURTHER if thick is None else min(_FURTHER, _FURTHER_SHARE * thick)
        meshed, fibres = with_fibres(self.case, self.site, self._working_mesh())
        self.notes.data["fibres"] = fibres.source
        self.layers = self._layers_in(meshed)
        return SiteSimulations(
            meshed, [*depths.tolist(), needed + further], c=USUAL_C, f_kappa=F_KAPPA,
            windows=self.windows, keep=self.work, density_kg_per_m3=self.site.density_kg_per_m3,
            progress=self.progress, layers=self.layers,
            reach=Reach(needed=needed, enough_force=self._enough_force()),
        )  # fmt: skip

    def _enough_force(self) -> float | None:
        """N at the reference stiffness, more than any reading; a power of two, so that curves can be reused.
        None without a wave speed at rest, which tells the tissue's stiffness."""
        largest, speed = float(np.nanmax(self.levels.force)), self.levels.swe_mean_m_per_s[:1]
        if not (self.levels.begins_at_zero and np.isfinite(speed).all() and largest > 0):
            return None
        modulus = shear_modulus_from_wave_speed(speed, density_kg_per_m3=self.site.density_kg_per_m3)
        at_usual = _TIMES_FORCE * largest * USUAL_C / (2.0 * float(modulus[0]))
        return float(2.0 ** np.ceil(np.log2(at_usual)))

    def _layers_in(self, meshed: LimbModel) -> LayerReadings | None:
        """The layers whose borders lie in the working mesh; others are excluded with a warning."""
        layers = layer_readings(self.levels, self.site)
        if layers is None or not layers.n_counted:
            return None
        try:
            material_lines(meshed, layers.rest[: layers.n_counted])
        except MeasurementError as error:
            self.notes.warnings.append(f"the layers are not used: {error.what}")
            return None
        return layers

    def _working_mesh(self) -> LimbModel:
        """A coarse mesh of the site; without surfaces (no `segment`), the site's own mesh."""
        own = self.out / "mesh" / self.site.name / "model.npz"
        if not (self.out / "segment" / "segment.json").is_file() and own.is_file():
            if layers := own_layers(self.site, self.out):
                raise CaseError(
                    f"the site's own mesh has {layers} as well as the tissue, and there are no "
                    "surfaces to make the diagnosis' mesh from",
                    where=f"site {self.site.name}",
                    fix=f"limbcli segment {self.case.folder}, or mesh the site without layers",
                )
            self.work.mkdir(parents=True, exist_ok=True)
            self.notes.warnings.append("there are no surfaces: the site's own mesh is the working mesh")
            return load_model(own)
        segmented = read_result(self.out, "segment")
        surfaces = [sha256(path) for path in sorted(segmented.folder.glob("*.ply"))]
        place = site_position(self.site, segmented)
        sizes = Sizes(self.size, self.mesh.far_size, _GROWTH, _REACH, bends=_BENDS, thin=_THIN)
        recipe = [surfaces, place, self.site.long_axis, vars(self.case.probe), self.case.model.margin,
                  vars(sizes), LARGEST_SLOPE_DEG, __version__]  # fmt: skip
        key = hashlib.sha256(json.dumps(plain(recipe)).encode()).hexdigest()[:16]
        kept = self.work / f"model-{key}.npz"
        self.work.mkdir(parents=True, exist_ok=True)
        if not kept.is_file():
            self.progress.event("note", text="making the working mesh")
            probe = ProbeShape(self.case.probe.length, self.case.probe.width, self.case.probe.edge_radius)
            meshing = MeshOptions(element="tet10", margin=self.case.model.margin, sizes=sizes)
            limb = read_limb(segmented)
            made = site_model(limb, place, self.site.long_axis, probe, meshing, name=self.site.name)
            save_model(made.model, kept)
        return load_model(kept)  # reloaded, so that a resumed diagnosis uses an identical model

    def data(
        self, numerics: NumericalChecks, correction: MeshCorrection, interventions: Sequence[Intervention],
        extras: Sequence[ExtraMeasurement],
    ) -> SiteData:  # fmt: skip
        """The data, with what is known of how far the models are off."""
        held = None
        if self.site.trace is not None:
            try:
                held, why = held_forces(read_trace(self.site.trace), self.levels)
            except MeasurementError as error:
                why = error.what
            if held is None:
                self.notes.data["holds_not_used"] = why
        levels = self.levels
        if np.isfinite(levels.skin_bone).any() and not numerics.has_bone:
            self.notes.warnings.append(
                "skin_bone_mm is not used: in the model the beam reaches no bone under the probe's centre"
            )
            levels = replace(levels, skin_bone=np.full(len(levels), np.nan))
        seen = SiteReadings(
            levels, self.site.noise, windows=self.windows, maps=self.maps, held=held, extras=extras,
            usable=numerics.parts_seen(), layers=self.layers,
        )  # fmt: skip
        return site_data(self.site.name, seen, numerics.known_errors(correction, interventions))
