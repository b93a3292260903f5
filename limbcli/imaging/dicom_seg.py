"""DICOM Segmentation objects (PS3.3 A.51): binary or fractional segments frame by frame, or one label map.

In a label map (Segmentation Type LABELMAP, PS3.3 C.8.20.2) a pixel's value is the number of its segment, and
frames have no segment of their own. Read here because highdicom 0.28 rejects files that lack the preamble or
an attribute that is of no use here (such as Segmented Property Category).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset

from limbcli.errors import CaseError
from limbcli.files.dicom import DICOM_DAMAGED, read_dicom, require_affordable
from limbcli.imaging.rtstruct import contour_masks
from limbcli.imaging.volume import MOST_VOXELS, require_placed, require_unit_directions
from limbcli.model import Array

# fractions of the slice spacing: frames closer than the first are one slice; the second is the tolerance of
# uneven spacing
_SAME_SLICE, _UNEVEN = 0.1, 0.1
_BESIDE = 0.5  # pixels: largest offset of a slice from the line between the first and the last
_PARALLEL = 1e-3  # largest change of a direction cosine between frames
_FIX = "export it again as DICOM SEG from 3D Slicer, or as NIfTI"


@dataclass(frozen=True, eq=False)
class NamedMasks:
    """Number, name and mask [i, j, k] of each segment on one grid; affine from voxel to patient LPS.

    A label map has one array for all its segments, in which the segment's voxels have its number.
    """

    named: list[tuple[int, str, NDArray]]
    affine: Array
    is_label_map: bool = False


def read_dicom_segments(path: Path) -> NamedMasks:
    """Read the segments of a DICOM SEG file, or the structures of an RTSTRUCT.

    Raises CaseError if the file is neither or lacks its geometry.
    """
    try:
        dataset = read_dicom(path)
    except DICOM_DAMAGED as error:
        raise CaseError("the label map is not a DICOM file", where=str(path), fix=_FIX) from error
    modality = "segmentation"
    try:
        modality = str(dataset.get("Modality", "absent"))
        if modality == "RTSTRUCT":
            return NamedMasks(*contour_masks(dataset, path))
        if modality != "SEG":
            fix = "[imaging] labels takes a DICOM SEG or RTSTRUCT; an image series belongs in [imaging] mri"
            what = f"the DICOM file's Modality (0008,0060) is {modality}, not SEG or RTSTRUCT"
            raise CaseError(what, where=str(path), fix=fix)
        return _masks(dataset, path)
    except DICOM_DAMAGED as error:
        raise CaseError(
            f"the DICOM {modality} cannot be read ({type(error).__name__})", where=str(path), fix=_FIX
        ) from error


def _slice_step(heights: Array, stated: float) -> float:
    """Slice spacing (mm): the smallest distance between the heights of different slices.

    Heights of frames of one slice may differ by rounding: those closer than a tenth of the stated spacing are
    one.

    >>> round(_slice_step(np.array([0.0, 0.0002, 2.0, 6.0]), 2.0), 3)
    2.0
    """
    apart = np.diff(np.unique(heights))
    apart = apart[apart > _SAME_SLICE * stated]
    if not len(apart):
        return stated
    smallest = float(apart.min())
    return float((heights.max() - heights.min()) / max(round((heights.max() - heights.min()) / smallest), 1))


def _masks(dataset: Dataset, path: Path) -> NamedMasks:
    shared = dataset.SharedFunctionalGroupsSequence[0]
    frames = dataset.PerFrameFunctionalGroupsSequence
    require_affordable(dataset)
    pixels = np.asarray(dataset.pixel_array)
    pixels = pixels[None] if pixels.ndim == 2 else pixels
    first = frames[0]
    turned = np.array(
        [_group(each, shared, "PlaneOrientationSequence").ImageOrientationPatient for each in frames], float
    )
    cosines = turned[0]
    what = "the DICOM SEG's Image Orientation (0020,0037)"
    require_unit_directions(cosines.reshape(2, 3), where=str(path), what=what, fix=_FIX)
    if not np.abs(turned - cosines).max() <= _PARALLEL:
        raise CaseError("the DICOM SEG's slices are not parallel", where=str(path), fix=_FIX)
    measures = _group(first, shared, "PixelMeasuresSequence")
    normal = np.cross(cosines[:3], cosines[3:])
    positions = np.array(
        [_group(each, shared, "PlanePositionSequence").ImagePositionPatient for each in frames], float
    )
    heights = positions @ normal
    step = _slice_step(heights, float(measures.get("SpacingBetweenSlices", 0) or measures.SliceThickness))
    index = np.round((heights - heights.min()) / step).astype(int)
    off = np.abs(heights - heights.min() - index * step).max()
    if off > _UNEVEN * step:
        raise CaseError(
            f"the DICOM SEG's slices are not evenly spaced: one is {off:.2g} mm off a grid of {step:.3g} mm",
            where=str(path),
            fix=_FIX,
        )
    names = {int(each.SegmentNumber): str(each.SegmentLabel) for each in dataset.SegmentSequence}
    shape = (int(dataset.Columns), int(dataset.Rows), int(index.max()) + 1)
    is_label_map = str(dataset.get("SegmentationType", "")).upper() == "LABELMAP"
    if math.prod(shape) * (1 if is_label_map else len(names)) > MOST_VOXELS:
        raise CaseError(
            f"the DICOM SEG has {len(names)} segments of {' x '.join(map(str, shape))} voxels: too many",
            where=str(path),
            fix="cut it to the limb, or " + _FIX,
        )
    masks: dict[int, NDArray] = {}
    if is_label_map:
        values = np.zeros(shape, pixels.dtype)
        for plane, k in zip(pixels, index, strict=True):
            values[:, :, k] = plane.T
        masks = dict.fromkeys(
            (*names, *(int(each) for each in np.unique(values) if int(each) not in names)), values
        )
        masks.pop(0, None)
    else:
        masks = {number: np.zeros(shape, bool) for number in names}
        for frame, plane, k in zip(frames, pixels, index, strict=True):
            number = int(_group(frame, shared, "SegmentIdentificationSequence").ReferencedSegmentNumber)
            masks[number][:, :, k] |= 0.5 * int(dataset.get("MaximumFractionalValue", 1) or 1) < plane.T
    affine = np.eye(4)
    affine[:3, 0] = cosines[:3] * float(measures.PixelSpacing[1])
    affine[:3, 1] = cosines[3:] * float(measures.PixelSpacing[0])
    affine[:3, 2] = _from_slice_to_slice(positions, index, normal * step)
    affine[:3, 3] = positions[np.argmin(heights)]
    affine = require_placed(affine, path, noun="DICOM SEG")
    beside = positions - affine[:3, 3] - np.outer(index, affine[:3, 2])
    if np.linalg.norm(beside, axis=1).max() > _BESIDE * float(min(measures.PixelSpacing)) + _UNEVEN * step:
        what = "the DICOM SEG's slices do not lie on one line, one behind the other"
        raise CaseError(what, where=str(path), fix=_FIX)
    named = [(number, names.get(number, ""), mask) for number, mask in masks.items()]
    return NamedMasks(named, affine, is_label_map)


def _from_slice_to_slice(positions: Array, index: Array, upright: Array) -> Array:
    """Vector (3,), mm, from one slice's first pixel to the next one's; with gantry tilt it is oblique.

    positions : (n, 3) of the frames; index : (n,) of their slices; upright : (3,) used if all are of one
        slice
    """
    away = index - index.mean()
    if not away.any():
        return upright
    return np.asarray(away @ (positions - positions.mean(axis=0)) / (away @ away), dtype=np.float64)


def _group(frame: Dataset, shared: Dataset, name: str) -> Dataset:
    """A functional group's item, from the frame or from the shared groups."""
    return (frame if name in frame else shared)[name][0]
