"""mesh: build the local finite-element model of every site from the surfaces and the site's place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from limbcli.case import Case, Site
from limbcli.case.noting import unnoted
from limbcli.case.parts import point
from limbcli.errors import CaseError
from limbcli.errors.problems import raise_errors
from limbcli.meshing.conforming_layers import Layer
from limbcli.meshing.export import write_vtu
from limbcli.meshing.frame import LARGEST_SLOPE_DEG, skin_point_at
from limbcli.meshing.mending import Limb
from limbcli.meshing.mesh_picture import mesh_picture
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_mesher import MIN_ANGLE_DEG, MIN_ANGLE_UNDER_PROBE_DEG
from limbcli.meshing.site_model import MeshOptions, SiteModel, site_model
from limbcli.meshing.sites_on_skin import place_problems
from limbcli.model.npz_file import save_model
from limbcli.numbers.mesh_bounds import ELEMENTS, FAR_SIZE_MM, MARGIN_MM, SIZE_MM
from limbcli.progress import SILENT, Progress
from limbcli.provenance.chain_inputs import CaseInputs
from limbcli.provenance.requested_options import requested_by_options
from limbcli.provenance.staleness import Chain
from limbcli.results import StageResult, StageWriter, open_stage
from limbcli.site_model.element_fibres import with_fibres, write_fibres
from limbcli.site_model.mesh_checks import (
    across_warnings,
    geometry_warnings,
    layer_warnings,
    measured_skin_bone,
    moved_warnings,
)
from limbcli.site_model.segmented_limb import MeshInputs, read_limb, site_position
from limbcli.site_model.site_layers import (
    Layering,
    Thickness,
    ThicknessSource,
    layer_laws,
    layers_in,
    with_layer_laws,
)
from limbcli.stages.segmenting.possible_sites import warnings_of_limb


@dataclass(frozen=True, kw_only=True)
class MeshRequest:
    """What a mesh is to be where the case does not decide; None: as the case has it.

    element, margin : instead of the case's; size, far_size : edge lengths (mm) under the probe, far from it
    skin_layer, fat_layer : thickness (mm) of separate blocks that follow the skin, 0 for none, or
        "mri" for the thickness found by `segment`; None: according to the case's `[site.layers]`
    place : (angle in degrees, height in mm) around and along the limb, instead of one site's place
    """

    element: str | None = None
    size: float | None = None
    far_size: float | None = None
    margin: float | None = None
    skin_layer: Thickness | None = None
    fat_layer: Thickness | None = None
    place: tuple[float, float] | None = None


def mesh(
    case: Case, *, out: Path, sites: list[str] | None = None, options: MeshRequest = MeshRequest(),
    study: bool = False, progress: Progress = SILENT,
) -> list[StageResult]:  # fmt: skip
    """Mesh each site (all, or those named): model.npz, mesh.vtu, mesh.png.

    study : also run a refinement study of each site (its result follows the site's)

    Raises as `limbcli.mesh`.
    """
    chosen, place = case.selected(sites), options.place
    if place is not None and len(chosen) != 1:
        raise CaseError("a place was given for several sites", where="--at", fix="name one with --site")
    if place is not None and not np.isfinite(place).all():
        raise CaseError(f"--at is {place}", where="--at", fix="give an angle in degrees and a height in mm")
    mesh_options(case, options)
    thickness = Layering(options.skin_layer, options.fat_layer, seen=place is None)
    layered = tuple(site.name for site in chosen if thickness.is_from_images(site))
    segmented = Chain(case, out).result("segment", about=layered)
    progress.event("note", text="reading and repairing the surfaces")
    limb = read_limb(segmented)
    if place is not None:
        found = skin_point_at(limb, *place, where=f"site {chosen[0].name}")
        chosen = (replace(chosen[0], position=point(found), marker=None),)
    requested = requested_by_options(options)
    results = []
    for each in chosen:
        of_case = CaseInputs(case)
        inputs, site = MeshInputs(of_case, segmented, requested, each.name in layered), of_case.site(each)
        own = mesh_options(of_case.case, options)
        layers, sources = thickness.of(site, segmented, size=own.sizes.under_probe)
        own = replace(own, layers=layers)
        results.append(mesh_site(inputs, site, limb, own, sources, out, progress))
        if study:
            from limbcli.site_model.mesh_study import study_site  # with the solver, which no mesh needs

            results.append(study_site(inputs, site, limb, own, out=out, progress=progress))
    return results


def mesh_options(case: Case, request: MeshRequest) -> MeshOptions:
    """The case's mesh options, overridden by those of this run."""
    element, size, far_size = request.element, request.size, request.far_size
    if element not in (None, *ELEMENTS):
        raise CaseError(f"--element is {element!r}", where=case.subject, fix=f"give {' or '.join(ELEMENTS)}")
    usual = Sizes()
    sizes = Sizes(under_probe=size or usual.under_probe, far=far_size or max(usual.far, size or 0.0))
    margin = case.model.margin if request.margin is None else float(request.margin)
    for name, value, low, high in (
        ("--size-mm", sizes.under_probe, *SIZE_MM),
        ("--far-size-mm", sizes.far, sizes.under_probe, FAR_SIZE_MM[1]),
        ("--margin-mm", margin, *MARGIN_MM),
    ):
        if not low <= value <= high:
            raise CaseError(f"{name} is {value:g}", where=case.subject, fix=f"give {low:g} to {high:g} mm")
    return MeshOptions(element=element or case.model.element, margin=margin, sizes=sizes)


def mesh_site(
    inputs: MeshInputs, site: Site, limb: Limb, options: MeshOptions,
    layer_sources: Mapping[str, ThicknessSource], out: Path, progress: Progress,
) -> StageResult:  # fmt: skip
    """Mesh one site and write its folder below `out`.

    Raises CaseError if the site cannot be used, and MeshError as `mesh`.
    """
    case, segmented = inputs.case, inputs.segmented
    progress.event("stage", name="mesh", site=site.name)
    probe = ProbeShape(case.probe.length, case.probe.width, case.probe.edge_radius)
    position = site_position(site, segmented)
    if site.marker is None:
        raise_errors(
            place_problems(limb.skin, {site.name: np.array(position)}, where=str(case.file)), CaseError
        )
    with open_stage(out, "mesh", subject=case.subject, site=site.name) as writer:
        writer.data["asked"] = inputs.requested
        inputs.note(writer, site)
        for path in sorted(each for each in map(segmented.path, segmented.files) if each.suffix == ".ply"):
            writer.used(path.name, path)
        found = site_model(limb, position, site.long_axis, probe, options, name=site.name, progress=progress)
        laws = layer_laws(site, layers_in(found.model))
        model, fibres = with_fibres(case, site, with_layer_laws(found.model, laws))
        save_model(model, writer.file("model", "model.npz"))
        write_vtu(model.mesh, writer.file("mesh", "mesh.vtu"), fibres=model.fibres)
        mesh_picture(
            found.model.mesh,
            probe,
            found.quality,
            writer.file("picture", "mesh.png"),
            title=f"{case.subject}, site {site.name}: {options.element} model",
            start_depth=options.start_depth,
            sides=found.frame.sides,
        )
        _report(writer, found, options, limb, segmented, site)
        write_fibres(fibres, model, probe, site, writer)
        _report_layers(writer, options.layers, layer_sources, found)
    return writer.result


def _report_layers(
    writer: StageWriter, layers: tuple[Layer, ...], sources: Mapping[str, ThicknessSource], found: SiteModel
) -> None:
    """Report the requested layer thickness and that in the model: layers become thinner over bone."""
    figures, kept = found.quality, found.layers
    writer.data["layers"] = {f"{each.name}_mm": each.thickness for each in layers}
    writer.data["layer_sources"] = {name: str(each) for name, each in sources.items()}
    if kept is not None:
        made = {f"{each.name}_mm": kept.centre * each.thickness for each in layers}
        writer.data["layers_made"] = {"at_centre": made, "least_share_under_probe": kept.least}
        writer.warnings.extend(layer_warnings(kept, sum(each.thickness for each in layers)))
    for each in layers:
        writer.summary.append(f"layer {each.name}: {each.thickness:.1f} mm ({sources[each.name]})")
    low = (
        figures.min_angle_deg < MIN_ANGLE_DEG or figures.min_angle_under_probe_deg < MIN_ANGLE_UNDER_PROBE_DEG
    )
    if layers and low:
        writer.warnings.append(
            f"cells of the layers are flat (dihedral angles down to {figures.min_angle_deg:.1f} deg); "
            "use a finer mesh (--size-mm) or thicker layers if the solver stops"
        )


def _report(
    writer: StageWriter, found: SiteModel, options: MeshOptions, limb: Limb, segmented: StageResult,
    site: Site,
) -> None:  # fmt: skip
    figures, checks, frame = found.quality, found.checks, found.frame
    writer.data.update(
        {
            "element": options.element,
            "mesher": found.maker,
            "quality": vars(figures),
            "checks": vars(checks),
            "mending": [*limb.notes, *found.notes],
            "frame": {
                "skin_point_mm": frame.skin_point, "normal": frame.normal, "long_axis": frame.long_axis,
                "proximal": frame.proximal, "patient_from_model": frame.to_patient,
                "site_to_skin_mm": frame.moved, "long_axis_slope_deg": frame.slope_deg,
            },
            "margin_mm": options.margin,
            "size_under_probe_mm": options.sizes.under_probe,
            "size_far_mm": options.sizes.far,
            "start_depth_mm": options.start_depth,
            "cuts": found.model.info["cuts"],
            "measured_skin_bone_mm": measured_skin_bone(unnoted(site)),  # shown, and compared
        }
    )  # fmt: skip
    writer.summary.append(
        f"{figures.n_cells} {options.element}, {figures.n_nodes} nodes by {found.maker}; "
        f"edges {figures.edge_under_probe_mm:.1f} mm under the probe"
    )
    writer.summary.append(
        f"smallest dihedral angle {figures.min_angle_deg:.1f} deg, under the probe "
        f"{figures.min_angle_under_probe_deg:.1f} deg; no inverted cell"
    )
    bone = (
        "no bone under the probe's centre"
        if checks.skin_bone_mm is None
        else (f"skin to bone {checks.skin_bone_mm:.1f} mm at the probe's centre")
    )
    writer.summary.append(f"{bone}; {100 * checks.over_tissue_share:.0f} % of the face over tissue")
    writer.warnings.extend(warnings_of_limb(segmented))
    writer.warnings.extend(
        geometry_warnings(
            checks, measured=writer.data["measured_skin_bone_mm"], margin=options.margin, site=site.name
        )
    )
    writer.warnings.extend(moved_warnings(frame.moved, site))
    writer.warnings.extend(across_warnings(frame.proximal, site.long_axis))
    if abs(frame.slope_deg) > LARGEST_SLOPE_DEG:
        writer.warnings.append(
            f"long_axis leaves the skin by {abs(frame.slope_deg):.0f} degrees, more than a probe is "
            "tilted: it was projected onto the skin"
        )
