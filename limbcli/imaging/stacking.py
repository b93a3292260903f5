"""Assemble image planes, in order of height, into one rectangular, evenly spaced `Volume`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import CaseError
from limbcli.imaging.frames import Slice
from limbcli.imaging.volume import Volume
from limbcli.model import Array

_TILT = 0.5  # degrees: a larger shear of the slices is corrected
_BESIDE = 0.5  # pixels: slices farther from the line between the first and the last are shifted onto it
_UNEVEN = 0.02  # relative variation of the slice spacing above which slices are resampled
_NARROW = 10.0  # per cent of the spacings that may be narrower than the one to resample to
_MOST = 10  # at most this many times as many slices
_CHANGED = 1.5  # ratio of spacings above which the spacing changes within the series


def stack(slices: list[Slice], heights: Array, step: float) -> tuple[Volume, tuple[str, ...]]:
    """A Volume indexed [column, row, slice], rectangular and evenly spaced.

    Raises CaseError if two adjacent slices do not overlap in their plane.
    """
    values = np.stack([each.pixels.T for each in slices], axis=2)
    first = slices[0]
    positions = np.array([each.position for each in slices])
    notes = []
    pixel = np.array([first.pixel_spacing[1], first.pixel_spacing[0]])
    in_plane = (positions - positions[0]) @ np.stack([first.along_row, first.along_column], axis=1)
    tilt = np.degrees(np.arctan2(np.linalg.norm(in_plane[-1] - in_plane[0]), heights[-1] - heights[0]))
    beside = np.abs(in_plane - np.outer((heights - heights[0]) / (heights[-1] - heights[0]), in_plane[-1]))
    _within_a_picture(slices, in_plane / pixel)
    origin = first.position
    if tilt > _TILT or (beside / pixel).max() > _BESIDE:
        if tilt > _TILT:
            notes.append(f"the slices are sheared by {tilt:.1f} degrees (gantry tilt); straightened")
        if (beside / pixel).max() > _BESIDE:
            notes.append(
                f"slices lie up to {beside.max():.1f} mm beside the line of the others; straightened"
            )
        values, shift = _straight(values, in_plane / pixel)
        origin = origin - first.along_row * shift[0] * pixel[0] - first.along_column * shift[1] * pixel[1]
        direction = first.normal * (heights[-1] - heights[0]) / (len(slices) - 1)
    else:
        direction = (positions[-1] - positions[0]) / (len(slices) - 1)
    gaps = np.diff(heights)
    if np.abs(gaps / step - 1).max() > _UNEVEN:
        every = _fine_enough(gaps)
        how = "evenly"
        if len(every) > len(slices):
            how = f"every {every[1]:.2f} mm, where they are wide by interpolation"
        notes.append(f"slice distances vary from {gaps.min():.2f} to {gaps.max():.2f} mm; resampled {how}")
        values = _even(values, heights, heights[0] + every)
        direction = direction * (len(slices) - 1) / (len(every) - 1)
    affine = np.eye(4)
    affine[:3, 0] = first.along_row * pixel[0]
    affine[:3, 1] = first.along_column * pixel[1]
    affine[:3, 2] = direction
    affine[:3, 3] = origin
    return Volume(values, affine), tuple(notes)


def _within_a_picture(slices: list[Slice], offset: Array) -> None:
    """Check that adjacent slices overlap; offset: (n, 2), pixels, of every slice from the first."""
    rows, columns = slices[0].pixels.shape
    steps = np.abs(np.diff(offset, axis=0)) / [columns, rows]
    if steps.max() > 1.0:
        k = int(np.argmax(steps.max(axis=1)))
        raise CaseError(
            "two neighbouring slices do not overlap in their plane",
            where=f"{slices[k].name} and {slices[k + 1].name}",
            fix="put each series into a separate folder",
        )


def _straight(values: NDArray[np.float32], offset: Array) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """Shift each slice by its in-plane offset (pixels) on a grid that contains them all.

    Returns the values and the number of pixels by which the grid starts before the first slice.
    """
    from scipy import ndimage

    low = np.floor(np.minimum(offset.min(axis=0), 0)).astype(int)
    high = np.ceil(np.maximum(offset.max(axis=0), 0)).astype(int)
    air = float(values.min())
    padded = np.pad(
        values, [(-low[0], high[0]), (-low[1], high[1]), (0, 0)], mode="constant", constant_values=air
    )
    for k in range(values.shape[2]):
        padded[:, :, k] = ndimage.shift(padded[:, :, k], offset[k], order=1, mode="constant", cval=air)
    return padded, (int(-low[0]), int(-low[1]))


def _fine_enough(gaps: Array) -> Array:
    """Even heights (n,) from 0 to the sum of the gaps, mm.

    They are as many as the slices; where the spacing changes within the series, as close as its narrow part.

    >>> _fine_enough(np.array([2.0, 2.1, 1.9]))
    array([0., 2., 4., 6.])
    >>> _fine_enough(np.array([2.5, 2.5, 7.5]))
    array([ 0. ,  2.5,  5. ,  7.5, 10. , 12.5])
    """
    n, narrow = len(gaps), float(np.percentile(gaps, _NARROW))
    if gaps.max() > _CHANGED * narrow:
        n = max(n, min(round(float(gaps.sum()) / narrow), _MOST * n))
    return np.linspace(0.0, gaps.sum(), n + 1)


def _even(values: NDArray[np.float32], heights: Array, at: Array) -> NDArray[np.float32]:
    """Linear interpolation to the slices at these heights."""
    low = np.clip(np.searchsorted(heights, at, side="right") - 1, 0, len(heights) - 2)
    weight = ((at - heights[low]) / (heights[low + 1] - heights[low])).astype(np.float32)
    return values[:, :, low] * (1 - weight) + values[:, :, low + 1] * weight
