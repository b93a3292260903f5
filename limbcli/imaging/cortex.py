"""Cortical bone: the dark shell around marrow, up to where the signal rises again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.imaging.intensity import TissueIntensities
from limbcli.imaging.signed_distance import box_around, closed, distance_to, ellipse, evened, is_near, opened
from limbcli.model import Array

_THICKEST = 14.0  # largest thickness of cortex, mm (the tibial crest)
_LINE = 1.3  # mm: dark lines (fascia, membranes) thinner than twice this are not bone
_NOTCH = 2.0  # mm: notches narrower than twice this are filled
_CAP = 8.0  # mm: largest extent of cortex beyond the last slice with marrow
_EDGE = (0.8, 1.2)  # bounds of the tissue signal next to the bone, muscle = 1
_NEARBY = 1.5  # mm: radius within which the tissue signal next to the bone is taken
_THIN = 2.5  # mm: a local minimum of the signal farther from the marrow is not cortex
_WALL = 0.75  # signal, muscle = 1: without any darker value there is no cortical wall


def with_cortex(
    marrow: NDArray[np.bool_], intensities: TissueIntensities, limb: NDArray[np.bool_], spacing: Array
) -> NDArray[np.bool_]:
    """A whole bone: marrow, the dark cortex around it, and the caps at its ends.

    The outer edge lies where the signal reaches half that of the adjacent tissue. Dark lines that branch off
    (fascia, interosseous membrane, tendons) are removed by a morphological opening.
    """
    in_plane = spacing[:2]
    values = ndimage.gaussian_filter(intensities.values, [0.25 / spacing[0], 0.25 / spacing[1], 0])
    # Darker than half the nearby tissue; in a local minimum, which also detects a wall thinner than a voxel,
    # whose edge is half way between its own minimum and the tissue.
    footprint = ellipse(*(max(1, round(_NEARBY / each)) for each in in_plane))
    beside = np.clip(ndimage.grey_dilation(values, footprint=footprint), *_EDGE)
    darkest = np.clip(ndimage.grey_erosion(values, footprint=footprint), 0.0, None)
    dark = (values < 0.5 * beside) & limb
    dip = (values < 0.5 * (beside + darkest)) & (darkest < _WALL) & limb
    bone = np.zeros_like(marrow)
    slices = np.flatnonzero(marrow.any(axis=(0, 1)))
    for k in slices.tolist():
        box = box_around(marrow[:, :, k], np.ceil((_THICKEST + 2.0) / in_plane))
        part: tuple[slice | int, ...] = (*box, k)
        here = marrow[part]
        radius = np.sqrt(here.sum() * np.prod(in_plane) / np.pi)
        outside = distance_to(here, in_plane)
        wall = (dark[part] & (outside < min(_THICKEST, 4.0 + 1.2 * radius))) | (dip[part] & (outside < _THIN))
        rim = (outside < 0.6) & (values[part] < intensities.between)
        whole = opened(ndimage.binary_fill_holes(here | wall | rim), _LINE, in_plane) | here
        parts, _ = ndimage.label(whole)
        kept = np.bincount(parts[here], minlength=2)
        kept[0] = 0
        bone[part] = closed(parts == kept.argmax(), _NOTCH, in_plane)
    _add_caps(bone, dark, (int(slices[0]), int(slices[-1])), spacing)
    return evened(bone, spacing)


def _add_caps(
    bone: NDArray[np.bool_], dark: NDArray[np.bool_], ends: tuple[int, int], spacing: Array
) -> None:
    """Add solid cortex beyond the last slice with marrow: a dark disc over the bone's last section."""
    n_most = int(np.ceil(_CAP / spacing[2]))
    for k_end, direction in ((ends[0], -1), (ends[1], 1)):
        before = bone[:, :, k_end]
        for k in range(k_end + direction, k_end + direction * (n_most + 1), direction):
            if not 0 <= k < bone.shape[2]:
                break
            near = is_near(before, 1.0, spacing[:2])
            disc = opened(ndimage.binary_fill_holes(dark[:, :, k] & near), 1.5, spacing[:2])
            if disc.sum() * np.prod(spacing[:2]) < 8.0:
                break
            bone[:, :, k] = before = disc
