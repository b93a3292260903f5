"""Extract image planes from DICOM files: single-frame, multi-frame or enhanced."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset

from limbcli.errors import CaseError
from limbcli.files.dicom import DICOM_DAMAGED, require_affordable, tag_words
from limbcli.imaging.volume import require_unit_directions
from limbcli.model import Array

_EXPORT = "export the series again with its geometry, or use a label map or surfaces instead"
_PLUGINS = "pip install pylibjpeg pylibjpeg-libjpeg pylibjpeg-openjpeg, or export it uncompressed"
_STORAGE = ("Rows", "Columns", "BitsAllocated", "PixelRepresentation")
FLOAT_PIXELS = ("FloatPixelData", "DoubleFloatPixelData")  # PS3.3 C.7.6.24: no sign, no bits stored
_PADDING_OF = {"f4": "FloatPixelPadding", "f8": "DoubleFloatPixelPadding"}
_USABLE = ("MR", "CT", "OT", "")


@dataclass(frozen=True, eq=False)
class Slice:
    """One image plane: pixels (rows, columns), the centre of its first pixel, and its directions.

    number : of the image in its series or stack, None if unknown
    """

    name: str
    pixels: NDArray[np.float32]
    position: Array
    along_row: Array
    along_column: Array
    pixel_spacing: tuple[float, float]
    number: int | None = None

    @property
    def normal(self) -> Array:
        return np.cross(self.along_row, self.along_column)


def slices_of(dataset: Dataset, name: str) -> list[Slice]:
    """Every image plane of one file; `name` is the file's, for messages.

    Raises CaseError for missing geometry, pixels that cannot be decoded, colour, another modality; the
    message names the tag.
    """
    _require_grey(dataset, name)
    pixels = _decoded(dataset, name)
    if "PerFrameFunctionalGroupsSequence" in dataset:
        return _enhanced(dataset, pixels, name)
    if pixels.ndim != 2:
        raise CaseError(
            f"the image has {pixels.shape[0]} frames, but no Per-Frame Functional Groups (5200,9230) that "
            "give their positions",
            where=name,
            fix="export the series as enhanced MR or CT, or as one file per slice",
        )
    plane = _plane(dataset, dataset, dataset, _rescaled(pixels, dataset, dataset, name), name)
    return [replace(plane, number=_number(dataset, "InstanceNumber"))]


def _enhanced(dataset: Dataset, pixels: NDArray, name: str) -> list[Slice]:
    """Planes of an enhanced multi-frame object (PS3.3 C.7.6.16)."""
    frames = dataset.PerFrameFunctionalGroupsSequence
    pixels = pixels[None] if pixels.ndim == 2 else pixels
    if len(frames) != len(pixels):
        raise CaseError(
            f"{len(pixels)} frames, but {len(frames)} items in Per-Frame Functional Groups (5200,9230)",
            where=name,
            fix=_EXPORT,
        )
    planes = []
    for number, (frame, image) in enumerate(zip(frames, pixels, strict=True), 1):
        title = f"{name}, frame {number}"
        position = _group(dataset, frame, "PlanePositionSequence")
        orientation = _group(dataset, frame, "PlaneOrientationSequence")
        measures = _group(dataset, frame, "PixelMeasuresSequence")
        transform = _group(dataset, frame, "PixelValueTransformationSequence")
        merged = Dataset()
        for part in (orientation, measures):
            merged.update(part)
        signal = _rescaled(image, transform, dataset, title)
        content = _group(dataset, frame, "FrameContentSequence")
        plane = _plane(merged, position, measures, signal, title)
        planes.append(replace(plane, number=_number(content, "InStackPositionNumber")))
    return planes


def _number(dataset: Dataset, keyword: str) -> int | None:
    try:
        return int(dataset[keyword].value)
    except (KeyError, TypeError, ValueError):
        return None


def _group(dataset: Dataset, frame: Dataset, name: str) -> Dataset:
    """A functional group's item: the frame's own, else the shared one, else empty."""
    for holder in (frame, *dataset.get("SharedFunctionalGroupsSequence", [])):
        if name in holder and len(holder[name].value):
            return holder[name][0]
    return Dataset()


def _plane(
    orientation: Dataset, position: Dataset, measures: Dataset, pixels: NDArray[np.float32], name: str
) -> Slice:
    cosines = _numbers(orientation, "ImageOrientationPatient", 6, name)
    place = _numbers(position, "ImagePositionPatient", 3, name)
    spacing = _numbers(measures, "PixelSpacing", 2, name)
    along_row, along_column = cosines[:3], cosines[3:]
    what = "Image Orientation (0020,0037)"
    require_unit_directions(cosines.reshape(2, 3), where=name, what=what, fix=_EXPORT)
    lengths = np.linalg.norm(along_row), np.linalg.norm(along_column)
    if min(spacing) <= 0:
        raise CaseError(
            f"Pixel Spacing (0028,0030) is {spacing[0]:g}, {spacing[1]:g} mm", where=name, fix=_EXPORT
        )
    return Slice(
        name=name,
        pixels=pixels,
        position=place,
        along_row=along_row / lengths[0],
        along_column=along_column / lengths[1],
        pixel_spacing=(float(spacing[0]), float(spacing[1])),
    )


def _numbers(dataset: Dataset, keyword: str, count: int, name: str) -> Array:
    """A tag's numbers; a missing or invalid tag is an error that names it."""
    label = tag_words(keyword)
    try:
        values = np.array([float(each) for each in dataset[keyword].value], dtype=float)
    except (KeyError, TypeError, ValueError) as error:
        raise CaseError(f"{label} is missing or not {count} numbers", where=name, fix=_EXPORT) from error
    if len(values) != count or not np.isfinite(values).all():
        raise CaseError(f"{label} should be {count} numbers, it is {len(values)}", where=name, fix=_EXPORT)
    return values


