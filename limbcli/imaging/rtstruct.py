"""Contours of a DICOM RT Structure Set (PS3.3 A.19) as masks on a grid of their own.

The slices are those of the contours. A voxel belongs to a structure if its centre is within the contours;
a contour within another one is a hole, as PS3.3 C.8.8.6.3 has it for holes (CLOSEDPLANAR_XOR).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset
from skimage.draw import polygon

from limbcli.errors import CaseError
from limbcli.errors.problems import shortened
from limbcli.imaging.label_names import meaning_of
from limbcli.imaging.volume import MOST_VOXELS
from limbcli.model import Array

_CLOSED = ("CLOSED_PLANAR", "CLOSEDPLANAR_XOR")
_PIXELS_MM = (0.5, 0.7, 1.0)  # edges of a pixel across the slices: the first with which all fits into memory
_FLAT_MM = 0.1  # largest distance of a contour's points from its slice
_UNEVEN = 0.1  # largest offset of a slice from an even spacing, as a fraction of it
_GOES_ON = 0.5  # share of the smaller of two areas in which a structure goes on from one slice to the next
_FIX = "export the structures again, or save them as a label map in 3D Slicer (SlicerRT)"

Rings = list[tuple[int, Array]]  # slice, and a contour's points (n, 2), pixels


def contour_masks(dataset: Dataset, path: Path) -> tuple[list[tuple[int, str, NDArray]], Array]:
    """Number, name and mask [i, j, k] of every structure with closed contours; affine to patient LPS, mm.

    Raises CaseError if there is none, their planes are not parallel and evenly spaced, or a structure has no
    contour on slices through which it goes.
    """
    names = _names(dataset)
    contours = [
        (int(roi.ReferencedROINumber), np.asarray(each.ContourData, dtype=np.float64).reshape(-1, 3))
        for roi in dataset.get("ROIContourSequence", ())
        for each in roi.get("ContourSequence", ())
        if str(each.get("ContourGeometricType", "")) in _CLOSED and len(each.ContourData) >= 9
    ]
    if not contours:
        raise CaseError("the RTSTRUCT has no closed contours", where=str(path), fix=_FIX)
    points = np.concatenate([each for _, each in contours])
    if not np.isfinite(points).all():
        raise CaseError("points of the contours are not finite numbers", where=str(path), fix=_FIX)
    axes = _axes(max((each for _, each in contours), key=lambda each: float(np.linalg.norm(_area(each)))))
    heights = np.array([float(np.mean(each @ axes[2])) for _, each in contours])
    if max(np.ptp(each @ axes[2]) for _, each in contours) > 2 * _FLAT_MM:
        raise CaseError("the contours do not lie in parallel slices", where=str(path), fix=_FIX)
    slices, step = _slices(heights, path)
    low = (points @ axes[:2].T).min(axis=0)
    extent = np.ptp(points @ axes[:2].T, axis=0)
    pixel, shape = _grid(extent, int(slices.max()) + 1, len({number for number, _ in contours}), path)
    low -= pixel
    rings: dict[int, Rings] = {}
    for (number, each), k in zip(contours, slices.tolist(), strict=True):
        rings.setdefault(number, []).append((k, (each @ axes[:2].T - low) / pixel))
    masks = {number: _mask(found, shape) for number, found in rings.items()}
    _require_every_slice(masks, names, path)
    affine = np.eye(4)
    affine[:3, :3] = axes.T * [pixel, pixel, step]
    affine[:3, 3] = low @ axes[:2] + heights.min() * axes[2]
    return [(number, names.get(number, ""), mask) for number, mask in masks.items()], affine


def _names(dataset: Dataset) -> dict[int, str]:
    """Names of the structures by number; of the patient's outline with a word that tells what it is."""
    names = {int(each.ROINumber): str(each.get("ROIName", "")) for each in dataset.StructureSetROISequence}
    for each in dataset.get("RTROIObservationsSequence", ()):
        number = int(each.ReferencedROINumber)
        is_outline = str(each.get("RTROIInterpretedType", "")) == "EXTERNAL"  # PS3.3 C.8.8.8.1
        if is_outline and meaning_of(names.get(number, "")) is None:
            names[number] = f"{names.get(number, '')} (body)".strip()
    return names


