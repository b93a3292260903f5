"""Automatic segmentation of a limb on T1 MRI: skin, bones, markers.

Nothing is learned from data; the anatomy's plain facts are used. Air is dark, skin
encloses everything, muscle and fat have two levels under a slow shading, bone is bright
marrow in a dark shell that continues along the limb, markers are bright and stand proud
of the skin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.imaging.cortex import with_cortex
from limbcli.imaging.intensity import Levels, normalise
from limbcli.imaging.markers import Marker, find_markers
from limbcli.imaging.marrow import find_marrow
from limbcli.imaging.outline import rough_outline, skin_outline
from limbcli.imaging.volume import Volume, back
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

SOFT_TISSUE, BONE, MARKER, FAT = 1, 2, 3, 4
_FINEST = 1.0  # mm: coarser images are worked on at twice (or more) their resolution
_PARTS = 6


@dataclass(frozen=True, eq=False)
class Segmentation:
    """What was found, on the image's own grid, and finer where the image is coarse.

    labels : Volume of uint8 on the image's grid: 0 outside, 1 soft tissue, 2 bone, 3 marker
    skin : Volume of bool on the working grid (k along the limb)
    bones : one Volume of bool per bone, largest first
    markers : numbered capsules
    levels : normalised image on the working grid, or None where labels were given
    """

    labels: Volume
    skin: Volume
    bones: tuple[Volume, ...]
    markers: tuple[Marker, ...] = ()
    levels: Levels | None = None


def segment_limb(
    image: Volume, *, threshold: float | None = None, seeds: Array | None = None, progress: Progress = SILENT
) -> Segmentation:
    """Skin, bones and markers of a limb.

    Parameters
    ----------
    image : T1-weighted image of one limb, any orientation
    threshold : signal between air and skin; None finds it
    seeds : patient LPS (n, 3), mm, points in marrow of bones to add

    Returns
    -------
    Segmentation

    Raises
    ------
    CaseError
        If no limb stands out from the background.
    """

    def tell(done: int) -> None:
        progress.event("task", name="segmenting", done=done, total=_PARTS)

    turned, order, flipped = image.along_limb()
    work, factor = supersampled(turned)
    rough = rough_outline(work, threshold=threshold)
    tell(1)
    levels = normalise(work, rough)
    tell(2)
    found = find_markers(work, levels, rough)
    tell(3)
    limb = skin_outline(work, levels, rough, without=found.around)
    tell(4)
    points = None if seeds is None else work.to_voxel(seeds)
    marrow = find_marrow(levels, limb, work.spacing, seeds=points)
    tell(5)
    bones = [with_cortex(each, levels, limb, work.spacing) & limb for each in marrow]
    labels = np.where(limb, SOFT_TISSUE, 0).astype(np.uint8)
    for bone in bones:
        labels[bone] = BONE
    labels[found.mask & ~limb] = MARKER
    tell(_PARTS)
    return Segmentation(
        labels=image.with_values(back(_coarse(labels, factor), order, flipped)),
        skin=work.with_values(limb),
        bones=tuple(work.with_values(bone) for bone in bones),
        markers=found.markers,
        levels=levels,
    )


def supersampled(volume: Volume) -> tuple[Volume, int]:
    """The image on a grid of at most 1 mm within the slices; returns it and the factor.

    >>> fine, factor = supersampled(Volume(np.zeros((4, 4, 3)), np.diag([2.0, 2.0, 5.0, 1.0])))
    >>> factor, fine.shape, fine.affine[0]
    (2, (8, 8, 3), array([ 1. ,  0. ,  0. , -0.5]))
    """
    factor = int(np.ceil(volume.spacing[:2].max() / _FINEST - 1e-6))
    if factor == 1:
        return volume, 1
    values = ndimage.zoom(
        volume.values.astype(np.float32), (factor, factor, 1), order=3, mode="nearest", grid_mode=True
    )
    affine = volume.affine.copy()
    shift = -(factor - 1) / (2 * factor)
    affine[:3, 3] += (affine[:3, 0] + affine[:3, 1]) * shift
    affine[:3, :2] /= factor
    return Volume(values, affine), factor


def _coarse(labels: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """Each voxel takes the label that fills most of it."""
    if factor == 1:
        return labels
    a, b, c = labels.shape
    blocks = labels.reshape(a // factor, factor, b // factor, factor, c)
    shares = [(blocks == value).mean(axis=(1, 3)) for value in (0, SOFT_TISSUE, BONE, MARKER)]
    return np.argmax(shares, axis=0).astype(np.uint8)
