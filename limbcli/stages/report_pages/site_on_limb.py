"""Where a site is on its limb, from the results of `segment` and `mesh`, for the report's first screen."""

from __future__ import annotations

import numpy as np

from limbcli.case import Case, Site
from limbcli.errors import LimbError
from limbcli.meshing.surfaces import Triangles, read_surface
from limbcli.model import Array
from limbcli.reporting.figures.limb_views import LimbPlace
from limbcli.reporting.outcome import Outcomes
from limbcli.results import UNLIKE_OURS, StageResult

_NEAR_MM = 15.0  # the part of the skin, along the limb, whose middle tells which way is outwards


def limb_skin(outcomes: Outcomes) -> Triangles | None:
    """The skin that `segment` wrote, or None if there is none that can be read."""
    segmented = outcomes.of("segment").usable
    if segmented is None or "skin" not in segmented.files:
        return None
    try:
        return read_surface(segmented.path("skin"))
    except (LimbError, OSError, ValueError):
        return None


def limb_place(case: Case, site: Site, skin: Triangles | None, outcomes: Outcomes) -> LimbPlace | None:
    """The site on the skin; None without a skin, or if the site's position is not known."""
    if skin is None:
        return None
    try:
        framed = _framed(case, site, skin, outcomes.of("mesh", site.name).usable)
        return framed or _unframed(case, site, skin, outcomes.of("segment").usable)
    except UNLIKE_OURS:
        return None


def _framed(case: Case, site: Site, skin: Triangles, meshed: StageResult | None) -> LimbPlace | None:
    """The place with the probe's face, as `mesh` found it."""
    if meshed is None or "frame" not in meshed.data:
        return None
    frame = meshed.data["frame"]
    place, outward, along = (np.array(frame[key], float) for key in ("skin_point_mm", "normal", "long_axis"))
    across = np.cross(outward, along)
    half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [case.probe.length / 2, case.probe.width / 2]
    return LimbPlace(
        name=site.name, limb=case.limb, points=skin.points, triangles=skin.faces, place=place,
        outward=outward, face=place + half @ np.stack([along, across]),
    )  # fmt: skip


def _unframed(case: Case, site: Site, skin: Triangles, segmented: StageResult | None) -> LimbPlace | None:
    """The place that the case states or a marker has, before `mesh`."""
    place = site.position
    if place is None and segmented is not None:
        markers = {each["number"]: each["position_mm"] for each in segmented.data.get("markers", ())}
        place = markers.get(site.marker)
    if place is None:
        return None
    point = np.array(place, float)
    return LimbPlace(
        name=site.name, limb=case.limb, points=skin.points, triangles=skin.faces, place=point,
        outward=point - _middle(skin, point),
    )  # fmt: skip


def _middle(skin: Triangles, point: Array) -> Array:
    """The middle of the limb's section at the height of a point, at that height."""
    near = skin.points[np.abs(skin.points[:, 2] - point[2]) < _NEAR_MM]
    middle = (near if len(near) else skin.points).mean(axis=0)
    return np.array([middle[0], middle[1], point[2]])