def _area(ring: Array) -> Array:
    """Area vector (3,), mm2, of a closed contour (n, 3)."""
    from_middle = ring - ring.mean(axis=0)
    return np.asarray(0.5 * np.cross(from_middle, np.roll(from_middle, -1, axis=0)).sum(axis=0))


def _axes(ring: Array) -> Array:
    """Unit vectors (3, 3) as rows: two in the plane of a contour, and its normal towards the patient's side
    that its largest component points to."""
    normal = _area(ring) / max(float(np.linalg.norm(_area(ring))), 1e-12)
    normal *= np.sign(normal[np.argmax(np.abs(normal))]) or 1.0
    along = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = along - (along @ normal) * normal
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(normal, first), normal])


def _slices(heights: Array, path: Path) -> tuple[NDArray[np.int64], float]:
    """Number of each contour's slice, and the slices' distance (mm)."""
    apart = np.diff(np.unique(heights))
    apart = apart[apart > 2 * _FLAT_MM]
    if not len(apart):
        raise CaseError("all contours lie in one slice", where=str(path), fix=_FIX)
    span = float(np.ptp(heights))
    step = span / round(span / float(apart.min()))
    found = np.round((heights - heights.min()) / step).astype(np.int64)
    off = float(np.abs(heights - heights.min() - found * step).max())
    if off > _UNEVEN * step:
        what = f"the contours' slices are not evenly spaced: one is {off:.2g} mm off a grid of {step:.3g} mm"
        raise CaseError(what, where=str(path), fix=_FIX)
    return found, step


def _grid(extent: Array, n_slices: int, n_masks: int, path: Path) -> tuple[float, tuple[int, int, int]]:
    """Edge of a pixel (mm) and the grid's shape, with a pixel to spare all round."""
    for pixel in _PIXELS_MM:
        n_i, n_j = np.ceil(extent / pixel).astype(int) + 3
        if math.prod((int(n_i), int(n_j), n_slices, n_masks)) <= MOST_VOXELS:
            return pixel, (int(n_i), int(n_j), n_slices)
    what = f"the RTSTRUCT has {n_masks} structures over {extent.max():.0f} mm and {n_slices} slices: too many"
    raise CaseError(what, where=str(path), fix="export the limb's structures alone")


def _mask(rings: Rings, shape: tuple[int, int, int]) -> NDArray[np.bool_]:
    mask = np.zeros(shape, bool)
    for k, ring in rings:
        i, j = polygon(ring[:, 0], ring[:, 1], shape[:2])
        mask[i, j, k] ^= True
    return mask


def _require_every_slice(
    masks: Mapping[int, NDArray[np.bool_]], names: Mapping[int, str], path: Path
) -> None:
    """Check that no structure that goes on over a gap has slices there without a contour."""
    missing = {number: _missing(mask) for number, mask in masks.items()}
    lacking = [f"{names.get(number) or number} on {n}" for number, n in missing.items() if n]
    if lacking:
        raise CaseError(
            f"structures have no contour on slices through which they go: {shortened(lacking, most=8)}",
            where=str(path),
            fix="interpolate the contours between the slices; two bodies, as the bones of a joint, need a "
            "structure each",
        )


def _missing(mask: NDArray[np.bool_]) -> int:
    """Number of slices without a contour over which a structure goes on."""
    missing = 0
    for k, after in pairwise(np.flatnonzero(mask.any(axis=(0, 1))).tolist()):
        one, other = mask[:, :, k], mask[:, :, after]
        if after - k > 1 and (one & other).sum() > _GOES_ON * min(one.sum(), other.sum()):
            missing += after - k - 1
    return missing