def _require_grey(dataset: Dataset, name: str) -> None:
    modality = str(dataset.get("Modality", "") or "")
    if modality not in _USABLE:
        raise CaseError(
            f"Modality (0008,0060) is {modality}; the geometry needs MR or CT",
            where=name,
            fix="[imaging] mri must give the folder of an MR or CT series; a SEG belongs in labels",
        )
    kind = str(dataset.get("PhotometricInterpretation", "MONOCHROME2"))
    if not kind.startswith("MONOCHROME"):
        raise CaseError(
            f"Photometric Interpretation (0028,0004) is {kind}; grey values are needed",
            where=name,
            fix="remove screenshots and colour images from the folder",
        )


def _decoded(dataset: Dataset, name: str) -> NDArray:
    _complete(dataset, name)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            require_affordable(dataset)
            return _from_high_bit(dataset)
    except (ValueError, AttributeError, RuntimeError, NotImplementedError, KeyError, TypeError) as error:
        syntax = getattr(getattr(dataset, "file_meta", None), "TransferSyntaxUID", None)
        packed = bool(getattr(syntax, "is_private", True) or syntax.is_compressed)  # type: ignore[union-attr]
        fix = _PLUGINS if packed else "the file is truncated or damaged: copy the series again"
        if syntax is None:
            fix = "the file does not say how its pixels are compressed: export the series again uncompressed"
        raise CaseError(
            "the pixel data (7FE0,0010) cannot be decoded "
            f"(Transfer Syntax 0002,0010: {getattr(syntax, 'name', 'unknown')})",
            where=name,
            fix=fix,
        ) from error


def _from_high_bit(dataset: Dataset) -> NDArray:
    """Stored values, taking account of a High Bit (0028,0102) above the lowest bits of the words.

    If the lower bits of the words are not all zero, the values occupy the lowest bits, whatever High Bit
    says.
    """
    stored, high = dataset.get("BitsStored", 0), dataset.get("HighBit", 0)
    above = high + 1 - stored
    if not 0 < above <= dataset.BitsAllocated - stored or dataset.file_meta.TransferSyntaxUID.is_compressed:
        return np.asarray(dataset.pixel_array)
    dataset.BitsStored = dataset.BitsAllocated  # pydicom discards bits above the lowest BitsStored
    words = np.array(dataset.pixel_array)
    dataset.BitsStored = stored
    if (words & (2**above - 1)).any():
        return np.asarray(dataset.pixel_array)
    return np.asarray((words << (dataset.BitsAllocated - 1 - high)) >> (dataset.BitsAllocated - stored))


