"""A site's complete model: mesh, probe, contact, supports and load, with a placeholder material."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from limbcli.errors import CaseError
from limbcli.meshing.checks import LayersKept, SiteChecks, layers_kept, site_checks, to_cut
from limbcli.meshing.conforming_layers import Layer, core_of, open_ended, with_layers
from limbcli.meshing.crop import crop_planes
from limbcli.meshing.domain import CUT, TissueDomain, make_domain
from limbcli.meshing.frame import SiteFrame, site_frame
from limbcli.meshing.mending import Limb, Plane
from limbcli.meshing.probe import PlacedProbe, ProbeMesh, ProbeShape, check_shape, probe_mesh
from limbcli.meshing.quality import MeshQuality, quality
from limbcli.meshing.regions import PROBE_QUADS, PROBE_TIPS, assemble
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_mesher import VolumeMesh, mesh_volume, under_probe
from limbcli.model import Curve, Domain, IntArray, LimbModel, Material, Mesh, Step, Support
from limbcli.model.bodies import Contact, Drive, RigidBody
from limbcli.numbers.mesh_bounds import ELEMENTS
from limbcli.progress import SILENT, Progress

# placeholder Ogden law until measurements are set: modulus (MPa), kappa over it, exponent
_STIFFNESS, _F_KAPPA, _EXPONENT = 0.005, 100.0, 2.0


@dataclass(frozen=True)
class MeshOptions:
    """Options of a site's mesh; lengths in mm.

    start_depth : initial penetration of the probe into the skin (contact needs it)
    depth : indentation at the end of the placeholder load
    """

    element: str = "tet10"
    margin: float = 40.0
    sizes: Sizes = field(default_factory=Sizes)
    start_depth: float = 0.05
    depth: float = 10.0
    spacing: float = 1.0
    layers: tuple[Layer, ...] = ()


@dataclass(frozen=True, eq=False)
class SiteModel:
    """The model and the findings of its construction; `layers` is None if it has no layers."""

    model: LimbModel
    frame: SiteFrame
    domain: TissueDomain
    quality: MeshQuality
    checks: SiteChecks
    maker: str
    notes: tuple[str, ...]
    layers: LayersKept | None = None


def site_model(
    limb: Limb,
    position: tuple[float, float, float],
    long_axis: str | tuple[float, float, float],
    probe: ProbeShape,
    options: MeshOptions = MeshOptions(),
    *,
    name: str = "site",
    progress: Progress = SILENT,
) -> SiteModel:
    """The local model of a site: frame, crop, volume mesh, rigid probe, contact, supports, load.

    `limb` is in the patient frame (LPS, mm), as `mend` returns it.

    Raises CaseError if site, probe or options are unusable, or the images end under the probe; MeshError if
    no volume mesh of sufficient quality could be made.
    """
    if options.element not in ELEMENTS:
        raise CaseError(f"element {options.element!r} is not known", where=name, fix="use tet10 or tet4")
    check_shape(probe)
    progress.event("task", name="mesh: frame and crop", done=0, total=4)
    frame = site_frame(limb, np.asarray(position, float), long_axis, probe, where=f"site {name}")
    local = limb.moved(frame.to_model)
    planes = crop_planes(local, probe, options.margin)
    _require_tissue_to_the_edge(planes, probe, name)
    domain = make_domain(local, planes, spacing=options.spacing)
    progress.event("task", name="mesh: volume", done=1, total=4)
    filled = open_ended(domain, options.layers) if options.layers else domain
    core = core_of(filled, options.layers) if options.layers else None
    volume, kinds = _fill(filled, core, probe, options)
    progress.event("task", name="mesh: model", done=3, total=4)
    checks = site_checks(domain, probe)
    rigid = probe_mesh(probe)
    lowered = ProbeMesh(rigid.points - [0, 0, options.start_depth], rigid.quads, rigid.tips)
    names = ("tissue", *(each.name for each in reversed(options.layers)))
    mesh = assemble(volume, kinds, names, probe, lowered, element=options.element)
    figures = _figures(mesh, volume, probe)
    info = _info(name, frame, probe, options, domain, volume)
    progress.event("task", name="mesh: done", done=4, total=4)
    return SiteModel(
        _model(mesh, options, info),
        frame,
        domain,
        figures,
        checks,
        volume.maker,
        (*domain.notes, *volume.notes),
        None if core is None else layers_kept(domain, core, probe, _thickness(options)),
    )


def _require_tissue_to_the_edge(planes: tuple[Plane, ...], probe: ProbeShape, name: str) -> None:
    """Refuse a cut under the face: it is fixed like bone, and would carry the probe."""
    reach = to_cut(planes, probe)
    if reach is not None and reach < 0:
        raise CaseError(
            f"the images end {-reach:.0f} mm inside the probe's face: part of it is not covered "
            "by the images",
            where=f"site {name}",
            fix="move position_mm away from the end, check long_axis, or use images that extend beyond it",
            to_cut_mm=reach,
        )


def _thickness(options: MeshOptions) -> float:
    return sum(each.thickness for each in options.layers)


def _fill(
    domain: TissueDomain, core: TissueDomain | None, probe: ProbeShape, options: MeshOptions
) -> tuple[VolumeMesh, IntArray]:
    """The cells and the index of each cell's block; `core` is the tissue below the layers."""
    probes = (PlacedProbe(probe),)
    if core is None:
        volume = mesh_volume(domain, probes, options.sizes)
        return volume, np.zeros(len(volume.cells), np.int64)
    sizes = replace(options.sizes, reach=options.sizes.reach + _thickness(options))
    return with_layers(mesh_volume(core, probes, sizes), core, domain.skin, options.layers)


