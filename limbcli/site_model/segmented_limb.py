"""What `segment` left of a limb: its surfaces, and where a site lies on them."""

from __future__ import annotations

from limbcli.case import Site
from limbcli.errors import CaseError
from limbcli.meshing.mending import Limb, mend
from limbcli.meshing.surfaces import read_surface
from limbcli.results import StageResult


def read_limb(segmented: StageResult) -> Limb:
    """The surfaces written by `segment`, repaired."""
    paths = sorted(segmented.path(name) for name in segmented.files if name.startswith("bone_"))
    skin = read_surface(segmented.folder / "skin.ply")
    return mend(skin, [read_surface(each) for each in paths], where=str(segmented.folder))


def site_position(site: Site, segmented: StageResult) -> tuple[float, float, float]:
    """Position of a site (LPS, mm): as given, or that of its marker.

    Raises
    ------
    CaseError
        If the marker was not found in the images.
    """
    if site.position is not None:
        return site.position
    markers = {each["number"]: each["position_mm"] for each in segmented.data.get("markers", [])}
    if site.marker not in markers:
        known = ", ".join(map(str, sorted(markers))) or "none"
        raise CaseError(
            f"marker {site.marker} was not found (markers in the images: {known})",
            where=f"site {site.name}",
            fix="see the contact sheet of `limbcli segment`, or give position_mm instead of marker",
        )
    x, y, z = markers[site.marker]
    return float(x), float(y), float(z)
