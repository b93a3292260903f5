"""`Volume`: an image and the position of its voxels in the patient frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import CaseError
from limbcli.errors.problems import Problem
from limbcli.model import Array

# largest number of voxels of an image: a whole leg at 0.4 mm; more would not be a limb, nor fit into memory
MOST_VOXELS = 300_000_000
RAS_FROM_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
_FLAT = 0.1  # volume of a cell with axes of length 1, below which they are (nearly) in one plane: 6 degrees
_UNIT = 0.01  # largest error of the length of a unit vector, and cosine of perpendicular ones
_AXES = "ijk"


@dataclass(frozen=True, eq=False)
class Volume:
    """Voxel values and the frame they lie in.

    values : array (n_i, n_j, n_k), indexed [i, j, k]
    affine : (4, 4), voxel index (of a voxel's centre) to patient LPS, mm

    >>> volume = Volume(np.zeros((4, 5, 6)), np.diag([2.0, 2.0, 3.0, 1.0]))
    >>> volume.spacing
    array([2., 2., 3.])
    >>> volume.to_patient(np.array([[1.0, 0.0, 2.0]]))
    array([[2., 0., 6.]])
    """

    values: NDArray
    affine: Array

    @property
    def shape(self) -> tuple[int, int, int]:
        n_i, n_j, n_k = self.values.shape
        return n_i, n_j, n_k

    @property
    def spacing(self) -> Array:
        """Distance between neighbouring voxel centres along i, j, k, mm."""
        return np.asarray(np.linalg.norm(self.affine[:3, :3], axis=0))

    @property
    def voxel_volume(self) -> float:
        """Volume of a voxel, mm^3; valid also for sheared grids (gantry tilt)."""
        return float(abs(np.linalg.det(self.affine[:3, :3])))

    def to_patient(self, index: Array) -> Array:
        """Convert voxel indices (n, 3), fractions allowed, to patient LPS (n, 3), mm."""
        return np.asarray(index, dtype=np.float64) @ self.affine[:3, :3].T + self.affine[:3, 3]

    def to_voxel(self, points: Array) -> Array:
        """Convert patient LPS (n, 3), mm, to fractional voxel indices (n, 3)."""
        offset = np.asarray(points, dtype=np.float64) - self.affine[:3, 3]
        return np.asarray(np.linalg.solve(self.affine[:3, :3], offset.T).T, dtype=np.float64)

    def with_values(self, values: NDArray) -> Volume:
        """The same grid with other values."""
        return replace(self, values=values)

    @property
    def limb_axis(self) -> int:
        """The voxel axis along the limb: the one closest to the head-foot direction."""
        return int(np.argmax(np.abs(self.affine[2, :3]) / self.spacing))

    def along_limb(self) -> tuple[Volume, tuple[int, ...], bool]:
        """The image with k along the limb, increasing towards proximal (the head).

        Returns the volume, the order of axes, and whether k was reversed; `back` undoes it.

        >>> values = np.arange(24).reshape(2, 3, 4)
        >>> coronal = Volume(values, np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]))
        >>> turned, order, flipped = coronal.along_limb()
        >>> turned.shape, order, flipped
        ((2, 4, 3), (0, 2, 1), True)
        >>> np.array_equal(back(turned.values, order, flipped), values)
        True
        """
        axis = self.limb_axis
        order = (*(each for each in range(3) if each != axis), axis)
        affine = self.affine[:, [*order, 3]].copy()
        values = np.transpose(self.values, order)
        flipped = bool(affine[2, 2] < 0)
        if flipped:
            affine[:3, 3] += affine[:3, 2] * (values.shape[2] - 1)
            affine[:3, 2] *= -1
            values = values[:, :, ::-1]
        return Volume(values, affine), order, flipped


def require_placed(affine: Array, path: Path | str, *, noun: str) -> Array:
    """The affine (4, 4) from voxels to patient, mm, of an image or label map: checked for every format.

    noun : what the file is, for the messages ("image", "label map")

    Raises CaseError if position or directions are no finite numbers, a direction has no length, or the three
    lie in one plane.
    """
    affine = np.asarray(affine, dtype=np.float64)
    fix = "export it again with its geometry, from 3D Slicer or the DICOM series"
    if affine.shape != (4, 4) or not np.isfinite(affine).all():
        what = f"the {noun}'s position or directions are not finite numbers"
        raise CaseError(what, where=str(path), fix=fix)
    lengths = np.linalg.norm(affine[:3, :3], axis=0)
    if not (lengths > 0).all():
        axis = _AXES[int(np.argmin(lengths))]
        what = f"the {noun}'s voxels have no size along {axis}: its direction has length 0"
        raise CaseError(what, where=str(path), fix=fix)
    if abs(np.linalg.det(affine[:3, :3] / lengths)) < _FLAT:
        what = f"the {noun}'s three directions are parallel, or lie in one plane: its affine is singular"
        raise CaseError(what, where=str(path), fix=fix)
    return affine


def unplaced(volume: Volume, path: Path | str, *, noun: str = "image") -> list[Problem]:
    """A warning if the position is what a program writes that knows none; noun: as of `require_placed`."""
    affine = volume.affine * np.sign(np.diagonal(volume.affine))
    if not np.array_equal(affine, np.eye(4)):
        return []
    what = f"the {noun} has voxels of exactly 1 x 1 x 1 mm along the patient's axes, the first at (0, 0, 0): "
    what += "so writes a program that has lost the geometry"
    fix = "compare the limb's size with the scan's; export it with its geometry, from 3D Slicer or the DICOM"
    return [Problem(what, str(path), f"{fix} series", severity="warning")]


def require_unit_directions(directions: Array, *, where: str, what: str, fix: str) -> None:
    """Check that directions (n, 3) that are to be unit vectors are, and perpendicular to each other.

    what : what they are, for the message

    Raises CaseError if they are not.
    """
    directions = np.asarray(directions, dtype=np.float64)
    if not np.abs(directions @ directions.T - np.eye(len(directions))).max() <= _UNIT:  # also of NaN
        listed = " ".join(f"{each:.6g}" for each in directions.ravel())
        what = f"{what} does not have perpendicular directions of length 1: {listed}"
        raise CaseError(what, where=where, fix=fix)


def back(values: NDArray, order: tuple[int, ...], flipped: bool) -> NDArray:
    """Transform values from the grid of `Volume.along_limb` back to the original grid."""
    turned = values[:, :, ::-1] if flipped else values
    return np.ascontiguousarray(np.transpose(turned, np.argsort(order)))
