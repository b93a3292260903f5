"""mesh --study: numerical error of a site's force due to the element size and the extent of the model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from limbcli.case import Site
from limbcli.errors import CaseError, MeasurementError
from limbcli.feb.settings import schedule
from limbcli.files.plain_text import write_rows
from limbcli.meshing.mending import Limb
from limbcli.meshing.mesh_extrapolation import extrapolate
from limbcli.meshing.mesh_picture import study_picture
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_model import MeshOptions, site_model
from limbcli.model import LimbModel
from limbcli.numbers.units import kpa_from_mpa, mpa_from_kpa
from limbcli.progress import SILENT, Progress
from limbcli.results import StageResult, StageWriter, open_stage, read_result, stage_folder
from limbcli.site_model.indentation_model import TissueLaw, indentation_model, starting_depth
from limbcli.site_model.segmented_limb import MeshInputs, site_position
from limbcli.site_model.site_layers import layer_laws, layers_in, with_layer_laws
from limbcli.site_model.site_levels import levels_of
from limbcli.solvers.session import ReferenceSession

STAGE = "mesh-study"
SIZE_FACTORS = (1.6, 1.25, 1.0, 0.8)
MARGIN_FACTORS = (0.5, 0.75, 1.0, 1.5)
_DEPTH = 8.0  # mm, depth of the study if there is no measurement
_N_LEVELS = 4


@dataclass(frozen=True)
class Variant:
    """One mesh of the study and its force (N) at full depth."""

    varied: str  # "size" or "margin"
    size: float
    margin: float
    n_cells: int
    force: float


def study_site(
    inputs: MeshInputs, site: Site, limb: Limb, options: MeshOptions, *, out: Path,
    progress: Progress = SILENT,
) -> StageResult:  # fmt: skip
    """Compute the force at the deepest level for finer and coarser meshes and for smaller and larger models.

    All use the same tissue: that of the site's fit if there is one (as locking of linear elements depends on
    it), else c = 8 kPa, f_kappa = 100, m = 2. Layers are those of `build-feb` without options. The result
    `numerical_error_fraction` is the root of the sum of squares of the discretisation error of the model's
    own mesh (by extrapolation, with a safety factor) and of the error of its extent (relative to the largest
    model).
    """
    case, position = inputs.case, site_position(site, inputs.segmented)
    probe = ProbeShape(case.probe.length, case.probe.width, case.probe.edge_radius)
    with open_stage(out, STAGE, subject=case.subject, site=site.name) as writer:
        inputs.note(writer, site)
        depth = full_depth(site)
        tissue = studied_tissue(site, out, writer)
        found: list[Variant] = []
        wanted = list(variants(options))
        for number, (varied, changed) in enumerate(wanted):
            progress.event("task", name=f"{STAGE} {site.name}", done=number, total=len(wanted))
            made = site_model(limb, position, site.long_axis, probe, changed, name=site.name)
            laws = layer_laws(site, layers_in(made.model))
            force = reference_force(with_layer_laws(made.model, laws), depth, tissue)
            found.append(
                Variant(varied, changed.sizes.under_probe, changed.margin, made.quality.n_cells, force)
            )
        progress.event("task", name=f"{STAGE} {site.name}", done=len(wanted), total=len(wanted))
        _report(writer, found, options, depth, tissue, title=f"{case.subject}, site {site.name}")
    return writer.result


def variants(options: MeshOptions) -> Iterator[tuple[str, MeshOptions]]:
    """Mesh options to study: the model itself first, then other sizes, then other margins."""
    yield "both", options
    for factor in SIZE_FACTORS:
        if factor != 1.0:
            sizes: Sizes = options.sizes.finer(factor)
            yield "size", replace(options, sizes=sizes)
    for factor in MARGIN_FACTORS:
        if factor != 1.0:
            yield "margin", replace(options, margin=options.margin * factor)


def full_depth(site: Site) -> float:
    """The deepest loading level (mm), or 8 mm if no table can be read."""
    try:
        levels = levels_of(site)
    except (MeasurementError, CaseError):
        return _DEPTH
    return float(levels.depth[levels.loading].max())


def studied_tissue(site: Site, out: Path, writer: StageWriter) -> TissueLaw:
    """The parameters of the site's fit, or default ones."""
    if not (stage_folder(out, "fit", site.name) / "fit.json").is_file():
        return TissueLaw()
    fitted = read_result(out, "fit", site=site.name)
    c, f_kappa, m = (float(fitted.data[key]) for key in ("c_kpa", "f_kappa", "m"))
    writer.used("fit", fitted.folder / "fit.json")
    return TissueLaw(mpa_from_kpa(c), f_kappa, m, "fit")


def reference_force(model: LimbModel, depth: float, tissue: TissueLaw = TissueLaw()) -> float:
    """Force (N) at `depth` (mm) by the reference solver."""
    depths = [depth * (k + 1) / _N_LEVELS for k in range(_N_LEVELS)]
    plan = schedule(depths, start=starting_depth(model, depths[0]))
    ready = indentation_model(model, plan, c=tissue.c, f_kappa=tissue.f_kappa, m=tissue.m)
    session = ReferenceSession(ready)
    try:
        return float(session.solve().must_points.forces[-1])
    finally:
        session.close()


def _report(
    writer: StageWriter, found: list[Variant], options: MeshOptions, depth: float, tissue: TissueLaw, *,
    title: str,
) -> None:  # fmt: skip
    own = found[0]
    by_size = [own, *(each for each in found if each.varied == "size")]
    by_margin = [own, *(each for each in found if each.varied == "margin")]
    limit = extrapolate([each.size for each in by_size], [each.force for each in by_size])
    farthest = max(by_margin, key=lambda each: each.margin)
    crop = abs(own.force - farthest.force) / abs(farthest.force)
    total = float((limit.error_fraction[0] ** 2 + crop**2) ** 0.5)
    rows = ((x.varied, f"{x.size:g}", f"{x.margin:g}", x.n_cells, f"{x.force:.6f}") for x in found)
    names = ("varied", "size_under_probe_mm", "margin_mm", "n_cells", "force_n")
    write_rows(writer.file("table", "study.csv"), names, rows)
    study_picture(
        writer.file("picture", "study.png"),
        sizes=[(each.size, each.force) for each in by_size],
        margins=[(each.margin, each.force) for each in by_margin],
        used=(own.size, own.margin),
        extrapolation=limit,
        depth=depth,
        title=title,
    )
    writer.data.update(
        depth_mm=depth, force_n=own.force, force_extrapolated_n=limit.limit, order=limit.order,
        order_is_assumed=limit.order_is_assumed, size_error_fraction=limit.error_fraction[0],
        crop_error_fraction=crop, numerical_error_fraction=total, element=options.element,
        size_under_probe_mm=own.size, margin_mm=own.margin, c_kpa=kpa_from_mpa(tissue.c),
        f_kappa=tissue.f_kappa, m=tissue.m, tissue_source=tissue.source,
    )  # fmt: skip
    writer.summary.append(
        f"force at {depth:.2f} mm: {own.force:.3f} N; numerical error {100 * total:.1f} % "
        f"(element size {100 * limit.error_fraction[0]:.1f} %, crop {100 * crop:.1f} %) with f_kappa "
        f"{tissue.f_kappa:.4g}, m {tissue.m:.4g} ({tissue.source})"
    )
    if limit.order_is_assumed:
        writer.warnings.append("the force does not converge monotonically; the error includes a factor of 3")
