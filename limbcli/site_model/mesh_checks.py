"""Checks of a site's model against the measurements there, reported as warnings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limbcli.case import Site
from limbcli.errors import MeasurementError
from limbcli.measurement.indentation import read_levels
from limbcli.model import Array
from limbcli.model.patient_frame import HEAD
from limbcli.results import StageResult

if TYPE_CHECKING:  # `check` asks for distances only, without the mesher
    from limbcli.meshing.checks import LayersKept, SiteChecks

OVER_TISSUE = 0.95  # least share of the probe's face that should be over skin
SKIN_BONE_TOLERANCE = 0.10  # tolerance of the skin-bone distance, as a fraction of the measured one
_CLOSE_TO_CUT = 0.9  # least margin of tissue around the probe, as a fraction of the requested one
_ACROSS_DEG = 15.0  # largest angle of a limb to the plane across the body at which its ends are in doubt
# Depth, as a fraction of the skin-bone distance, beyond which it is doubted: 752 indentations of arms and
# legs (Neumann et al. 2018) have at most 0.50.
_DEEP = 0.6
_LAYERS_KEPT = 0.9  # least thickness of layers in the model, as a fraction of the requested one


def measured_skin_bone(site: Site) -> float | None:
    """Skin-bone distance (mm) of level 0, or the sum of its layers, else the site's stated one; or None."""
    of_levels = skin_bone_of_levels(site)
    return site.skin_bone if of_levels is None else of_levels


def skin_bone_of_levels(site: Site) -> float | None:
    """Skin-bone distance (mm) on the B-mode image of level 0, else the sum of its layers; None without."""
    if not site.levels.is_file():
        return None
    try:
        levels = read_levels(site.levels)
    except MeasurementError:
        return None  # build-feb reads the file again and reports what is wrong with it
    value = float(levels.skin_bone[0])
    if np.isnan(value) and "muscle" in levels.layers:
        value = float(sum(each[0] for each in levels.layers.values()))
    return value if np.isfinite(value) and value > 0 else None


def check_within_tissue(deepest: float, modelled: float | None, site: Site) -> list[str]:
    """A warning if the probe's deepest level (mm) leaves little of the model's tissue above the bone.

    modelled : skin-bone distance in the model, mm; None: no bone

    Raises MeasurementError if it reaches the bone.
    """
    if modelled is not None and deepest >= modelled:
        raise MeasurementError(
            f"the depth reaches {deepest:.4g} mm, but the model has {modelled:.4g} mm from skin to bone",
            where=f"site {site.name}, {site.levels}",
            fix="depth_mm is the decrease in skin-bone distance, in mm: correct it, or the position of "
            "the site or the bone, and mesh again",
            deepest_mm=deepest,
            skin_bone_mm=modelled,
        )
    if modelled is None or deepest <= _DEEP * modelled:
        return []
    return [
        f"the depth reaches {100 * deepest / modelled:.0f} % of the {modelled:.3g} mm from skin to bone: "
        "limbs are hardly pressed so far, and simulations take long or end early; check depth_mm and the bone"
    ]


def bone_warnings(modelled: float | None, measured: float | None) -> list[str]:
    """Warn if the bone's depth (mm) in the model differs from the measured one; None: no bone or value."""
    if measured is None:
        return []
    if modelled is None:
        return [
            f"the B-mode image shows bone {measured:.1f} mm deep, the model has none under the probe; "
            "check position_mm and long_axis"
        ]
    off = modelled / measured - 1
    if abs(off) <= SKIN_BONE_TOLERANCE:
        return []
    return [
        f"skin to bone is {modelled:.1f} mm in the model, {measured:.1f} mm on the B-mode "
        f"image ({100 * off:+.0f} %); check position_mm, long_axis and the segmentation"
    ]


def warnings_now(meshed: StageResult, site: Site) -> list[str]:
    """The warnings of a mesh; that on the bone's depth uses the current measurement, as levels may have been
    read or corrected since."""
    if "checks" not in meshed.data:
        return list(meshed.warnings)
    modelled = meshed.data["checks"]["skin_bone_mm"]
    then = bone_warnings(modelled, meshed.data["measured_skin_bone_mm"])
    others = [each for each in meshed.warnings if each not in then]
    return [*others, *bone_warnings(modelled, measured_skin_bone(site))]


def geometry_warnings(checks: SiteChecks, *, measured: float | None, margin: float, site: str) -> list[str]:
    """Warnings about the geometry, one sentence each.

    measured : skin-bone distance at level 0 (mm) or None; margin : requested tissue around the probe (mm)
    """
    out = []
    if checks.over_tissue_share < OVER_TISSUE:
        share = 100 * checks.over_tissue_share
        out.append(f"only {share:.0f} % of the probe face is over tissue; move {site}'s position_mm")
    out += bone_warnings(checks.skin_bone_mm, measured)
    if checks.to_cut_mm is not None and checks.to_cut_mm < _CLOSE_TO_CUT * margin:
        out.append(
            f"the images end {checks.to_cut_mm:.0f} mm beyond the probe, not the {margin:g} mm requested; "
            "the fixed end stiffens the model"
        )
    return out


def moved_warnings(moved: float, site: Site) -> list[str]:
    """Warn if a place was off the skin by `moved` mm; a marker's centre is expected to be above the skin."""
    from limbcli.meshing.sites_on_skin import MOVED_MM

    if site.marker is not None or moved <= MOVED_MM:
        return []
    return [f"the site was {moved:.1f} mm from the skin and was moved onto it"]


def across_warnings(proximal: Array, long_axis: str | tuple[float, float, float]) -> list[str]:
    """Warn if a limb lies across the head-foot direction, by which its proximal end is told.

    proximal : (3,), unit vector in LPS along the limb; long_axis : of the site, as in case.toml
    """
    degrees = float(np.degrees(np.arcsin(min(1.0, abs(float(proximal @ HEAD))))))
    if not isinstance(long_axis, str) or degrees > _ACROSS_DEG:
        return []
    return [
        f"the limb lies across the head-foot direction, z of LPS (within {degrees:.0f} degrees): which end "
        f'is proximal is not certain: long_axis = "{long_axis}" may be reversed, and with it lateral_mm of '
        "shear-wave maps; give long_axis as a vector, or turn the surfaces"
    ]


def layer_warnings(kept: LayersKept, total: float) -> list[str]:
    """Warn if the layers, of `total` mm as requested, are thinner in the model."""
    if not kept.least < _LAYERS_KEPT:
        return []
    centre = "" if np.isnan(kept.centre) else f", {kept.centre * total:.1f} mm at its centre"
    return [
        f"the layers, {total:.1f} mm together, thin out over bone, where other tissue must be below them: "
        f"{kept.least * total:.1f} mm are left under the probe{centre}; check the bone's depth, or give "
        "thinner layers"
    ]
