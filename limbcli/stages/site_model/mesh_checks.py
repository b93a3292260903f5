"""A site's model against what was measured there: what a user should know before trusting it."""

from __future__ import annotations

import numpy as np

from limbcli.case import Site
from limbcli.errors import MeasurementError
from limbcli.measurement.indentation import read_levels
from limbcli.meshing.checks import SiteChecks

OVER_TISSUE = 0.95  # part of the face that should have skin below
SKIN_BONE_TOLERANCE = 0.10  # of the measured distance
_CLOSE_TO_CUT = 0.9  # of the margin asked for


def measured_skin_bone(site: Site) -> float | None:
    """Skin-bone distance (mm) on the B-mode image of level 0, or its layers' sum; None without either."""
    if not site.levels.is_file():
        return None
    try:
        levels = read_levels(site.levels)
    except MeasurementError:
        return None  # build-feb reads the file again and tells what is wrong with it
    value = float(levels.skin_bone[0])
    if np.isnan(value) and "muscle" in levels.layers:
        value = float(sum(each[0] for each in levels.layers.values()))
    return value if np.isfinite(value) and value > 0 else None


def geometry_warnings(checks: SiteChecks, *, measured: float | None, margin: float, site: str) -> list[str]:
    """What does not fit, one sentence each.

    measured : skin-bone distance at level 0 (mm) or None; margin : tissue asked for beyond the probe (mm)
    """
    out = []
    if checks.over_tissue_share < OVER_TISSUE:
        share = 100 * checks.over_tissue_share
        out.append(f"only {share:.0f} % of the probe face lies over tissue; move {site}'s position_mm")
    if measured is not None and checks.skin_bone_mm is None:
        out.append(
            f"the B-mode image shows bone {measured:.1f} mm deep, the model has none under the probe; "
            "check position_mm and long_axis"
        )
    elif measured is not None and checks.skin_bone_mm is not None:
        off = checks.skin_bone_mm / measured - 1
        if abs(off) > SKIN_BONE_TOLERANCE:
            out.append(
                f"skin to bone is {checks.skin_bone_mm:.1f} mm in the model, {measured:.1f} mm on the B-mode "
                f"image ({100 * off:+.0f} %); check position_mm, long_axis and the segmentation"
            )
    if checks.to_cut_mm is not None and checks.to_cut_mm < _CLOSE_TO_CUT * margin:
        out.append(
            f"the images end {checks.to_cut_mm:.0f} mm beyond the probe, not the {margin:g} mm asked for; "
            "the fixed end stiffens the model"
        )
    return out
