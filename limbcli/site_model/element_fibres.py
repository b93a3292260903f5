"""The muscle fibres of a site's model, as stated by the case: one direction per element of the tissue."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from limbcli.case import Case, Site
from limbcli.case.noting import unnoted
from limbcli.effects.tissue import TISSUE, limb_axis
from limbcli.errors import CaseError
from limbcli.meshing.fibres_from_angles import ImageAngle, direction_of_angles, mean_axis
from limbcli.meshing.frame import probe_axis
from limbcli.meshing.mesh_picture import fibre_picture
from limbcli.meshing.probe import ProbeShape
from limbcli.model import FIBRES, Array, ElementMap, LimbModel
from limbcli.model.patient_frame import HEAD, patient_from_model, side_of
from limbcli.results import StageWriter

_LEAST_COVERED = 0.5  # least share of the tissue's elements near the probe that a fibre map must cover
_NEAR_PROBE = 30.0  # mm, distance from first touch within which coverage is checked
_OUT_OF_SKIN_DEG = 60.0
DEFAULT_DIRECTION = "no fibre direction is given: along the limb, within the skin"


@dataclass(frozen=True, eq=False)
class SiteFibres:
    """The fibre directions of a site.

    axes (n_cells, 3) : unit vectors for the cells of the tissue's block, in the site's frame; None if unknown
    source : in words; deviation_deg : standard deviation of the direction, None if unknown
    facts : further data for JSON
    """

    axes: Array | None
    source: str
    deviation_deg: float | None = None
    facts: Mapping[str, Any] | None = None


def with_fibres(case: Case, site: Site, model: LimbModel) -> tuple[LimbModel, SiteFibres]:
    """The meshed model with the fibres stated by the case, and the fibres with their source.

    Raises CaseError if the angles do not determine a direction, or the map does not cover the tissue under
    the probe.
    """
    found = _site_fibres(case, site, model)
    if found.axes is None:
        return model, found
    block = next(each.block for each in model.domains if each.material == TISSUE)
    return replace(model, fibres=ElementMap(FIBRES, block, found.axes)), found


def _site_fibres(case: Case, site: Site, model: LimbModel) -> SiteFibres:
    to_patient = patient_from_model(model)
    rotation, where = to_patient[:3, :3], f"site {site.name}, {case.file}"
    block = next(model.mesh.block(each.block) for each in model.domains if each.material == TISSUE)
    n = len(block.cells)
    if site.fibres.direction is not None:
        axis = np.array(site.fibres.direction) / np.linalg.norm(site.fibres.direction)
        return _alike(rotation.T @ axis, n, "fibre_direction of the case", None)
    if site.fibres.pennation:
        normal, proximal = rotation[:, 2], np.array(model.info.get("proximal", HEAD), dtype=float)
        angles = [
            ImageAngle(
                probe_axis(_long_axis(case, each.orientation), proximal, normal, where=where),
                each.angle_deg,
                each.deviation_deg,
            )
            for each in site.fibres.pennation
        ]
        direction = direction_of_angles(angles, -normal, proximal=proximal, where=where)
        planes = " and ".join(f"{p.angle_deg:g} deg ({p.orientation})" for p in site.fibres.pennation)
        source = f"pennation {planes}, {direction.how}"
        return _alike(rotation.T @ direction.axis, n, source, direction.deviation_deg)
    if case.imaging.fibres is None:
        return SiteFibres(None, DEFAULT_DIRECTION)
    return _of_map(case, site, to_patient, model.mesh.points[block.cells].mean(axis=1))


def _alike(axis: Array, n: int, source: str, deviation_deg: float | None) -> SiteFibres:
    return SiteFibres(np.tile(axis, (n, 1)), source, deviation_deg)


def _long_axis(case: Case, orientation: str) -> str | tuple[float, float, float]:
    is_site = orientation in [each.name for each in unnoted(case).sites]
    return case.site(orientation).long_axis if is_site else orientation


def _of_map(case: Case, site: Site, to_patient: Array, middles: Array) -> SiteFibres:
    from limbcli.imaging.fibre_map import REACH, read_fibre_map  # nibabel, for these cases alone

    path = case.imaging.fibres
    assert path is not None
    fibres = read_fibre_map(path, frame=case.imaging.fibre_frame or "ras")
    sample = fibres.at(middles @ to_patient[:3, :3].T + to_patient[:3, 3])
    known = np.isfinite(sample.axes[:, 0])
    close = np.linalg.norm(middles, axis=1) <= _NEAR_PROBE
    close = close if close.any() else np.ones(len(middles), dtype=bool)
    share = float(known[close].mean())
    if share < _LEAST_COVERED:
        raise CaseError(
            f"the fibre map has no data for {100 * (1 - share):.0f} % of the tissue within "
            f"{_NEAR_PROBE:g} mm of site {site.name}: it is outside the limb, or in another frame",
            where=str(path),
            fix="give the map in the frame of the limb's own images, including the muscle at the site",
            covered_share=share,
        )
    axes = np.where(known[:, None], sample.axes, 0.0) @ to_patient[:3, :3]
    mean, spread = mean_axis(axes[close & known])
    axes[~known] = mean
    facts = {
        "covered_share": float(sample.covered.mean()), "from_nearest_share": float(sample.near.mean()),
        "from_mean_share": float((~known).mean()), "nearest_within_mm": REACH,
        "agreement_of_neighbours": float(sample.agreement[known].mean()), "spread_near_probe_deg": spread,
    }  # fmt: skip
    return SiteFibres(axes, f"diffusion MRI ({path.name})", None, facts)


def write_fibres(
    found: SiteFibres, model: LimbModel, probe: ProbeShape, site: Site, writer: StageWriter
) -> None:
    """Write the fibres' entry in mesh.json, warnings, and their figure."""
    near = np.array([limb_axis(model)]) if found.axes is None else found.axes
    axis, _ = mean_axis(near)
    to_patient = patient_from_model(model)[:3, :3]
    in_patient = to_patient @ axis
    out_of_skin = float(np.degrees(np.arcsin(min(1.0, abs(axis[2])))))
    to_image = float(np.degrees(np.arctan2(abs(axis[1]), abs(axis[0]))))
    writer.data["fibres"] = {
        "told": found.axes is not None, "source": found.source, "deviation_deg": found.deviation_deg,
        "mean_direction": in_patient, "out_of_skin_deg": out_of_skin, "to_image_plane_deg": to_image,
        **(found.facts or {}),
    }  # fmt: skip
    deviation = "" if found.deviation_deg is None else f", deviation {found.deviation_deg:.1f} deg"
    writer.summary.append(
        f"fibres: {found.source}{deviation}; {to_image:.0f} deg from the probe's long side, "
        f"{out_of_skin:.0f} deg out of the skin's plane"
    )
    if out_of_skin > _OUT_OF_SKIN_DEG:
        writer.warnings.append(
            f"the fibres of site {site.name} are {out_of_skin:.0f} deg out of the skin's plane, which "
            "is not plausible for muscle below a probe: check fibre_direction (patient LPS) or fibre_frame"
        )
    block = next(model.mesh.block(each.block) for each in model.domains if each.material == TISSUE)
    axes = np.tile(near[0], (len(block.cells), 1)) if found.axes is None else found.axes
    picture = writer.file("fibre_picture", "fibres.png")
    sides = side_of(to_patient[:, 0]), side_of(to_patient[:, 1])
    fibre_picture(model.mesh, block, axes, probe, picture, title=found.source, sides=sides)
    share = (found.facts or {}).get("from_mean_share", 0.0)
    if share > 0.1:
        writer.warnings.append(
            f"the fibre map has no data for {100 * share:.0f} % of the model's tissue; the mean "
            "direction near the probe is used there"
        )
