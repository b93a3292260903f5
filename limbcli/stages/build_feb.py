"""build-feb: the local mesh and the measurement become a FEBio model.

c comes from the shear-wave speed at level 0; f_kappa and m are start values. The probe
is driven through every measured loading depth, so that the simulated curve has a point
at each.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.case import Case, Site
from limbcli.errors import MeasurementError
from limbcli.feb.settings import Schedule, apart, least_level, schedule
from limbcli.feb.write import write_feb
from limbcli.files import sha256
from limbcli.measurement.elastography import shear_modulus_from_wave_speed
from limbcli.measurement.indentation import Levels, read_levels
from limbcli.model import Array, LimbModel
from limbcli.model_io import load_model
from limbcli.progress import SILENT, Progress
from limbcli.results import StageResult, StageWriter, open_stage, read_result
from limbcli.solvers.base import MODEL_FILE
from limbcli.stages.indentation_model import (
    PROBE,
    TISSUE,
    indentation_model,
    starting_depth,
    tissue_nodes,
    touching_points,
)
from limbcli.units import kpa_from_mpa, mpa_from_kpa

STAGE = "build-feb"
__all__ = ["PROBE", "TISSUE", "TissueOptions", "build_feb", "indentation_model", "tissue_stiffness"]


@dataclass(frozen=True)
class TissueOptions:
    """Start values of the law. c_kpa: c = 2 mu by hand (None: from SWE at level 0)."""

    c_kpa: float | None = None
    f_kappa: float = 100.0
    m: float = 2.0


def build_feb(
    case: Case,
    *,
    out: Path,
    sites: list[str] | None = None,
    options: TissueOptions = TissueOptions(),
    templates: Path | None = None,
    progress: Progress = SILENT,
) -> list[StageResult]:
    """Write `model.feb` of each site.

    Raises
    ------
    CaseError
        If `mesh` has not been run, or a template is faulty.
    MeasurementError
        If the levels cannot be used, or c is neither measured nor given.
    """
    results = []
    for site in case.selected(sites):
        progress.event("stage", name=STAGE, site=site.name)
        with open_stage(out, STAGE, subject=case.subject, site=site.name) as writer:
            _build_site(site, out, writer, options, templates)
        assert writer.result is not None
        results.append(writer.result)
    return results


def _build_site(
    site: Site, out: Path, writer: StageWriter, options: TissueOptions, templates: Path | None
) -> None:
    meshed = read_result(out, "mesh", site=site.name)
    path = meshed.folder / "model.npz"
    levels = read_levels(site.levels)
    c, c_source = tissue_stiffness(levels, site, c_kpa=options.c_kpa)
    meshed_model, depths = load_model(path), simulated_depths(levels).tolist()
    plan = schedule(depths, start=starting_depth(meshed_model, depths[0]))
    model = indentation_model(meshed_model, plan, c=c, f_kappa=options.f_kappa, m=options.m)
    write_feb(model, writer.file("feb", MODEL_FILE), templates)
    writer.used("mesh", path)
    writer.used("levels", site.levels)
    if templates is not None:
        writer.used("templates", templates)
    writer.warnings.extend(meshed.warnings)
    writer.data.update(c_source=c_source, f_kappa=options.f_kappa, m=options.m)
    _report(writer, model, plan, levels, site)


def tissue_stiffness(levels: Levels, site: Site, *, c_kpa: float | None = None) -> tuple[float, str]:
    """c (MPa) = 2 mu = 2 rho v^2 of the mean shear-wave speed at level 0, and where it comes from.

    Raises
    ------
    MeasurementError
        If level 0 has no speed and no c is given, or the given c is not positive.
    """
    if c_kpa is not None:
        if not c_kpa > 0:
            raise MeasurementError(
                f"c is {c_kpa:g} kPa, not positive", where="--c-kpa", fix="give c = 2 mu in kPa, e.g. 8"
            )
        return mpa_from_kpa(c_kpa), "given with --c-kpa"
    speed = float(levels.swe_mean_m_per_s[0])
    if not np.isfinite(speed):
        raise MeasurementError(
            "level 0 has no shear-wave speed, so c is unknown",
            where=str(levels.path),
            fix="fill swe_mean_m_per_s in the first row, or give the stiffness: --c-kpa VALUE",
        )
    modulus = shear_modulus_from_wave_speed(np.array([speed]), density_kg_per_m3=site.density_kg_per_m3)
    return 2 * float(modulus[0]), f"2 mu from SWE at level 0 ({speed:.3f} m/s)"


def simulated_depths(levels: Levels) -> Array:
    """The loading depths, sorted, each once (mm); a depth at first touch needs no simulation.

    Depths closer together than 0.02 mm count as one.

    Raises
    ------
    MeasurementError
        If no loading level is deeper than the start of the simulation.
    """
    depths = np.unique(levels.depth[levels.loading])
    depths = depths[depths > least_level()]
    if len(depths) == 0:
        raise MeasurementError(
            f"no loading level is deeper than {least_level():g} mm",
            where=str(levels.path),
            fix="check the column depth_mm: it grows from 0 with the load, in mm",
        )
    return np.array(apart(depths.tolist()))


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
        n_nodes=len(tissue_nodes(model)),
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
    if not np.array_equal(np.sort(levels.depth[levels.loading]), levels.depth[levels.loading]):
        writer.warnings.append(
            "the loading depths do not grow with the levels; they are simulated in sorted order"
        )
