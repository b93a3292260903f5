"""Uncertainty of the force from an assumed geometry, as determined by the fit."""

from __future__ import annotations

from pathlib import Path

from limbcli.case import Case, Site
from limbcli.errors import LimbError
from limbcli.results import read_result
from limbcli.significant_digits import short

USUAL = 0.15  # relative standard deviation of the force if no fit varied the geometry: as of parametric limbs


def assumed_gain(case: Case, site: Site, out: Path) -> tuple[float, str]:
    """Standard deviation of ln force from an assumed geometry, and a warning; 0 if the geometry was
    imaged."""
    words = case.imaging.assumed
    if not words:
        return 0.0, ""
    try:
        uncertainty = read_result(out, "fit", site=site.name).data.get("geometry_uncertainty") or {}
    except LimbError:
        uncertainty = {}
    found = uncertainty.get("gain_fraction")
    if uncertainty.get("words") != words or found is None:
        return USUAL, (
            f"{words}. No fit has varied it: its uncertainty is taken as {100 * USUAL:g} % of the force at "
            f"site {site.name}; run `limbcli fit`, then diagnose again"
        )
    return float(found), (
        f"{words}. From the fit's geometry variations, {short(100 * float(found), 2)} % of "
        f"the force at site {site.name} is uncertain, treated as one common factor; a change with depth is "
        "not allowed for"
    )
