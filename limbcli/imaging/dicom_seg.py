"""DICOM Segmentation objects (PS3.3 A.51): binary or fractional segments, frame by frame."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pydicom
from numpy.typing import NDArray
from pydicom.dataset import Dataset

from limbcli.errors import CaseError
from limbcli.imaging.frames import DICOM_DAMAGED
from limbcli.model import Array

_FIX = "export it again as DICOM SEG from 3D Slicer, or as NIfTI"


@dataclass(frozen=True, eq=False)
class NamedMasks:
    """(name, mask [i, j, k]) of each segment on one grid; affine voxel to patient LPS."""

    named: list[tuple[str, NDArray[np.bool_]]]
    affine: Array


def read_dicom_seg(path: Path) -> NamedMasks:
    """Segments of a DICOM SEG file.

    Raises
    ------
    CaseError
        If the file is no segmentation or lacks its geometry.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            dataset = pydicom.dcmread(path)
    except DICOM_DAMAGED as error:
        raise CaseError("the label map is no DICOM file", where=str(path), fix=_FIX) from error
    if str(dataset.get("Modality", "")) != "SEG":
        raise CaseError(
            f"the DICOM file's Modality (0008,0060) is {dataset.get('Modality', 'absent')}, not SEG",
            where=str(path),
            fix="[imaging] labels takes a DICOM SEG; an image series belongs into [imaging] mri",
        )
    try:
        return _masks(dataset)
    except DICOM_DAMAGED as error:
        raise CaseError(
            f"the DICOM SEG cannot be read ({type(error).__name__})", where=str(path), fix=_FIX
        ) from error


def _masks(dataset: Dataset) -> NamedMasks:
    shared = dataset.SharedFunctionalGroupsSequence[0]
    frames = dataset.PerFrameFunctionalGroupsSequence
    pixels = np.asarray(dataset.pixel_array)
    pixels = pixels[None] if pixels.ndim == 2 else pixels
    first = frames[0]
    cosines = np.array(_group(first, shared, "PlaneOrientationSequence").ImageOrientationPatient, float)
    measures = _group(first, shared, "PixelMeasuresSequence")
    normal = np.cross(cosines[:3], cosines[3:])
    positions = np.array([each.PlanePositionSequence[0].ImagePositionPatient for each in frames], float)
    heights = np.round(positions @ normal, 3)
    intensities = np.unique(heights)
    step = float(np.min(np.diff(intensities))) if len(intensities) > 1 else float(measures.SliceThickness)
    index = np.round((heights - intensities[0]) / step).astype(int)
    names = {int(each.SegmentNumber): str(each.SegmentLabel) for each in dataset.SegmentSequence}
    shape = (int(dataset.Columns), int(dataset.Rows), int(index.max()) + 1)
    masks = {number: np.zeros(shape, bool) for number in names}
    for frame, plane, k in zip(frames, pixels, index, strict=True):
        number = int(frame.SegmentIdentificationSequence[0].ReferencedSegmentNumber)
        masks[number][:, :, k] |= 0.5 * int(dataset.get("MaximumFractionalValue", 1) or 1) < plane.T
    affine = np.eye(4)
    affine[:3, 0] = cosines[:3] * float(measures.PixelSpacing[1])
    affine[:3, 1] = cosines[3:] * float(measures.PixelSpacing[0])
    affine[:3, 2] = normal * step
    affine[:3, 3] = positions[np.argmin(heights)]
    return NamedMasks([(names[number], mask) for number, mask in masks.items()], affine)


def _group(frame: Dataset, shared: Dataset, name: str) -> Dataset:
    """A functional group's item, from the frame or from those shared by all."""
    return (frame if name in frame else shared)[name][0]
