"""Read DICOM files, also those without the 128-byte preamble or the file meta information (PS3.10, 7.1).

Consoles of scanners and old archives store plain datasets. What their file meta information would say of the
encoding is seen from the first element.
"""

from __future__ import annotations

import math
import warnings
import zlib
from pathlib import Path

import pydicom
from pydicom.datadict import dictionary_description, tag_for_keyword
from pydicom.dataset import Dataset, FileDataset
from pydicom.errors import BytesLengthException, InvalidDicomError
from pydicom.filereader import read_file_meta_info
from pydicom.uid import (
    DeflatedExplicitVRLittleEndian,
    ExplicitVRBigEndian,
    ExplicitVRLittleEndian,
    ImplicitVRLittleEndian,
)

from limbcli.files.unpacking import LIBRARY_ERRORS, UnpackingBudget

# what pydicom raises on corrupt files
DICOM_DAMAGED = (*LIBRARY_ERRORS, BytesLengthException, InvalidDicomError)
_PREAMBLE, _MAGIC = 128, b"DICM"
_GROUP_LENGTH = 12  # bytes of the element (0002,0000)


def has_preamble(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(_PREAMBLE + len(_MAGIC))[_PREAMBLE:] == _MAGIC


def read_dicom(path: Path) -> FileDataset:
    """Read a DICOM file; without a stated transfer syntax, it is that of the dataset's own encoding.

    Compressed pixels without a stated transfer syntax remain without one, and cannot be decoded.

    Raises OSError if a deflated file is damaged, or unpacks to too much; pydicom.errors.InvalidDicomError if
    the file is no DICOM file: without preamble, it must name its SOP Class or its modality and size.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if has_preamble(path):
            _measure_deflated(path)
        try:
            dataset = pydicom.dcmread(path, force=True)
        except zlib.error as error:
            raise OSError(f"its deflated content is damaged ({error})") from error
        plain = "SOPClassUID" in dataset or ("Modality" in dataset and "Rows" in dataset)
    if not has_preamble(path) and not plain:
        raise InvalidDicomError(f"{path.name} has neither the DICOM preamble nor the tags of an image")
    if "TransferSyntaxUID" not in dataset.file_meta and not _is_encapsulated(dataset):
        is_implicit, is_little = dataset.original_encoding
        explicit = ExplicitVRLittleEndian if is_little else ExplicitVRBigEndian
        dataset.file_meta.TransferSyntaxUID = ImplicitVRLittleEndian if is_implicit else explicit
    return dataset


def tag_words(keyword: str) -> str:
    """
    >>> tag_words("PixelSpacing")
    'Pixel Spacing (0028,0030)'
    """
    tag = tag_for_keyword(keyword) or 0
    return f"{dictionary_description(keyword)} ({tag >> 16:04X},{tag & 0xFFFF:04X})"


def require_affordable(dataset: Dataset) -> None:
    """Check before pixels are decoded that they are not too many, whatever their compression.

    Raises OSError if they are.
    """
    sides = ("Rows", "Columns", "NumberOfFrames", "SamplesPerPixel")
    n_values = math.prod(max(1, int(dataset.get(each, 1) or 1)) for each in sides)
    UnpackingBudget().spend(n_values * max(1, int(dataset.get("BitsAllocated", 8) or 8) // 8))


def _measure_deflated(path: Path) -> None:
    """Check what a deflated file (PS3.5 A.5) unpacks to, which the library does without a limit."""
    meta = read_file_meta_info(path)
    if meta.get("TransferSyntaxUID") != DeflatedExplicitVRLittleEndian:
        return
    begin = _PREAMBLE + len(_MAGIC) + _GROUP_LENGTH + int(meta.get("FileMetaInformationGroupLength", 0))
    try:
        UnpackingBudget().measure_deflated(path.read_bytes()[begin:])
    except zlib.error as error:
        raise OSError(f"its deflated content is damaged ({error})") from error


def _is_encapsulated(dataset: FileDataset) -> bool:
    return "PixelData" in dataset and bool(dataset["PixelData"].is_undefined_length)
