"""Signed distance fields of masks: the smooth representation from which labels and surfaces are made."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.model import Array

REACH = 8.0  # mm: distances are clipped to this
_EVENED_BY = 0.5  # mm, standard deviation of the Gaussian that smooths an edge
_ANISOTROPIC = 1.6  # slices thicker than pixels by this factor are processed slice by slice


def signed_distance(mask: NDArray[np.bool_], spacing: Array) -> NDArray[np.float32]:
    """Distance to the mask's edge, positive inside, clipped to `REACH` mm either way.

    With thick slices the distance is computed within each slice, so that linear interpolation between slices
    gives an intermediate shape (shape-based interpolation, Raya and Udupa 1990, IEEE TMI 9:32).

    >>> mask = np.zeros((5, 5, 1), bool); mask[1:4, 1:4] = True
    >>> signed_distance(mask, np.array([1.0, 1.0, 5.0]))[2, :, 0]
    array([-0.5,  0.5,  1.5,  0.5, -0.5], dtype=float32)
    """
    spacing = np.asarray(spacing, dtype=float)
    if spacing[2] <= _ANISOTROPIC * spacing[:2].max():
        return _distance(mask, spacing)
    field = np.full(mask.shape, -REACH, np.float32)
    for k in np.flatnonzero(mask.any(axis=(0, 1))):
        window = box_around(mask[:, :, k], np.ceil((REACH + spacing[:2].min()) / spacing[:2]))
        here: tuple[slice | int, ...] = (*window, int(k))
        field[here] = _distance(mask[here], spacing[:2])
    return field


def distance_to(mask: NDArray[np.bool_], spacing: Array) -> Array:
    """Distance of every voxel to the nearest one of a mask, mm; inf if the mask is empty.

    >>> distance_to(np.array([[True, False, False]]), np.array([3.0, 2.0]))
    array([[0., 2., 4.]])
    """
    if not mask.any():
        return np.full(mask.shape, np.inf)
    return np.asarray(ndimage.distance_transform_edt(~mask, sampling=spacing))


def depth_inside(mask: NDArray[np.bool_], spacing: Array) -> Array:
    """Distance of a mask's voxels to the nearest voxel outside it, mm; 0 outside.

    Only the mask's box and one voxel around are looked at: the nearest voxel outside is never farther off.

    >>> depth_inside(np.array([[0, 0, 1, 1, 1]], bool), np.array([1.0, 2.0]))
    array([[0., 0., 2., 4., 6.]])
    """
    found = np.zeros(mask.shape)
    if mask.any():
        window = box_around(mask, 1)
        found[window] = distance_to(~mask[window], spacing)
    return found


def is_near(mask: NDArray[np.bool_], reach: float, spacing: Array) -> NDArray[np.bool_]:
    """Voxels within `reach` mm of a mask's; none if it is empty.

    >>> is_near(np.array([[0, 0, 0, 1, 0]], bool), 2.0, np.array([1.0, 2.0]))
    array([[False, False,  True,  True,  True]])
    """
    found = np.zeros(mask.shape, bool)
    if mask.any():
        window = box_around(mask, np.ceil(reach / np.asarray(spacing)))
        found[window] = distance_to(mask[window], spacing) <= reach
    return found


def _distance(mask: NDArray[np.bool_], spacing: Array) -> NDArray[np.float32]:
    """Distance, positive inside; the edge lies half a voxel from the centres of the adjacent voxels."""
    if not mask.any():
        return np.full(mask.shape, -REACH, np.float32)
    if mask.all():
        return np.full(mask.shape, REACH, np.float32)
    half = 0.5 * float(np.min(spacing))
    inside, outside = distance_to(~mask, spacing), distance_to(mask, spacing)
    return np.clip(np.where(mask, inside - half, half - outside), -REACH, REACH).astype(np.float32)


def evened(mask: NDArray[np.bool_], spacing: Array) -> NDArray[np.bool_]:
    """Smooth rough edges and jumps between slices, in the distance field (Gaussian)."""
    window = box_around(mask, np.ceil(4.0 / spacing))
    sigma = [_EVENED_BY / spacing[0], _EVENED_BY / spacing[1], min(_EVENED_BY, _EVENED_BY / spacing[2])]
    field = ndimage.gaussian_filter(signed_distance(mask[window], spacing), sigma, mode="nearest")
    smooth = np.zeros_like(mask)
    smooth[window] = field > 0
    return smooth


def opened(mask: NDArray[np.bool_], radius: float, spacing: Array) -> NDArray[np.bool_]:
    """Morphological opening with a ball (disc) of `radius` mm; anything thinner is removed.

    >>> bar = np.zeros((9, 9), bool); bar[2:7, 2:7] = True; bar[4, 7:] = True
    >>> opened(bar, 1.5, np.array([1.0, 1.0]))[4]
    array([False, False,  True,  True,  True,  True,  True, False, False])
    """
    return is_near(depth_inside(mask, spacing) > radius, radius, spacing) & mask


def closed(mask: NDArray[np.bool_], radius: float, spacing: Array) -> NDArray[np.bool_]:
    """Morphological closing with a disc of `radius` mm, and filling of holes."""
    pad = int(np.ceil(radius / spacing.min())) + 1
    wide = np.pad(mask, pad)
    shrunk = depth_inside(is_near(wide, radius, spacing), spacing) > radius
    return ndimage.binary_fill_holes(shrunk | wide)[pad:-pad, pad:-pad]


def ellipse(a: int, b: int) -> NDArray[np.bool_]:
    """The neighbours (2 a + 1, 2 b + 1, 1) of a voxel within its slice, a and b voxels away at most."""
    x, y = np.mgrid[-a : a + 1, -b : b + 1]
    return ((x / a) ** 2 + (y / b) ** 2 <= 1.0)[:, :, None]


def largest(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The largest connected component."""
    parts, n_parts = ndimage.label(mask)
    if n_parts <= 1:
        return mask
    return parts == np.bincount(parts.ravel())[1:].argmax() + 1


def filled_by_slice(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Fill holes within each slice along the last axis."""
    out = np.empty_like(mask)
    for k in range(mask.shape[2]):
        parts, n_parts = ndimage.label(~mask[:, :, k])
        is_outside = np.zeros(n_parts + 1, bool)
        for side in (parts[0], parts[-1], parts[:, 0], parts[:, -1]):
            is_outside[side] = True
        is_outside[0] = False  # the mask itself
        out[:, :, k] = ~is_outside[parts]
    return out


def box_around(mask: NDArray[np.bool_], margin: Array | float) -> tuple[slice, ...]:
    """Slices of the mask's bounding box, enlarged by `margin` voxels on every side within the array."""
    axes = range(mask.ndim)
    filled = [np.flatnonzero(mask.any(axis=tuple(each for each in axes if each != axis))) for axis in axes]
    sides = zip(filled, mask.shape, np.broadcast_to(margin, mask.ndim), strict=True)
    return tuple(
        slice(max(0, int(each[0] - more)), int(min(n, each[-1] + 1 + more))) for each, n, more in sides
    )