def _figures(mesh: Mesh, volume: VolumeMesh, probe: ProbeShape) -> MeshQuality:
    cells = np.concatenate([each.cells for each in mesh.solid_blocks])
    probes = (PlacedProbe(probe),)
    face = under_probe(mesh.points, cells, probes, beside=0.0, depth=3.0)
    return quality(mesh.points, cells, under_probe(mesh.points, cells, probes), face)


def _model(mesh: Mesh, options: MeshOptions, info: Mapping[str, Any]) -> LimbModel:
    """Placeholder laws and load on a mesh: indentation along -z, all else of the probe fixed."""
    half = _STIFFNESS / 2
    tissue = Material(
        "ogden", {"c1": half, "m1": _EXPONENT, "c2": half, "m2": -_EXPONENT, "kappa": _F_KAPPA * _STIFFNESS}
    )
    body = RigidBody("probe", (0.0, 0.0, -options.start_depth), (PROBE_QUADS, PROBE_TIPS))
    held = tuple(Drive("probe", dof, "fixed") for dof in ("x", "y", "u", "v", "w"))  # type: ignore[arg-type]
    down = Drive("probe", "z", "displacement", -(options.depth - options.start_depth), "load")
    return LimbModel(
        mesh=mesh,
        materials={each.name: tissue for each in mesh.solid_blocks},
        domains=tuple(Domain(each.name, each.name) for each in mesh.solid_blocks),
        bodies=(body,),
        supports=(Support("fixed", ("x", "y", "z")),),
        drives=(*held, down),
        contacts=(Contact("contact", "probe_face"),),
        curves={"load": Curve(((0.0, 0.0), (1.0, 1.0)))},
        steps=(Step(n_steps=20, step_size=0.05, must_points=tuple(k / 10 for k in range(1, 11))),),
        info=info,
    )


def _info(
    name: str,
    frame: SiteFrame,
    probe: ProbeShape,
    options: MeshOptions,
    domain: TissueDomain,
    volume: VolumeMesh,
) -> dict[str, Any]:
    return {
        "site": name,
        "patient_from_model": [float(v) for v in frame.to_patient.ravel()],
        "proximal": [float(v) for v in frame.proximal],
        "probe_length_mm": probe.length,
        "probe_width_mm": probe.width,
        "probe_edge_radius_mm": probe.edge_radius,
        "start_depth_mm": options.start_depth,
        "margin_mm": options.margin,
        "element": options.element,
        "size_under_probe_mm": options.sizes.under_probe,
        "size_far_mm": options.sizes.far,
        "cuts": [each.name for k, each in enumerate(domain.planes) if (volume.labels == CUT + k).any()],
        "mesher": volume.maker,
    }
