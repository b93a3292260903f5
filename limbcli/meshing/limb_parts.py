"""Named parts of a limb: its frame, patches of the skin and landmarks, from its bones and long axis.

The definitions are limbcli's own, made for comparing pressures between limbs; docs/limb.md lists them. A part
whose bone is not there, or lies beyond a cut, is left out, and the reason is given.

Patches are disjoint: a facet that meets several definitions belongs to the first of them in `PATCHES`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from limbcli.meshing.anatomy import bone_named
from limbcli.meshing.frame import anterior_of, proximal_direction
from limbcli.meshing.mending import Limb
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array

PATCHES = ("fibular_head", "patellar_tendon", "tibial_end", "tibial_crest", "popliteal", "distal_end")
LANDMARKS = (
    "tibial_tuberosity", "tibial_end", "patella_lower_pole", "fibular_head", "fibular_end", "distal_tip",
)  # fmt: skip
AT_CUT_MM = 3.0  # a bone that comes this close to a cut is taken as cut there
TUBEROSITY_MM = 30.0  # height of the tibial tuberosity below the top of the tibia
TENDON_HALF_WIDTH_MM, CREST_HALF_WIDTH_MM = 15.0, 10.0
CREST_BELOW_MM, CREST_ABOVE_END_MM = 45.0, 15.0  # below the top of the tibia; above its distal end
END_PART_MM, HEAD_PART_MM = 10.0, 12.0  # length of the end of a bone under a patch
BEYOND_NEAREST_MM = 10.0  # skin this much farther from the bone's end than the nearest skin is in the patch
POPLITEAL_MM = (-45.0, 15.0)  # heights relative to the top of the tibia
FRONT, FRONT_OF_CREST, BACK = 0.3, 0.2, 0.7  # least cosine of the skin's normal to anterior, to posterior
BONE_BELOW_MM = 20.0  # a bone that reaches this far below the tibia's end is a foot: the end is an ankle
_SLICE = 6.0  # mm along the limb in which the most anterior point of the tibia is sought
_LEG = ("tibia", "fibula", "femur", "patella")


@dataclass(frozen=True, eq=False)
class LimbFrame:
    """Origin on the limb's axis at its distal end, unit directions in patient LPS; length along the axis, mm.

    axis : proximal; anterior, lateral : across it
    """

    origin: Array
    axis: Array
    anterior: Array
    lateral: Array
    length: float

    def height(self, points: Array) -> Array:
        """Height (n,) above the distal end of points (n, 3)."""
        return np.asarray((points - self.origin) @ self.axis)

    def aside(self, points: Array) -> Array:
        """Lateral offset (n,) from the axis."""
        return np.asarray((points - self.origin) @ self.lateral)

    def ahead(self, points: Array) -> Array:
        """Anterior offset (n,) from the axis."""
        return np.asarray((points - self.origin) @ self.anterior)

    def upright(self, points: Array) -> Array:
        """Points (n, 3) as seen in this frame: x to the patient's left, y to the back, z along the axis."""
        turn = np.stack([np.cross(self.axis, self.anterior), -self.anterior, self.axis])
        return np.asarray((points - self.origin) @ turn.T)

    def to_json(self) -> dict[str, Any]:
        names = ("origin", "axis", "anterior", "lateral")
        lists = {f"{name}_lps": getattr(self, name).tolist() for name in names}
        return {**lists, "long_axis": "axis_lps, towards proximal", "length_mm": self.length}


def limb_frame(limb: Limb, side: str) -> LimbFrame:
    """The frame of a limb in patient LPS; anterior is -y of LPS across the axis.

    side : "left" or "right"
    """
    axis = proximal_direction(limb)
    anterior = anterior_of(axis)
    left = np.cross(axis, anterior)
    along = limb.skin.points @ axis
    middle = np.average(limb.skin.centroids, axis=0, weights=limb.skin.areas)
    origin = middle + (along.min() - middle @ axis) * axis
    lateral = left if side == "left" else -left
    return LimbFrame(origin, axis, anterior, lateral, float(np.ptp(along)))


