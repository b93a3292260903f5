"""Segment fat, distinguished from muscle by its signal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.imaging.intensity import TissueIntensities
from limbcli.imaging.signed_distance import depth_inside
from limbcli.imaging.volume import Volume

_LEAST_CONTRAST = 1.5  # smallest ratio of the signal of fat to that of muscle
_DEEP = 12.0  # mm: deeper than this below the skin there is mostly muscle, ...
_DEEP_IS_MUSCLE = 0.35  # ... so the median signal there must equal that of muscle within this
_LEAST_PART = 100.0  # mm^3: smaller specks of fat are counted as muscle


def fat_of(
    intensities: TissueIntensities, limb: NDArray[np.bool_], bone: NDArray[np.bool_], volume: Volume
) -> NDArray[np.bool_] | None:
    """Voxels of fat: signal closer to that of fat than to that of muscle, outside bone.

    None if fat and muscle cannot be distinguished (contrast below 1.5, or within noise).
    """
    if intensities.fat < _LEAST_CONTRAST or intensities.fat - 1.0 < 4.0 * intensities.noise:
        return None
    within_slices = [volume.spacing[0], volume.spacing[1], 1e6]
    deep = depth_inside(limb, np.array(within_slices)) > _DEEP
    core = intensities.values[deep & ~bone]
    if not len(core) or abs(float(np.median(core)) - 1.0) > _DEEP_IS_MUSCLE:
        return None
    sigma = [0.5 / volume.spacing[0], 0.5 / volume.spacing[1], 0.0]
    smooth = ndimage.gaussian_filter(intensities.values, sigma)
    fat = (smooth > intensities.between) & limb & ~bone
    parts, n_parts = ndimage.label(fat)
    sizes = np.bincount(parts.ravel(), minlength=n_parts + 1) * volume.voxel_volume
    sizes[0] = 0.0
    return np.asarray(sizes[parts] >= _LEAST_PART)
