"""Whether a label map that names nothing can be in our numbers: 1 soft tissue, 2 bone, 3 marker, 4 fat.

Other programs number from 1, too. A map of theirs (1 muscle, 2 fat, 3 bone) then gives a limb of the right
size with fat for its bone, so what the numbers would mean is compared with how a limb is built.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.imaging.markers import MARKER_SIZES_MM3
from limbcli.imaging.segmentation import BONE, FAT, MARKER, SOFT_TISSUE
from limbcli.imaging.signed_distance import distance_to, filled_by_slice
from limbcli.imaging.volume import Volume

_MOST = 0.5  # fraction of a tissue that may lie where it does not belong


def unnamed_label_doubts(labels: Volume) -> list[str]:
    """What contradicts our numbers, a clause for each; empty if a limb can be so.

    labels : whole numbers, in patient LPS

    >>> radius = np.hypot(*np.mgrid[-9:10, -9:10])[:, :, None] + np.zeros(3)
    >>> unnamed_label_doubts(Volume(np.select([radius < 3, radius < 8], [2, 1]), np.eye(4)))
    []
    >>> unnamed_label_doubts(Volume(np.select([radius < 3, radius < 8], [1, 2]), np.eye(4)))
    ['the soft tissue (1, 4) would lie within the bone (2)', 'the bone (2) would lie outside the soft tissue']
    """
    turned, _, _ = labels.along_limb()
    values = turned.values
    flesh, bone, marker = np.isin(values, (SOFT_TISSUE, FAT)), values == BONE, values == MARKER
    around = filled_by_slice(flesh)
    limb = filled_by_slice(flesh | bone)
    seen = limb.any(axis=(0, 1))  # the slices that the limb reaches
    doubts = []
    if _share(flesh, filled_by_slice(bone)) > _MOST:
        doubts.append("the soft tissue (1, 4) would lie within the bone (2)")
    if flesh.any() and _share(bone & around.any(axis=(0, 1)), ~around) > _MOST:
        doubts.append("the bone (2) would lie outside the soft tissue")
    parts, _ = ndimage.label(marker, np.ones((3, 3, 3), bool))
    largest = float(np.bincount(parts.ravel())[1:].max(initial=0) * turned.voxel_volume)
    if largest > MARKER_SIZES_MM3[1]:
        doubts.append(f"a skin marker (3) would have {largest / 1e3:.3g} cm3")
    elif _share(marker & seen, limb) > _MOST:
        doubts.append("the skin markers (3) would lie within the limb")
    depth = distance_to(~limb, turned.spacing)
    if (values == FAT).any() and (values == SOFT_TISSUE).any():
        fat, soft = (float(np.median(depth[values == each])) for each in (FAT, SOFT_TISSUE))
        if fat > soft:
            doubts.append(f"the fat (4) would lie {fat:.0f} mm deep, the other soft tissue (1) {soft:.0f} mm")
    return doubts


def _share(part: NDArray[np.bool_], where: NDArray[np.bool_]) -> float:
    """The fraction of a part that lies there."""
    return float((part & where).sum() / max(part.sum(), 1))
