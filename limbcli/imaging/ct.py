"""Segmentation of a limb on CT by Hounsfield units."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.errors import CaseError
from limbcli.imaging.signed_distance import closed, evened, filled_by_slice, largest, opened
from limbcli.imaging.volume import Volume

_AIR = -350.0  # HU; threshold half way between air and fat or skin
_BONE = 180.0  # HU; cortex and most of the trabecular bone lie above
_FAT = (-190.0, -30.0)  # HU
_SHELL = 2.0  # mm: gaps in the cortex up to twice this are closed
_LEAST_BONE = 1000.0  # mm^3
_TABLE = 6.0  # mm: thinner objects next to the limb (table, mould) are removed


def limb_on_ct(volume: Volume, *, threshold: float | None = None) -> NDArray[np.bool_]:
    """The limb: the largest component above -350 HU (or `threshold`), filled, without thin supports.

    Raises CaseError if the values are not Hounsfield units (air is not near -1000).
    """
    lowest = float(np.percentile(volume.values, 1))
    if lowest > -500.0:
        raise CaseError(
            f"the series is CT, but its air is at {lowest:.0f}, not near -1000 HU",
            where="Rescale Intercept (0028,1052)",
            fix="export the series in Hounsfield units",
        )
    level = _AIR if threshold is None else threshold
    mask = filled_by_slice(largest(volume.values > level))
    for k in range(mask.shape[2]):
        mask[:, :, k] = opened(mask[:, :, k], _TABLE, volume.spacing[:2])
    return evened(filled_by_slice(largest(mask)), volume.spacing)


def bones_on_ct(volume: Volume, limb: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    """Bones with their marrow, largest first: above 180 HU, gaps closed and filled slice by slice."""
    smooth = ndimage.gaussian_filter(volume.values.astype(np.float32), 0.4 / volume.spacing)
    shell = (smooth > _BONE) & limb
    parts, n_parts = ndimage.label(shell)
    sizes = np.bincount(parts.ravel(), minlength=n_parts + 1) * volume.voxel_volume
    bones = []
    for number in np.argsort(-sizes[1:]) + 1:
        if sizes[number] < 0.2 * _LEAST_BONE:
            break
        bone = parts == number
        for k in np.flatnonzero(bone.any(axis=(0, 1))).tolist():
            bone[:, :, k] = closed(bone[:, :, k], _SHELL, volume.spacing[:2])
        if bone.sum() * volume.voxel_volume >= _LEAST_BONE:
            bones.append(evened(bone, volume.spacing) & limb)
    return bones


def fat_on_ct(volume: Volume, limb: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Voxels between -190 and -30 HU inside the limb."""
    smooth = ndimage.gaussian_filter(volume.values.astype(np.float32), 0.5 / volume.spacing)
    return limb & (smooth > _FAT[0]) & (smooth < _FAT[1])
