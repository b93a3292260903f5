"""build-feb: the local mesh and the measurement become a FEBio model.

c comes from the shear-wave speed at level 0; f_kappa and m are start values. The probe
is driven through every measured loading depth, so that the simulated curve has a point
at each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from limbcli.case import Case, Site
from limbcli.errors import CaseError, MeasurementError
from limbcli.feb.settings import Schedule, apart, least_level, robust_contact, robust_step, schedule
from limbcli.feb.write import write_feb
from limbcli.files import sha256
from limbcli.materials.ogden import ogden_type
from limbcli.measurement.elastography import shear_modulus_from_wave_speed
from limbcli.measurement.indentation import Levels, read_levels
from limbcli.model import Array, Drive, IntArray, LimbModel, LogRecord
from limbcli.model_io import load_model
from limbcli.progress import SILENT, Progress
from limbcli.results import StageResult, StageWriter, open_stage, read_result
from limbcli.solvers.base import MODEL_FILE
from limbcli.units import kpa_from_mpa, mpa_from_kpa

STAGE = "build-feb"
PROBE, TISSUE, TRAVEL = "probe", "tissue", "probe_travel"
RIGID_FIELDS = ("x", "y", "z", "thx", "thy", "thz", "Fx", "Fy", "Fz", "Mx", "My", "Mz")
NODE_FIELDS = ("ux", "uy", "uz")
ELEMENT_FIELDS = (
    "J", "sx", "sy", "sz", "sxy", "syz", "sxz",
    "Fxx", "Fxy", "Fxz", "Fyx", "Fyy", "Fyz", "Fzx", "Fzy", "Fzz",
)  # fmt: skip

# Elements whose stretch the shear-wave prediction may look at: the scanner's window (12 mm to
# either side, 25 mm deep, a slice 3 mm thick each way) with room for its smoothing and for
# tissue that moves into it.
_SWE_HALF_WIDTH, _SWE_HALF_THICKNESS, _SWE_DEPTH = 20.0, 12.0, 32.0


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
    plan = schedule(simulated_depths(levels).tolist())
    model = indentation_model(load_model(path), plan, c=c, f_kappa=options.f_kappa, m=options.m)
    write_feb(model, writer.file("feb", MODEL_FILE), templates)
    writer.used("mesh", path)
    writer.used("levels", site.levels)
    if templates is not None:
        writer.used("templates", templates)
    writer.warnings.extend(meshed.warnings)
    _report(writer, model, plan, levels, site, c_source)


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


def indentation_model(model: LimbModel, plan: Schedule, *, c: float, f_kappa: float, m: float) -> LimbModel:
    """The mesh's model with tissue, load through the plan's depths, settings and records.

    Raises
    ------
    CaseError
        If the model has no body `probe`, no contact, or no material `tissue`.
    """
    if (
        TISSUE not in model.materials
        or PROBE not in {body.name for body in model.bodies}
        or not model.contacts
    ):
        raise CaseError(
            f"the meshed model lacks {TISSUE!r}, {PROBE!r} or their contact",
            where="model.npz",
            fix="mesh again",
        )
    model = start_at(model, plan.start).with_material(TISSUE, ogden_type(c=c, f_kappa=f_kappa, m=m))
    others = tuple(each for each in model.drives if (each.body, each.dof) != (PROBE, "z"))
    element = next(each.kind for each in model.mesh.solid_blocks)
    return replace(
        model,
        contacts=tuple(robust_contact(each) for each in model.contacts),
        drives=(*others, Drive(PROBE, "z", "displacement", -1.0, TRAVEL)),
        curves={TRAVEL: plan.curve()},
        steps=(robust_step(plan, element),),
        records=(
            LogRecord("rigid_body", RIGID_FIELDS, "rigid_body.csv", PROBE),
            LogRecord("node", NODE_FIELDS, "nodes.csv", tissue_nodes(model)),
            LogRecord("element", ELEMENT_FIELDS, "elements.csv", window_cells(model, plan.depths[-1])),
        ),
    )


def start_at(model: LimbModel, depth: float) -> LimbModel:
    """The model with its probe moved along z so that the face starts `depth` mm inside."""
    body = next(each for each in model.bodies if each.name == PROBE)
    x, y, z = body.center_of_mass
    points = model.mesh.points.copy()
    nodes = np.unique(np.concatenate([model.mesh.block(name).cells.ravel() for name in body.blocks]))
    points[nodes, 2] += -depth - z
    moved = replace(body, center_of_mass=(x, y, -depth))
    bodies = tuple(moved if each.name == PROBE else each for each in model.bodies)
    return replace(model, mesh=replace(model.mesh, points=points), bodies=bodies)


def tissue_nodes(model: LimbModel) -> IntArray:
    """Numbers of all nodes of solid cells, sorted."""
    return np.unique(np.concatenate([block.cells.ravel() for block in model.mesh.solid_blocks]))


def window_cells(model: LimbModel, deepest: float) -> IntArray:
    """Solid cells (numbered over all blocks) that may come into the shear-wave window; all if none does."""
    found, every, first = [], [], 0
    for block in model.mesh.blocks:
        if block.is_solid:
            x, y, z = np.abs(model.mesh.points[block.cells].mean(axis=1)).T
            near = (x <= _SWE_HALF_WIDTH) & (y <= _SWE_HALF_THICKNESS) & (z <= _SWE_DEPTH + deepest)
            found.append(first + np.flatnonzero(near))
            every.append(first + np.arange(len(block.cells)))
        first += len(block.cells)
    near_cells = np.concatenate(found)
    return near_cells if len(near_cells) else np.concatenate(every)


def _report(
    writer: StageWriter, model: LimbModel, plan: Schedule, levels: Levels, site: Site, c_source: str
) -> None:
    law = model.materials[TISSUE].parameters
    c, kappa = float(law["c1"]) + float(law["c2"]), float(law["kappa"])  # type: ignore[arg-type]
    block = model.mesh.solid_blocks[0]
    n_cells = sum(len(each.cells) for each in model.mesh.solid_blocks)
    writer.data.update(
        c_kpa=kpa_from_mpa(c),
        c_source=c_source,
        f_kappa=kappa / c,
        kappa_kpa=kpa_from_mpa(kappa),
        m=law["m1"],
        density_kg_per_m3=site.density_kg_per_m3,
        element=block.kind,
        n_nodes=len(tissue_nodes(model)),
        n_elements=n_cells,
        start_depth_mm=plan.start,
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
        f"start values: c {kpa_from_mpa(c):.3f} kPa ({c_source}), f_kappa {kappa / c:g}, m {law['m1']:g}"
    )
    if not np.array_equal(np.sort(levels.depth[levels.loading]), levels.depth[levels.loading]):
        writer.warnings.append(
            "the loading depths do not grow with the levels; they are simulated in sorted order"
        )
