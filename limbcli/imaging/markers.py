"""Skin markers: bright capsules that protrude from the skin."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.imaging.intensity import TissueIntensities
from limbcli.imaging.signed_distance import box_around, distance_to, is_near
from limbcli.imaging.volume import Volume
from limbcli.model import Array

_BALL = 12.0  # mm: radius of the ball of a morphological opening that removes markers but not the limb
BLUR_MM = 3.0  # mm around a marker affected by its brightness
_PROUD = 2.0  # mm: smallest height of a marker above the skin
MARKER_SIZES_MM3 = (30.0, 4000.0)  # smallest and largest volume of a marker
_AWAY = 15.0  # mm: largest distance of a marker from the limb
_SAME_HEIGHT = 5.0  # mm: markers whose heights differ by less are numbered by angle
# degrees to the right of anterior that still count as anterior: nobody places a marker at exactly 0
_IN_FRONT = 15.0
_LONGEST = 35.0  # mm: largest extent of a marker


@dataclass(frozen=True)
class MarkerCapsule:
    """A capsule: number from 1, centre (patient LPS, mm), volume (mm^3)."""

    number: int
    position: tuple[float, float, float]
    volume: float


@dataclass(frozen=True, eq=False)
class FoundMarkers:
    """The markers; `mask` of their voxels; `around`: voxels of markers and their blur, outside the limb."""

    markers: tuple[MarkerCapsule, ...]
    mask: NDArray[np.bool_]
    around: NDArray[np.bool_]


def find_markers(volume: Volume, intensities: TissueIntensities, limb: NDArray[np.bool_]) -> FoundMarkers:
    """Find and number bright, compact objects on the skin.

    They are numbered from distal to proximal; those at the same height (within 5 mm) by their angle about the
    centre of the limb, from anterior over the patient's left and posterior to the right. Slightly to the
    right of anterior still counts as anterior, so that a marker placed in front keeps its number.

    volume : image with k along the limb towards proximal
    intensities : its normalised values
    limb : everything that stands out from the air, with or without markers
    """
    spacing = volume.spacing
    body = _body(limb, spacing)
    height = np.full(limb.shape, _AWAY)
    if body.any():
        window = box_around(body, np.ceil(_AWAY / spacing))
        height[window] = distance_to(body[window], spacing)
    bright = (intensities.values > 0.5 * intensities.fat) & (height > 0) & (height < _AWAY)
    parts, n_parts = ndimage.label(bright, np.ones((3, 3, 3), bool))
    kept = np.zeros(limb.shape, bool)
    centres, sizes = [], []
    if n_parts:
        volumes = np.bincount(parts.ravel(), minlength=n_parts + 1) * volume.voxel_volume
        for number, box in enumerate(ndimage.find_objects(parts), 1):
            extent = [(s.stop - s.start) * h for s, h in zip(box, spacing, strict=True)]
            low, high = MARKER_SIZES_MM3
            right_size = low <= volumes[number] <= high and max(extent) <= _LONGEST
            if not right_size or height[box][parts[box] == number].max() < _PROUD:
                continue
            here = parts == number
            kept |= here
            weight = intensities.values * here
            centres.append(ndimage.center_of_mass(weight))
            sizes.append(float(volumes[number]))
    positions = volume.to_patient(np.array(centres).reshape(-1, 3))
    around = is_near(kept, BLUR_MM, spacing) & ~body
    return FoundMarkers(number_markers(positions, np.array(sizes), volume, body), kept, around)


def number_markers(
    positions: Array, sizes: Array, volume: Volume, body: NDArray[np.bool_]
) -> tuple[MarkerCapsule, ...]:
    """Number markers from distal to proximal, then by angle."""
    if not len(positions):
        return ()
    axis = volume.affine[:3, 2] / volume.spacing[2]
    heights = positions @ axis
    middle = np.array([_centre(body, volume, each) for each in positions])
    outward = positions - middle
    angles = (np.degrees(np.arctan2(outward[:, 0], -outward[:, 1])) + _IN_FRONT) % 360.0
    order = np.argsort(heights)
    group, groups = 0, np.zeros(len(positions), int)
    for before, after in pairwise(order):
        group += heights[after] - heights[before] > _SAME_HEIGHT
        groups[after] = group
    ranked = sorted(range(len(positions)), key=lambda n: (groups[n], angles[n]))
    return tuple(
        MarkerCapsule(number, tuple(float(x) for x in positions[n]), float(sizes[n]))  # type: ignore[arg-type]
        for number, n in enumerate(ranked, 1)
    )


def _body(limb: NDArray[np.bool_], spacing: Array) -> NDArray[np.bool_]:
    """The limb without small objects on its surface; computed on a coarse grid, for speed."""
    step = np.maximum(1, np.floor(1.5 / spacing)).astype(int)
    window = box_around(limb, 1 + np.ceil(4.0 / spacing))
    fine = limb[window]
    coarse = fine[:: step[0], :: step[1], :: step[2]]
    grid = spacing * step
    pad = [(0, 0), (0, 0), (int(np.ceil(_BALL / grid[2])) + 1,) * 2]
    wide = np.pad(coarse, pad, mode="edge")
    core = distance_to(~wide, grid) > _BALL
    near = distance_to(core, grid) - _BALL
    near = near[:, :, pad[2][0] : wide.shape[2] - pad[2][1]]
    at = [np.clip(np.arange(n) / s, 0, m - 1) for n, s, m in zip(fine.shape, step, near.shape, strict=True)]
    # Interpolation can only change the answer where the corners of a cell of the coarse grid disagree.
    cell = np.ix_(*(each.astype(int) for each in at))
    inside = (near <= 0).astype(np.int8)
    beyond = {"size": 2, "origin": -1, "mode": "nearest"}
    found = fine & (ndimage.maximum_filter(inside, **beyond)[cell] > 0)
    mixed = np.nonzero(found & (ndimage.minimum_filter(inside, **beyond)[cell] == 0))
    places = [each[index] for each, index in zip(at, mixed, strict=True)]
    found[mixed] = ndimage.map_coordinates(near, places, order=1) <= 0
    body = np.zeros_like(limb)
    body[window] = found
    return body


def _centre(body: NDArray[np.bool_], volume: Volume, position: Array) -> Array:
    """Centre of the limb's section at the height of a position, patient LPS."""
    k = int(np.clip(np.round(volume.to_voxel(position[None])[0, 2]), 0, body.shape[2] - 1))
    section = body[:, :, k] if body[:, :, k].any() else body.any(axis=2)
    i, j = ndimage.center_of_mass(section)
    return volume.to_patient(np.array([[i, j, k]]))[0]
