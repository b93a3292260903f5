"""Cortex: the dark shell around marrow, up to where the signal rises again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.imaging.fields import box_around, closed, evened, opened
from limbcli.imaging.intensity import Levels
from limbcli.model import Array

_THICKEST = 14.0  # mm, the tibial crest
_LINE = 1.3  # mm: dark lines (fascia, membranes) thinner than twice this are no bone
_NOTCH = 2.0  # mm: notches narrower than twice this are filled
_CAP = 8.0  # mm: cortex beyond the last slice with marrow
_EDGE = (0.8, 1.4)  # bounds of the tissue level beside the bone, muscle = 1
_HALF = 0.5  # of the tissue beside the bone


def with_cortex(
    marrow: NDArray[np.bool_], levels: Levels, limb: NDArray[np.bool_], spacing: Array
) -> NDArray[np.bool_]:
    """A whole bone: marrow, the dark cortex round it, and the caps at its ends.

    The outer edge lies where the signal reaches half of the tissue's beside it. Dark
    lines that run off (fascia, interosseous membrane, tendons) are cut by an opening.
    """
    in_plane = spacing[:2]
    values = ndimage.gaussian_filter(levels.values, [0.25 / spacing[0], 0.25 / spacing[1], 0])
    dark = _dark(values, limb, spacing)
    bone = np.zeros_like(marrow)
    slices = np.flatnonzero(marrow.any(axis=(0, 1)))
    for k in slices.tolist():
        here = marrow[:, :, k]
        window = box_around(here, np.ceil((_THICKEST + 2.0) / in_plane))
        section, wall = values[:, :, k][window], dark[:, :, k][window]
        bone[:, :, k][window] = _shell(here[window], section, wall, levels, in_plane)
    _add_caps(bone, dark, (int(slices[0]), int(slices[-1])), spacing)
    return evened(bone, spacing)


def _dark(values: NDArray[np.float32], limb: NDArray[np.bool_], spacing: Array) -> NDArray[np.bool_]:
    reach = [max(1, round(1.5 / each)) for each in spacing[:2]]
    x, y = np.mgrid[-reach[0] : reach[0] + 1, -reach[1] : reach[1] + 1]
    footprint = ((x / reach[0]) ** 2 + (y / reach[1]) ** 2 <= 1)[:, :, None]
    beside = ndimage.grey_dilation(values, footprint=footprint)
    return (values < _HALF * np.clip(beside, *_EDGE)) & limb


def _shell(
    marrow: NDArray[np.bool_],
    values: NDArray[np.float32],
    dark: NDArray[np.bool_],
    levels: Levels,
    spacing: Array,
) -> NDArray[np.bool_]:
    """Marrow and cortex in one slice."""
    radius = np.sqrt(marrow.sum() * np.prod(spacing) / np.pi)
    outside = ndimage.distance_transform_edt(~marrow, sampling=spacing)
    wall = dark & (outside < min(_THICKEST, 4.0 + 1.2 * radius))
    rim = (outside < 0.6) & (values < levels.between)
    whole = opened(ndimage.binary_fill_holes(marrow | wall | rim), _LINE, spacing) | marrow
    parts, _ = ndimage.label(whole)
    kept = np.bincount(parts[marrow], minlength=2)
    kept[0] = 0
    return closed(parts == kept.argmax(), _NOTCH, spacing)


def _add_caps(
    bone: NDArray[np.bool_], dark: NDArray[np.bool_], ends: tuple[int, int], spacing: Array
) -> None:
    """Solid cortex beyond the last marrow: a dark disc over the bone's last section."""
    n_most = int(np.ceil(_CAP / spacing[2]))
    for k_end, direction in ((ends[0], -1), (ends[1], 1)):
        before = bone[:, :, k_end]
        for k in range(k_end + direction, k_end + direction * (n_most + 1), direction):
            if not 0 <= k < bone.shape[2]:
                break
            near = ndimage.distance_transform_edt(~before, sampling=spacing[:2]) <= 1.0
            disc = opened(ndimage.binary_fill_holes(dark[:, :, k] & near), 1.5, spacing[:2])
            if disc.sum() * np.prod(spacing[:2]) < 8.0:
                break
            bone[:, :, k] = before = disc
