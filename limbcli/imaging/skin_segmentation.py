"""Outline of the limb: everything inside the skin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.errors import CaseError
from limbcli.imaging.intensity import TissueIntensities, otsu
from limbcli.imaging.signed_distance import ellipse, evened, filled_by_slice, is_near, largest, opened
from limbcli.imaging.volume import Volume

_ROUGH = 0.33  # fraction of Otsu's threshold that skin (darker than muscle on T1) still exceeds
_SKIN = (0.35, 0.45)  # bounds of the skin edge's threshold, muscle = 1
_NOISE = 0.8  # the skin edge's threshold is at least this fraction of the background threshold
_GHOST = 4.0  # mm: thinner structures outside the limb are ghosts of vessels
_BRIGHTEST = 0.02  # fraction of the image: a brighter group of voxels that is smaller is not the limb
_AIR = 0.02  # smallest fraction of the image that is air
_CONTRAST = 2.0  # smallest ratio of the signal of the limb to that of air
_LEAST_VOLUME = 5e4  # smallest volume of a limb, mm^3


def rough_outline(volume: Volume, *, threshold: float | None = None) -> NDArray[np.bool_]:
    """The limb without distinguishing its tissues: the largest component above the air, filled.

    Raises CaseError if nothing as large as a limb stands out from the background.
    """
    values = _blurred(volume)
    level = background_threshold(values) if threshold is None else threshold
    mask = largest(values > level)
    mask = filled_by_slice(mask)
    size = float(mask.sum() * volume.voxel_volume)
    inside, outside = values[mask], values[~mask]
    enough_air = len(outside) > _AIR * values.size
    large = size >= _LEAST_VOLUME
    stands_out = large and enough_air and np.median(inside) > _CONTRAST * np.median(outside)
    if not stands_out:
        raise CaseError(
            f"no limb can be separated from the background (largest part {size / 1e3:.0f} cm3)",
            where="MRI series",
            fix="check that the series shows the limb; else give --threshold, a label map or surfaces",
        )
    return mask


def background_threshold(values: NDArray) -> float:
    """A threshold between the signal of air and that of skin.

    A limb fills more of an image than `_BRIGHTEST`: brighter but smaller structures (an implant's rim, a
    coil's bright spot, markers) are ignored.
    """
    sample = values[::2, ::2, ::2].ravel()
    below = sample[sample <= np.percentile(sample, 99.5)]
    split = otsu(below)
    few = _BRIGHTEST * len(sample)
    while (below > split).sum() < few < (below < split).sum():
        below = below[below <= split]
        split = otsu(below)
    air = sample[sample < _ROUGH * split]
    noise = 1.4826 * np.median(np.abs(air - np.median(air))) if len(air) else 0.0
    return float(max(_ROUGH * split, np.median(air) + 4 * noise if len(air) else 0.0))


def skin_outline(
    volume: Volume,
    intensities: TissueIntensities,
    rough: NDArray[np.bool_],
    *,
    without: NDArray[np.bool_] | None = None,
    threshold: float | None = None,
) -> NDArray[np.bool_]:
    """The limb, with its edge where the signal is half that of the outermost tissue.

    Skin is a grey band of 1 to 2 mm on T1, darker than muscle; its outer edge is used. `without` is excluded
    (skin markers); a `threshold` (image units) replaces the edge's own level. Ghosts of pulsating vessels
    next to the limb are removed, and the edge is smoothed in its distance field.
    """
    raw = _blurred(volume)
    values = _blurred(volume.with_values(intensities.values))
    reach = [max(1, round(1.0 / each)) for each in volume.spacing[:2]]
    beside = ndimage.grey_dilation(values, footprint=ellipse(*reach))
    near = is_near(rough, 1.0, np.array([*(1 / (3 * n) for n in reach), 2.0]))  # within the slices
    if threshold is not None:
        above = (raw > threshold) & near
    else:
        edge = np.clip(0.5 * beside, *_SKIN)
        above = (values > edge) & (raw > _NOISE * background_threshold(raw)) & near
    if without is not None:
        above &= ~without
    mask = filled_by_slice(largest(above))
    for k in range(mask.shape[2]):
        mask[:, :, k] = opened(mask[:, :, k], _GHOST, volume.spacing[:2])
    return evened(filled_by_slice(largest(mask)), volume.spacing)


def _blurred(volume: Volume) -> NDArray[np.float32]:
    sigma = 0.4 / volume.spacing
    sigma[2] = 0.0
    return ndimage.gaussian_filter(volume.values.astype(np.float32), sigma)