def should_be_image(dataset: Dataset) -> bool:
    """Whether a file without pixels is a truncated image, by its type; reports and the like have none."""
    meta = getattr(dataset, "file_meta", {})
    try:
        kind = meta.get("MediaStorageSOPClassUID") or dataset.get("SOPClassUID") or ""
    except DICOM_DAMAGED:
        return True
    name = getattr(kind, "name", str(kind))
    return not kind or "Image Storage" in name


def damaged(where: str, error: BaseException) -> CaseError:
    """The error for a DICOM file that is truncated or inconsistent; its values are not shown."""
    return CaseError(
        f"the DICOM file is damaged ({type(error).__name__})",
        where=where,
        fix="copy the series again from the scanner or the archive",
    )


def _complete(dataset: Dataset, name: str) -> None:
    """Check the tags of the pixel format: defaults are filled in where safe, the others are required."""
    in_floats = any(each in dataset for each in FLOAT_PIXELS)
    for keyword in _STORAGE:
        if keyword not in dataset and not (in_floats and keyword == "PixelRepresentation"):
            raise CaseError(
                f"{tag_words(keyword)} is missing, so the pixels cannot be read",
                where=name,
                fix="export the series again, or use a label map or surfaces instead",
            )
    usual = {
        "SamplesPerPixel": 1,
        "PhotometricInterpretation": "MONOCHROME2",
        "BitsStored": dataset.BitsAllocated,
    }
    for keyword, value in usual.items():
        if keyword not in dataset:
            setattr(dataset, keyword, value)
    if "HighBit" not in dataset:
        dataset.HighBit = dataset.BitsStored - 1


def turned_over(dataset: Dataset) -> bool:
    """Whether high values mean dark. For CT this affects only the display: its values remain HU."""
    inverse = str(dataset.get("PhotometricInterpretation", "")) == "MONOCHROME1"
    return inverse and str(dataset.get("Modality", "")) != "CT"


def _rescaled(pixels: NDArray, transform: Dataset, header: Dataset, name: str) -> NDArray[np.float32]:
    """Apply Rescale Slope and Intercept; MONOCHROME1 (high is dark) is inverted, padding becomes air."""
    pixels = _without_padding(pixels, header)
    if turned_over(header):
        pixels = _negative(pixels, header)
    values = []
    for keyword, tag, default in (("RescaleSlope", "0028,1053", 1.0), ("RescaleIntercept", "0028,1052", 0.0)):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                values.append(float(transform.get(keyword, default) or default))
        except (TypeError, ValueError) as error:
            raise CaseError(f"{keyword} ({tag}) is no number", where=name, fix=_EXPORT) from error
    return pixels.astype(np.float32) * np.float32(values[0]) + np.float32(values[1])


def _negative(pixels: NDArray, header: Dataset) -> NDArray:
    """Invert an image in which high is dark; integers stay within the stored range."""
    if np.issubdtype(pixels.dtype, np.floating):
        return -pixels
    top = 2 ** int(header.get("BitsStored", 16)) - 1
    return (-1 if int(header.get("PixelRepresentation", 0)) else top) - pixels.astype(np.int64)


def _without_padding(pixels: NDArray, header: Dataset) -> NDArray:
    """Set pixels without measurement (Pixel Padding Value, PS3.3 C.7.5.1.1.2) to the darkest value.

    A padding value within the range of the image itself is left alone: either it is as dark as air, or it
    cannot be distinguished.
    """
    pixels = _darkened(pixels, ~np.isfinite(pixels), header)
    kind = _PADDING_OF.get(pixels.dtype.kind + str(pixels.dtype.itemsize), "PixelPadding")
    try:
        value = float(header[f"{kind}Value"].value)
        ends = value, float(header[f"{kind}RangeLimit"].value if f"{kind}RangeLimit" in header else value)
    except (KeyError, TypeError, ValueError):
        return pixels
    padding = (pixels >= min(ends)) & (pixels <= max(ends))
    measured = pixels[~padding]
    if len(measured) and measured.min() < max(ends) < measured.max():
        return pixels
    return _darkened(pixels, padding, header)


def _darkened(pixels: NDArray, where: NDArray[np.bool_], header: Dataset) -> NDArray:
    """Set the pixels `where` nothing was measured to the minimum of the others (0 if there are none)."""
    measured = pixels[~where]
    if not where.any():
        return pixels
    if not len(measured):
        return pixels if np.isfinite(pixels).all() else np.zeros_like(pixels)
    return np.where(where, measured.max() if turned_over(header) else measured.min(), pixels)