@dataclass(frozen=True, eq=False)
class LimbParts:
    """Masks (n_facets,) of the skin's facets by patch, landmarks (3,), and why others are missing."""

    patches: Mapping[str, NDArray[np.bool_]]
    landmarks: Mapping[str, Array]
    missing: Mapping[str, str]


class _MissingPart(Exception):
    """Why a part is not there."""


@dataclass(frozen=True, eq=False)
class _Leg:
    """The limb as the definitions need it: skin facets' centroids and normals, bones, heights of the cuts."""

    frame: LimbFrame
    centroids: Array
    normals: Array
    bones: Mapping[str, Triangles]
    top: float
    bottom: float

    def bone(self, name: str) -> tuple[Triangles, float | None, float | None]:
        """A bone, and the heights of its distal and proximal end, None where cut.

        Raises _MissingPart if there is no such bone.
        """
        bone = bone_named(self.bones, name)
        if bone is None:
            raise _MissingPart(f"no bone is named {name}")
        height = self.frame.height(bone.points)
        low, high = float(height.min()), float(height.max())
        low_end = low if low > self.bottom + AT_CUT_MM else None
        return bone, low_end, high if high < self.top - AT_CUT_MM else None


def limb_parts(
    frame: LimbFrame, skin: Triangles, bones: Mapping[str, Triangles], *, top: float, bottom: float = -np.inf
) -> LimbParts:
    """Patches of the skin and landmarks that this limb's bones define.

    skin : the skin's facets without the cuts, patient LPS, mm
    bones : by names such as "bone_tibia"
    top, bottom : heights of the proximal and of a distal cut above the limb's distal end, mm
    """
    unit = skin.area_vectors / np.maximum(skin.areas, 1e-12)[:, None]
    leg = _Leg(frame, skin.centroids, unit, bones, top, bottom)
    landmarks: dict[str, Array] = {}
    missing: dict[str, str] = {}
    taken = np.zeros(len(skin.faces), bool)
    patches = {}
    for name, place in _PLACED.items():
        try:
            own = place(leg, landmarks) & ~taken
        except _MissingPart as reason:
            missing[name] = str(reason)
            continue
        if own.any():
            patches[name] = own
            taken |= own
        else:
            missing[name] = "no facet of the skin meets its definition"
    return LimbParts(patches, landmarks, missing)


