"""Nearest skin point according to the rough outline of an image, to suggest a possible site."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from limbcli.imaging.skin_segmentation import rough_outline
from limbcli.imaging.volume import Volume
from limbcli.model import Array

_GRID = 2.0  # mm: finer grids are subsampled, for speed


class RoughSkin:
    """Boundary voxels of everything that stands out from the air.

    Markers are included, so the skin is off by a marker's height there.
    """

    def __init__(self, image: Volume):
        """Raises CaseError if no limb stands out."""
        turned, _, _ = image.along_limb()
        steps = [max(1, int(_GRID // each)) for each in turned.spacing]
        coarse = turned.affine.copy()
        coarse[:3, :3] = turned.affine[:3, :3] * steps
        thinned = Volume(turned.values[:: steps[0], :: steps[1], :: steps[2]], coarse)
        limb = rough_outline(thinned)
        inner = ndimage.binary_erosion(limb, border_value=1)
        self.points = thinned.to_patient(np.argwhere(limb & ~inner).astype(float))
        self._tree = cKDTree(self.points)

    def nearest(self, point: Array) -> tuple[Array, float]:
        """The nearest boundary point (3,), patient LPS, and its distance, mm."""
        distance, k = self._tree.query(np.asarray(point, float))
        return self.points[k], float(distance)


def reach_of(image: Volume) -> tuple[Array, Array]:
    """Lower and upper corner (3,) of the image's voxels, patient LPS, mm."""
    ends = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)
    corners = image.to_patient(ends * np.array(image.shape) - 0.5)
    return corners.min(axis=0), corners.max(axis=0)


def is_inside(image: Volume, point: Array) -> bool:
    """Whether a point (3,), patient LPS, lies in one of the image's voxels.

    >>> image = Volume(np.zeros((4, 4, 4)), np.eye(4))
    >>> is_inside(image, np.array([3.4, 0.0, -0.4])), is_inside(image, np.array([3.6, 0.0, 0.0]))
    (True, False)
    """
    index = image.to_voxel(np.asarray(point, float)[None])[0]
    return bool((index >= -0.5).all() and (index <= np.array(image.shape) - 0.5).all())
