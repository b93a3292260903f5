"""build-feb: build a FEBio model from the local mesh and the measurement.

c is computed from the shear-wave speed at level 0; f_kappa and m are initial guesses. The probe
is driven through every measured loading depth, so that the simulated curve has a point
at each.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case, Site
from limbcli.case.noting import unnoted
from limbcli.errors import MeasurementError
from limbcli.feb.settings import Schedule, schedule
from limbcli.feb.write import write_feb
from limbcli.files.atomic import sha256
from limbcli.measurement.indentation import Levels
from limbcli.measurement.regression import speed_line
from limbcli.measurement.shear_modulus import shear_modulus_from_wave_speed
from limbcli.model import LimbModel
from limbcli.model.abaqus_input import write_abaqus
from limbcli.model.npz_file import load_model
from limbcli.numbers.units import kpa_from_mpa, mpa_from_kpa
from limbcli.progress import SILENT, Progress
from limbcli.provenance.chain_inputs import note_templates, noted
from limbcli.provenance.requested_options import requested_by_options, requested_of
from limbcli.provenance.staleness import Chain
from limbcli.results import StageResult, StageWriter, open_stage
from limbcli.site_model.indentation_model import (
    C_KPA,
    TISSUE,
    facet_gap,
    indentation_model,
    starting_depth,
    touching_points,
    with_penalty,
)
from limbcli.site_model.mesh_checks import check_within_tissue, warnings_now
from limbcli.site_model.site_layers import LayerLaw, layer_laws, layers_in, locking_warning, with_layer_laws
from limbcli.site_model.site_levels import levels_of, simulated_depths
from limbcli.solvers.solver import MODEL_FILE

STAGE = "build-feb"
ABAQUS_FILE = "model.inp"
_WIDE_GAP = 0.25  # mm, gap at first touch that is reported: about one standard deviation of a depth reading
_LINE_NEEDS = 3  # least number of speeds to extrapolate c linearly to 0 N


@dataclass(frozen=True)
class TissueOptions:
    """Initial guesses of the law's parameters.

    c_kpa : c = 2 mu given by hand (None: from SWE at level 0)
    layers : a table (law, c_kpa, f_kappa, m, beta) for "skin" or "fat", which overrides the case's values
    contact_penalty : multiple of the skin's stiffness at rest; None: the value with which FEBio converges
    abaqus : also write model.inp, an Abaqus input file
    """

    c_kpa: float | None = None
    f_kappa: float = 100.0
    m: float = 2.0
    layers: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    contact_penalty: float | None = None
    abaqus: bool = False


def build_feb(
    case: Case, *, out: Path, sites: list[str] | None = None, options: TissueOptions = TissueOptions(),
    templates: Path | None = None, progress: Progress = SILENT,
) -> list[StageResult]:  # fmt: skip
    """Write `model.feb` of each site. Raises as `limbcli.build_feb`."""
    results = []
    for site in case.selected(sites):
        progress.event("stage", name=STAGE, site=site.name)
        with open_stage(out, STAGE, subject=case.subject, site=site.name) as writer:
            writer.data["asked"] = {**requested_by_options(options), **requested_of({"templates": templates})}
            _build_site(noted(case, writer), site.name, out, writer, options, templates)
        results.append(writer.result)
    return results


def _build_site(
    case: Case, name: str, out: Path, writer: StageWriter, options: TissueOptions, templates: Path | None
) -> None:
    site = case.site(name)
    meshed = Chain(case, out).result("mesh", site=name)
    path = meshed.folder / "model.npz"
    levels = levels_of(site)
    c, c_source = tissue_stiffness(levels, site, c_kpa=options.c_kpa)
    meshed_model, depths = load_model(path), simulated_depths(levels).tolist()
    modelled = meshed.data.get("checks", {}).get("skin_bone_mm")
    writer.warnings.extend(check_within_tissue(depths[-1], modelled, site))
    plan = schedule(depths, start=starting_depth(meshed_model, depths[0]))
    laws = layer_laws(site, layers_in(meshed_model), options.layers)
    layered = with_layer_laws(meshed_model, laws)
    model = indentation_model(layered, plan, c=c, f_kappa=options.f_kappa, m=options.m)
    if options.contact_penalty is not None:
        model = with_penalty(model, options.contact_penalty)
    write_feb(model, writer.file("feb", MODEL_FILE), templates)
    if options.abaqus:
        write_abaqus(model, writer.file("abaqus", ABAQUS_FILE))
        writer.summary.append(f"{ABAQUS_FILE}: the same model for Abaqus; its comments say what differs")
    writer.used("mesh", path)
    writer.used_result(meshed, files=["model"])
    note_templates(writer, templates)
    writer.warnings.extend(warnings_now(meshed, unnoted(site)))
    if options.c_kpa is None and (reason := no_level_0(levels, site)):
        writer.warnings.append(reason)
    writer.data.update(c_source=c_source, f_kappa=options.f_kappa, m=options.m)
    _report(writer, model, plan, levels, site)
    _report_layers(writer, laws)


def tissue_stiffness(levels: Levels, site: Site, *, c_kpa: float | None = None) -> tuple[float, str]:
    """c (MPa) = 2 mu = 2 rho v^2 of the mean shear-wave speed v at level 0, and its source in words.

    Without a level 0 the speed of the first row is used, and the source says so.

    Raises MeasurementError if level 0 has no speed and no c is given, or the given c is out of range.
    """
    if c_kpa is not None:
        low, high = C_KPA
        if not low <= c_kpa <= high:
            raise MeasurementError(
                f"c is {c_kpa:g} kPa; possible values are {low:g} to {high:g}",
                where="--c-kpa",
                fix="give c = 2 mu in kPa, e.g. 8; soft tissue has 2 to 50",
            )
        return mpa_from_kpa(c_kpa), "given with --c-kpa"
    speed = float(levels.swe_mean_m_per_s[0])
    if not np.isfinite(speed):
        raise MeasurementError(
            "level 0 has no shear-wave speed, so c is unknown",
            where=str(levels.path),
            fix="fill swe_mean_m_per_s in the first row, or give the stiffness by hand, to both: "
            "`limbcli build-feb CASE --c-kpa VALUE`, `limbcli fit CASE --c-kpa VALUE`; `batch` keeps it",
        )
    modulus = shear_modulus_from_wave_speed(np.array([speed]), density_kg_per_m3=site.density_kg_per_m3)
    level = "level 0" if levels.begins_at_zero else f"{_first_level(levels)}, as there is no level 0"
    return 2 * float(modulus[0]), f"2 mu from SWE at {level} ({speed:.3f} m/s)"


def _first_level(levels: Levels) -> str:
    return f"the first row's {levels.force[0]:g} N and {levels.depth[0]:g} mm"


def no_level_0(levels: Levels, site: Site) -> str | None:
    """Warn if c is that of loaded tissue; the warning gives c extrapolated linearly to 0 N where possible."""
    if levels.begins_at_zero:
        return None
    why = f"there is no level 0: c is that of SWE at {_first_level(levels)}, of tissue that is already loaded"
    rows = levels.loading
    try:
        line = speed_line(levels.force[rows], levels.swe_mean_m_per_s[rows], against="force")
    except MeasurementError:
        return why + "; measure one, or give c with --c-kpa"
    if line.n < _LINE_NEEDS or line.intercept <= 0:
        return why + "; measure one, or give c with --c-kpa"
    modulus = shear_modulus_from_wave_speed(
        np.array([line.intercept]), density_kg_per_m3=site.density_kg_per_m3
    )
    c_kpa = kpa_from_mpa(2 * float(modulus[0]))
    return why + f"; the line through {line.n} speeds gives {c_kpa:.3g} kPa at 0 N (--c-kpa {c_kpa:.3g})"


def _report_layers(writer: StageWriter, laws: Mapping[str, LayerLaw]) -> None:
    """Report the layers' laws, which of their parameters are assumed, and possible locking of the element."""
    writer.data["layers"] = {name: law.to_json() for name, law in laws.items()}
    for name, law in laws.items():
        given = {key: value for key, value in law.to_json().items() if key not in ("law", "assumed")}
        values = ", ".join(f"{key} {value:g}" for key, value in given.items())
        assumed = f" ({', '.join(law.assumed)} assumed)" if law.assumed else ""
        writer.summary.append(f"layer {name}: {law.law}, {values}{assumed}; held fixed in a fit")
        if "c_kpa" in law.assumed:
            writer.warnings.append(
                f"the stiffness of the {name} is assumed (c = {given['c_kpa']:g} kPa); a fit attributes "
                f"its error to the tissue. State it: --layer {name}:c_kpa=VALUE, or [site.layers.{name}]"
            )
    writer.warnings.extend(locking_warning(laws, str(writer.data["element"])))


