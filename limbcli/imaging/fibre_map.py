"""Fibre directions of a whole limb from diffusion MRI: a NIfTI with three components, treated as axes.

The principal direction of a diffusion tensor has no sign, so adjacent voxels may have opposite vectors. The
dyads v v' are therefore interpolated, and the direction is the principal axis of the mean dyad; its
eigenvalues show the agreement of the neighbours. Components are along the patient axes (RAS as in NIfTI, or
LPS), or along the voxel axes as written by FSL's dtifit.

Source: Basser & Pajevic 2000, Magn Reson Med 44:41 (the mean dyadic tensor); FSL FDT user guide (vector
orientation convention).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates

from limbcli.errors import CaseError
from limbcli.imaging.nifti import nifti_values, open_nifti
from limbcli.imaging.volume import RAS_FROM_LPS, Volume
from limbcli.model import Array

REACH = 6.0  # mm: outside the map's directions, the nearest one within this distance is used
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
_TEMPLATES = {3: "Talairach space", 4: "MNI space", 5: "a template's space"}
_NO_LENGTH = 1e-6
_SAVE = "save the principal diffusion direction (V1) as NIfTI (.nii.gz)"


@dataclass(frozen=True, eq=False)
class FibreMap:
    """dyads (n_i, n_j, n_k, 6): xx yy zz xy yz xz of v v' in patient LPS, 0 where there is no direction.

    grid : positions of the voxels; its values mark where there is a direction
    """

    dyads: Array
    grid: Volume

    def at(self, points: Array) -> FibreSample:
        """The axes at points (n, 3), patient LPS, mm."""
        index = self.grid.to_voxel(points).T
        parts = [
            map_coordinates(self.dyads[..., k], index, order=1, mode="constant", cval=0.0) for k in range(6)
        ]
        mean = _matrices(np.stack(parts, axis=-1))
        covered = np.trace(mean, axis1=1, axis2=2) > 0.5
        near = ~covered
        if near.any():
            nearest, distance = self._nearest(index[:, near])
            rows = np.flatnonzero(near)[distance <= REACH]
            mean[rows] = nearest[distance <= REACH]
            near = np.zeros(len(covered), dtype=bool)
            near[rows] = True
        values, vectors = np.linalg.eigh(mean)
        known = covered | near
        trace = np.where(known, values.sum(axis=1), 1.0)
        agreement = np.where(known, (1.5 * values[:, 2] / trace) - 0.5, 0.0)
        return FibreSample(np.where(known[:, None], vectors[:, :, 2], np.nan), agreement, covered, near)

    def _nearest(self, index: Array) -> tuple[Array, Array]:
        """Dyads (n, 3, 3) of the nearest voxels with a direction, and their distances (n,), mm."""
        _, places = distance_transform_edt(
            self.grid.values == 0, sampling=self.grid.spacing, return_indices=True
        )
        last = np.array(self.grid.shape)[:, None] - 1
        inside = np.clip(np.rint(index), 0, last).astype(int)
        chosen = places[(slice(None), *inside)]
        distance = np.linalg.norm((chosen.T - index.T) * self.grid.spacing, axis=1)
        return _matrices(self.dyads[tuple(chosen)]), distance


@dataclass(frozen=True, eq=False)
class FibreSample:
    """axes (n, 3): unit vectors, patient LPS, NaN where the map has no data.

    agreement (n,) : 1 if all neighbours are parallel to the axis, 0 if they are isotropic
    covered, near (n,) : inside the map's directions; taken from the nearest one, up to `REACH` mm away
    """

    axes: Array
    agreement: Array
    covered: Array
    near: Array


def read_fibre_map(path: Path, *, frame: str = "ras") -> FibreMap:
    """Read a NIfTI of directions (n_i, n_j, n_k, 3) of any length; a zero vector means no direction.

    frame : of the components: "ras", "lps", or "fsl" (the voxel axes, the first reversed if the image's
        determinant is positive)

    Raises CaseError if the file cannot be read, has another number of components, lacks its position, lies in
    a template's space, or contains no direction.
    """
    image = open_nifti(path, noun="fibre map")
    if image.get_data_dtype().kind not in "fiu":
        raise CaseError("the fibre map is not a numeric NIfTI file", where=str(path), fix=_SAVE)
    shape = _shape(tuple(image.shape), path)
    code = int(image.header["sform_code"]) or int(image.header["qform_code"])
    if code in _TEMPLATES:
        what = f"the fibre map lies in another frame: {_TEMPLATES[code]}, not the patient's"
        fix = "give the directions in the frame of the limb's own images (scanner coordinates)"
        raise CaseError(what, where=str(path), fix=fix)
    values = nifti_values(image, path, noun="fibre map", dtype=np.float64).reshape(*shape, 3)
    if not np.isfinite(values).all():
        values = np.where(np.isfinite(values).all(axis=-1, keepdims=True), values, 0.0)
    affine = RAS_FROM_LPS @ np.asarray(image.affine, dtype=np.float64)
    length = np.linalg.norm(values, axis=-1)
    known = length > _NO_LENGTH
    if not known.any():
        raise CaseError("every direction of the fibre map has length 0", where=str(path), fix=_SAVE)
    unit = np.where(known[..., None], values / np.where(known, length, 1.0)[..., None], 0.0)
    turned = unit @ _to_lps(frame, affine).T
    dyads = np.stack([turned[..., a] * turned[..., b] for a, b in _PAIRS], axis=-1)
    return FibreMap(dyads, Volume(known.astype(np.uint8), affine))


def _shape(shape: tuple[int, ...], path: Path) -> tuple[int, int, int]:
    components = math.prod(shape[3:])
    if len(shape) < 4 or components != 3:
        hint = {1: "a scalar image", 4: "quaternions?", 6: "the tensor itself?", 9: "the tensor itself?"}
        what = f"the fibre map has {components} component{'s' if components != 1 else ''}, not 3"
        note = f" ({hint[components]})" if components in hint else ""
        raise CaseError(what + note, where=str(path), fix=_SAVE, components=components)
    return int(shape[0]), int(shape[1]), int(shape[2])


def _to_lps(frame: str, affine: Array) -> Array:
    """Matrix (3, 3) from the stored components to patient LPS; affine : voxel index to LPS."""
    if frame == "lps":
        return np.eye(3)
    if frame == "ras":
        return np.asarray(RAS_FROM_LPS[:3, :3])
    axes = affine[:3, :3] / np.linalg.norm(affine[:3, :3], axis=0)
    # the determinant is the same in LPS and RAS, which differ by two reversed axes
    if np.linalg.det(axes) > 0:
        axes = axes * np.array([-1.0, 1.0, 1.0])
    return np.asarray(axes)


def _matrices(six: Array) -> Array:
    """Symmetric matrices (n, 3, 3) from their six components (n, 6)."""
    full = np.empty((len(six), 3, 3))
    for k, (a, b) in enumerate(_PAIRS):
        full[:, a, b] = full[:, b, a] = six[:, k]
    return full
