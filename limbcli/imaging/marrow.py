"""Bone marrow: bright, enclosed by a dark ring of cortex, and continuous from slice to slice."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.measure import regionprops
from skimage.morphology import disk
from skimage.segmentation import watershed

from limbcli.imaging.intensity import TissueIntensities
from limbcli.imaging.signed_distance import box_around, closed, depth_inside, distance_to, opened
from limbcli.model import Array

_DARK = 0.65  # signal, muscle = 1: cortex is darker, even if blurred because it is thin
_RING = 3.0  # mm: distance within which the ring is searched
_SURE, _LIKELY = 0.75, 0.5  # fraction of the ring that is dark, for a certain and for a likely region
# mean dark fraction of the ring and mean solidity required of a less certain track
_ROUND, _CONVEX = 0.6, 0.85
_LEAST_AREA = 8.0  # smallest area of marrow in a slice, mm^2
_LARGEST = 0.5  # largest fraction of the limb's section that marrow can fill
_LEAST_LENGTH = 12.0  # smallest length of a track along the limb, mm
_FLARE = 1.0  # largest widening of a bone, mm outward per mm along the limb ...
_SLACK = 1.0  # ... plus this, mm
_MUSCLE = 1.25  # signal, muscle = 1: muscle and its noise stay below this


@dataclass(frozen=True, eq=False)
class Candidate:
    """An enclosed bright region in one slice."""

    k: int
    box: tuple[slice, slice]
    mask: NDArray[np.bool_]
    enclosed: float
    solidity: float


def find_marrow(
    intensities: TissueIntensities, limb: NDArray[np.bool_], spacing: Array, *, seeds: Array | None = None
) -> list[NDArray[np.bool_]]:
    """One mask of marrow per bone, largest first.

    A slice in which the dark ring is nearly closed is unambiguous; consecutive slices of this kind form a
    bone. Starting from them, the marrow is tracked through the other slices, where cortex has thinned to a
    faint line, up to its ends.

    intensities, limb : normalised image and limb mask, k along the limb
    spacing : mm
    seeds : voxel indices (n, 3) inside marrow, each a bone of its own or part of one that was found
    """
    smooth = ndimage.gaussian_filter(intensities.values, [0.34 / spacing[0], 0.34 / spacing[1], 0])
    parts = np.zeros(limb.shape, np.int32)
    scores = [(0.0, 0.0)]
    for candidate in _candidates(smooth, intensities, limb, spacing):
        scores.append((candidate.enclosed, candidate.solidity))
        region = parts[*candidate.box, candidate.k]
        region[candidate.mask] = len(scores) - 1
    # Join candidates that are connected along the limb and certain (nearly closed rings in at least 30 % of
    # them), or well enclosed and convex.
    linked, _ = ndimage.label(parts > 0)
    by_number, tracks = np.array(scores), []
    for number, box in enumerate(ndimage.find_objects(linked), 1):
        here = linked[box] == number
        length = (box[2].stop - box[2].start) * spacing[2]
        members = np.unique(parts[box][here])
        members = members[members > 0]
        enclosed, solidity = by_number[members].T
        good = (enclosed >= _SURE).mean() >= 0.3
        good |= enclosed.mean() >= _ROUND and solidity.mean() >= _CONVEX
        if length >= _LEAST_LENGTH and good:
            track = np.zeros(parts.shape, bool)
            track[box] = here
            tracks.append(track)
    for seed in () if seeds is None else np.round(seeds).astype(int):
        if not any(track[tuple(seed)] for track in tracks):
            tracks.append(_planted(smooth, intensities, tuple(seed), spacing))
    grown = [follow(track, smooth, intensities, spacing) for track in tracks]
    return sorted(_apart(grown), key=lambda each: -int(each.sum()))


def _candidates(
    smooth: NDArray[np.float32], intensities: TissueIntensities, limb: NDArray[np.bool_], spacing: Array
) -> Iterator[Candidate]:
    """Bright regions surrounded by dark voxels, within a few mm, over most of their circumference."""
    in_plane = spacing[:2]
    pixel = float(np.prod(in_plane))
    pad = int(np.ceil(_RING / in_plane.min())) + 2
    bright_level = 0.9 * intensities.between
    for k in range(limb.shape[2]):
        under_skin = depth_inside(limb[:, :, k], in_plane) > 1.5
        ring_values = np.where(under_skin, smooth[:, :, k], intensities.fat)
        parts, n_parts = ndimage.label((smooth[:, :, k] > bright_level) & limb[:, :, k])
        sizes = np.bincount(parts.ravel(), minlength=n_parts + 1) * pixel
        for number, box in enumerate(ndimage.find_objects(parts), 1):
            if sizes[number] < _LEAST_AREA:
                continue
            wide = tuple(slice(max(0, s.start - pad), s.stop + pad) for s in box)
            part = parts[wide] == number
            filled = ndimage.binary_fill_holes(part)
            if filled.sum() > 1.4 * part.sum() or filled.sum() > _LARGEST * limb[:, :, k].sum():
                continue
            enclosed = _dark_share(filled, ring_values[wide], in_plane)
            if enclosed >= _LIKELY:
                solidity = float(regionprops(filled.astype(np.uint8))[0].solidity)
                yield Candidate(k, (wide[0], wide[1]), filled, enclosed, solidity)


def _dark_share(mask: NDArray[np.bool_], values: NDArray[np.float32], spacing: Array) -> float:
    """Fraction of a region's edge that has a dark voxel within the width of the ring."""
    distance, nearest = ndimage.distance_transform_edt(~mask, sampling=spacing, return_indices=True)
    band = (distance > 0) & (distance <= _RING)
    edge = nearest[0][band] * mask.shape[1] + nearest[1][band]
    darkest = np.full(mask.size, np.inf)
    np.minimum.at(darkest, edge, values[band])
    on_edge = np.isfinite(darkest)
    return float((darkest[on_edge] < _DARK).mean()) if on_edge.any() else 0.0


