"""Check that a label map lies where the image lies on which it was drawn.

A label map has its own geometry. Exported without it, or with that of another image, it still yields a limb,
but of another size and position; only the image can reveal this.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.errors.problems import Problem
from limbcli.imaging.limbs import upright
from limbcli.imaging.nifti import SAME_PLACE
from limbcli.imaging.segmentation import BONE, FAT, SOFT_TISSUE
from limbcli.imaging.signed_distance import filled_by_slice
from limbcli.imaging.skin_segmentation import background_threshold
from limbcli.imaging.volume import Volume
from limbcli.model import Array

# Dice overlap of the limb and the bright part of the image: warning below the first, error below the second
_AGREE = (0.9, 0.75)
_BEYOND = 0.05  # largest fraction of the limb's voxels outside the image
_MOST_VOXELS = 4e6  # largest number of voxels that are compared
_HU_AIR = -300.0  # HU; below all tissue on CT
_FIX = "export the label map again with the MRI series as its reference volume, or remove [imaging] mri"


def frame_problems(labels: Volume, image: Volume, *, where: str, up_to_skin: bool = True) -> list[Problem]:
    """What is wrong with the position and size of a label map, compared with those of its image.

    On the image's own grid nothing further is checked. A grid of equal matrix size but other position or
    voxel size is an error. Any other grid is used with its own position in the patient frame, and must cover
    the bright part of the image.

    up_to_skin : whether the labels contain the whole limb; without, the bright part is not compared
    """
    if same_grid(labels, image):
        return []
    if sorted(labels.shape) == sorted(image.shape):
        off = np.linalg.norm(_middle(labels) - _middle(image))
        what = (
            f"the label map has the MRI's matrix but a different position: voxels {_size(labels.spacing)} "
            f"mm, not {_size(image.spacing)} mm; middle {off:.1f} mm off"
        )
        return [Problem(what, where, _FIX)]
    limb = np.isin(labels.values, (SOFT_TISSUE, BONE, FAT))
    # fraction of the limb's voxels (a sample) that lie outside the image by more than a voxel
    index = np.argwhere(limb)
    index = index[:: max(1, len(index) // 100_000)]
    at = image.to_voxel(labels.to_patient(index.astype(float)))
    outside = (at < -1.5).any(axis=1) | (at > np.array(image.shape) + 0.5).any(axis=1)
    beyond = float(outside.mean())
    if beyond > _BEYOND:
        return [Problem(f"{beyond:.0%} of the label map's limb lies outside the MRI series", where, _FIX)]
    overlap = _overlap(labels, limb, image) if up_to_skin else 1.0
    if overlap >= _AGREE[0]:
        return []
    what = f"the label map's limb and the limb in the MRI overlap by only {overlap:.0%} (Dice)"
    return [Problem(what, where, _FIX, severity="error" if overlap < _AGREE[1] else "warning")]


def in_order_of(labels: Volume, image: Volume) -> Volume:
    """The image with its axes in the label map's order and direction; both have the same voxels.

    >>> values = np.arange(6).reshape(3, 2, 1)
    >>> turned = Volume(values[::-1], np.array([[-1.0, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]))
    >>> np.array_equal(in_order_of(Volume(values, np.eye(4)), turned).values, values)
    True
    """
    ours = np.linalg.solve(labels.affine[:3, :3], image.affine[:3, :3])
    order = np.abs(ours).argmax(axis=1)
    values = np.transpose(image.values, order)
    back = tuple(axis for axis in range(3) if ours[axis, order[axis]] < 0)
    return labels.with_values(np.flip(values, back))


def _size(spacing: Array) -> str:
    return " x ".join(f"{each:.3g}" for each in spacing)


def _corners(volume: Volume) -> Array:
    """Centres (8, 3) of the corner voxels in patient LPS."""
    ends = np.stack(np.meshgrid(*([0, n - 1] for n in volume.shape), indexing="ij"), axis=-1).reshape(-1, 3)
    return volume.to_patient(ends)


def _middle(volume: Volume) -> Array:
    return np.asarray(_corners(volume).mean(axis=0), dtype=np.float64)


def same_grid(labels: Volume, image: Volume) -> bool:
    """Same voxels, in any order of the axes: each corner is within half a voxel of a corner of the other."""
    if sorted(labels.shape) != sorted(image.shape):
        return False
    apart = np.linalg.norm(_corners(labels)[:, None] - _corners(image)[None], axis=2)
    nearest = apart.argmin(axis=1)
    return bool(
        apart.min(axis=1).max() < SAME_PLACE * image.spacing.min() and len(set(nearest)) == len(nearest)
    )


def _overlap(labels: Volume, limb: NDArray[np.bool_], image: Volume) -> float:
    """Dice overlap of the label map's limb with the bright parts of the image that it meets.

    Only the slices that the label map fills count. The image is sampled at the label map's voxels, subsampled
    if there are many.
    """
    turned, order, flipped = labels.along_limb()
    limb = np.transpose(limb, order)
    limb = limb[:, :, ::-1] if flipped else limb
    every = max(1, int(np.ceil((limb.size / _MOST_VOXELS) ** (1 / 3))))
    mask = limb[::every, ::every, ::every]
    index = np.argwhere(np.ones(mask.shape, bool)) * every
    at = image.to_voxel(turned.to_patient(index.astype(float))).T
    image = image if image.values.min() < _HU_AIR else upright(image)[0]
    level = _HU_AIR if image.values.min() < _HU_AIR else background_threshold(image.values)
    sampled = ndimage.map_coordinates(
        image.values.astype(np.float32), at, order=1, mode="constant", cval=float(image.values.min())
    )
    bright = filled_by_slice(sampled.reshape(mask.shape) > level)
    parts, n_parts = ndimage.label(bright)
    if n_parts == 0:
        return 0.0
    met = np.bincount(parts[mask], minlength=n_parts + 1)
    met[0] = 0
    ours = bright & (met > 0.02 * mask.sum())[parts]
    filled = mask.any(axis=(0, 1))
    both = (mask & ours)[:, :, filled].sum()
    return float(2 * both / max(mask.sum() + ours[:, :, filled].sum(), 1))