def _near_end(leg: _Leg, bone: Triangles, keep: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Facets hardly farther from these points of a bone than the nearest facet."""
    far, _ = cKDTree(bone.points[keep]).query(leg.centroids)
    return np.asarray(far <= far.min() + BEYOND_NEAREST_MM)


def _plateau(leg: _Leg) -> float:
    """Height of the top of the tibia."""
    _, _, high = leg.bone("tibia")
    if high is None:
        raise _MissingPart("the top of the tibia lies beyond the proximal cut")
    return high


def _crest(leg: _Leg, heights: Array) -> tuple[Array, Array]:
    """Lateral and anterior offset (n,) of the tibia's most anterior point at heights (n,)."""
    tibia, _, _ = leg.bone("tibia")
    along, aside, ahead = (of(tibia.points) for of in (leg.frame.height, leg.frame.aside, leg.frame.ahead))
    at = np.arange(along.min() + _SLICE / 2, along.max() - _SLICE / 2 + 1e-9, _SLICE)
    found = []
    for each in at:
        near = np.flatnonzero(np.abs(along - each) <= _SLICE)
        if len(near):
            k = near[np.argmax(ahead[near])]
            found.append((each, aside[k], ahead[k]))
    table = np.array(found)
    smooth = [
        np.array([np.median(table[max(k - 1, 0) : k + 2, c]) for k in range(len(table))]) for c in (1, 2)
    ]
    return np.interp(heights, table[:, 0], smooth[0]), np.interp(heights, table[:, 0], smooth[1])


def _fibular_head(leg: _Leg, landmarks: dict[str, Array]) -> NDArray[np.bool_]:
    fibula, low, high = leg.bone("fibula")
    height = leg.frame.height(fibula.points)
    if low is not None:
        landmarks["fibular_end"] = fibula.points[np.argmin(height)]
    if high is None:
        raise _MissingPart("the top of the fibula lies beyond the proximal cut")
    landmarks["fibular_head"] = fibula.points[np.argmax(height)]
    outward = leg.normals @ leg.frame.lateral > 0
    return _near_end(leg, fibula, height >= high - HEAD_PART_MM) & outward


def _patellar_tendon(leg: _Leg, landmarks: dict[str, Array]) -> NDArray[np.bool_]:
    plateau = _plateau(leg)
    low = plateau - TUBEROSITY_MM
    aside, ahead = (float(each[0]) for each in _crest(leg, np.array([low])))
    frame = leg.frame
    landmarks["tibial_tuberosity"] = (
        frame.origin + low * frame.axis + aside * frame.lateral + ahead * frame.anterior
    )
    patella = bone_named(leg.bones, "patella")
    if patella is None:
        raise _MissingPart("no bone is named patella, from whose lower pole the tendon runs")
    heights = leg.frame.height(patella.points)
    pole = patella.points[np.argmin(heights)]
    landmarks["patella_lower_pole"] = pole
    high = float(heights.min())
    if not low < high < leg.top:
        raise _MissingPart("the patella's lower pole is not above the tibial tuberosity and below the cut")
    height = leg.frame.height(leg.centroids)
    share = np.clip((height - low) / (high - low), 0, 1)
    middle = aside + share * (float(leg.frame.aside(pole[None])[0]) - aside)
    near = np.abs(leg.frame.aside(leg.centroids) - middle) <= TENDON_HALF_WIDTH_MM
    return near & (height >= low) & (height <= high) & (leg.normals @ leg.frame.anterior > FRONT)


def _tibial_end(leg: _Leg, landmarks: dict[str, Array]) -> NDArray[np.bool_]:
    tibia, low, _ = leg.bone("tibia")
    if low is None:
        raise _MissingPart("the tibia goes on beyond the distal cut")
    others = [
        leg.frame.height(each.points).min()
        for name, each in leg.bones.items()
        if not any(k in name for k in _LEG)
    ]
    if others and min(others) < low - BONE_BELOW_MM:
        raise _MissingPart("other bones lie below the tibia: its end is an ankle")
    height = leg.frame.height(tibia.points)
    landmarks["tibial_end"] = tibia.points[np.argmin(height)]
    return _near_end(leg, tibia, height <= low + END_PART_MM)


def _tibial_crest(leg: _Leg, _landmarks: dict[str, Array]) -> NDArray[np.bool_]:
    _, below, above = leg.bone("tibia")
    low = leg.bottom if below is None else below + CREST_ABOVE_END_MM
    high = leg.top if above is None else above - CREST_BELOW_MM
    height = leg.frame.height(leg.centroids)
    aside, ahead = _crest(leg, height)
    near = np.abs(leg.frame.aside(leg.centroids) - aside) <= CREST_HALF_WIDTH_MM
    before = (leg.frame.ahead(leg.centroids) > ahead) & (leg.normals @ leg.frame.anterior > FRONT_OF_CREST)
    return near & before & (height >= low) & (height <= high)


def _popliteal(leg: _Leg, _landmarks: dict[str, Array]) -> NDArray[np.bool_]:
    plateau = _plateau(leg)
    height = leg.frame.height(leg.centroids) - plateau
    within = (height >= POPLITEAL_MM[0]) & (height <= POPLITEAL_MM[1])
    return within & (leg.normals @ leg.frame.anterior < -BACK)


def _distal_end(leg: _Leg, landmarks: dict[str, Array]) -> NDArray[np.bool_]:
    if np.isfinite(leg.bottom):
        raise _MissingPart("the limb is cut at its distal end")
    height = leg.frame.height(leg.centroids)
    landmarks["distal_tip"] = leg.centroids[np.argmin(height)]
    bones = [leg.frame.height(each.points).min() for each in leg.bones.values()]
    if not bones:
        raise _MissingPart("there is no bone whose end it would lie below")
    return np.asarray(height < min(bones))


_PLACES = (_fibular_head, _patellar_tendon, _tibial_end, _tibial_crest, _popliteal, _distal_end)
_PLACED = dict(zip(PATCHES, _PLACES, strict=True))