def _report(writer: StageWriter, model: LimbModel, plan: Schedule, levels: Levels, site: Site) -> None:
    law = model.materials[TISSUE].parameters
    c, kappa = float(law["c1"]) + float(law["c2"]), float(law["kappa"])  # type: ignore[arg-type]
    block = model.mesh.solid_blocks[0]
    n_cells = sum(len(each.cells) for each in model.mesh.solid_blocks)
    writer.data.update(
        c_kpa=kpa_from_mpa(c),
        kappa_kpa=kpa_from_mpa(kappa),
        density_kg_per_m3=site.density_kg_per_m3,
        element=block.kind,
        contact_penalty=model.contacts[0].penalty,
        n_nodes=len(model.mesh.solid_nodes),
        n_elements=n_cells,
        start_depth_mm=plan.start,
        contact_points_touching_at_start=touching_points(model),
        level_times_s=list(plan.times),
        level_depths_mm=list(plan.depths),
        model_sha256=sha256(writer.work / MODEL_FILE),
    )
    measured = int(levels.loading.sum())
    writer.summary.append(
        f"{n_cells} {block.kind}, {len(plan.depths)} depths to {plan.depths[-1]:.2f} mm"
        f" (from {measured} loading levels)"
    )
    writer.summary.append(
        f"start values: c {kpa_from_mpa(c):.3f} kPa ({writer.data['c_source']}), "
        f"f_kappa {writer.data['f_kappa']:g}, m {writer.data['m']:g}"
    )
    gap = facet_gap(model)
    if gap > _WIDE_GAP:
        writer.warnings.append(
            f"the skin's facets begin {gap:.2f} mm below first touch, too coarse for its curvature "
            "there: the force begins too late by that depth; use a finer mesh (--size-mm)"
        )
    if not np.array_equal(np.sort(levels.depth[levels.loading]), levels.depth[levels.loading]):
        writer.warnings.append(
            "the loading depths do not increase with the levels; they are simulated in sorted order"
        )