def _planted(
    smooth: NDArray[np.float32], intensities: TissueIntensities, seed: tuple[int, ...], spacing: Array
) -> NDArray[np.bool_]:
    """A small disc around a seed given by the user, from which to start tracking."""
    track = np.zeros(smooth.shape, bool)
    i, j = np.indices(smooth.shape[:2])
    near = np.hypot((i - seed[0]) * spacing[0], (j - seed[1]) * spacing[1]) <= 2.0
    track[:, :, seed[2]] = near
    track[:, :, seed[2]] = _next_slice(near, smooth[:, :, seed[2]], intensities, spacing, flare=6.0)
    if not track.any():
        track[:, :, seed[2]] = near
    return track


def follow(
    track: NDArray[np.bool_], smooth: NDArray[np.float32], intensities: TissueIntensities, spacing: Array
) -> NDArray[np.bool_]:
    """Track marrow through the slices between and beyond those of a track."""
    marrow = track.copy()
    known = np.flatnonzero(track.any(axis=(0, 1)))
    middle = int(known[len(known) // 2])
    flare = _FLARE * spacing[2] + _SLACK
    for direction, stop in ((1, track.shape[2]), (-1, -1)):
        for k in range(middle + direction, stop, direction):
            if marrow[:, :, k].any():
                continue
            before = marrow[:, :, k - direction]
            if not before.any():
                break
            marrow[:, :, k] = _next_slice(before, smooth[:, :, k], intensities, spacing, flare=flare)
    return marrow


def _next_slice(
    before: NDArray[np.bool_],
    values: NDArray[np.float32],
    intensities: TissueIntensities,
    spacing: Array,
    *,
    flare: float,
) -> NDArray[np.bool_]:
    """Marrow of one slice from that of its neighbour, by a watershed whose ridge is the line of cortex.

    The inner basin starts from the core of the neighbour's marrow, the outer one from muscle and everything
    farther away than a bone can widen; both flood from bright to dark, with thin dark lines enhanced by a
    black top-hat.
    """
    in_plane = spacing[:2]
    pixels = 1.0 / in_plane.min()
    window = box_around(before, np.ceil((flare + 8.0) / in_plane))
    here, core_of = values[window], before[window]
    outside = distance_to(core_of, in_plane)
    inside = distance_to(~core_of, in_plane)
    line = ndimage.grey_closing(here, footprint=disk(max(1, round(1.5 * pixels)))) - here
    markers = np.zeros(here.shape, np.int32)
    calm = ndimage.gaussian_filter(here, 0.73 * pixels)
    markers[(inside > min(1.5, 0.5 * inside.max())) & (here > intensities.between)] = 1
    markers[outside > flare] = 2
    markers[(here < _MUSCLE) & (calm < _MUSCLE) & (outside > 1.0)] = 2
    found = np.zeros(before.shape, bool)
    if not (markers == 1).any():
        return found
    basin = watershed(line - here, markers) == 1
    bright = opened(basin & (here > 0.9 * intensities.between), 0.9, in_plane)
    parts, n_parts = ndimage.label(bright)
    if n_parts == 0:
        return found
    part = parts == np.bincount(parts[parts > 0]).argmax()
    if part.sum() * np.prod(in_plane) < 0.5 * _LEAST_AREA:
        return found
    found[window] = closed(part, 2.0, in_plane)
    return found


def _apart(bones: list[NDArray[np.bool_]]) -> list[NDArray[np.bool_]]:
    """Merge tracks that have grown into each other into one bone."""
    merged: list[NDArray[np.bool_]] = []
    for bone in bones:
        if not bone.any():
            continue
        touching = [each for each in merged if (each & bone).any()]
        merged = [each for each in merged if not (each & bone).any()]
        for each in touching:
            bone = bone | each
        merged.append(bone)
    return merged
