"""Read DICOM files, also those without the 128-byte preamble or the file meta information (PS3.10, 7.1).

Consoles of scanners and old archives store plain datasets. What their file meta information would say of the
encoding is seen from the first element.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import pydicom
from pydicom.dataset import FileDataset
from pydicom.errors import InvalidDicomError
from pydicom.uid import ExplicitVRBigEndian, ExplicitVRLittleEndian, ImplicitVRLittleEndian

_PREAMBLE, _MAGIC = 128, b"DICM"


def has_preamble(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(_PREAMBLE + len(_MAGIC))[_PREAMBLE:] == _MAGIC


def read_dicom(path: Path) -> FileDataset:
    """Read a DICOM file; without a stated transfer syntax, it is that of the dataset's own encoding.

    Compressed pixels without a stated transfer syntax remain without one, and cannot be decoded.

    Raises
    ------
    pydicom.errors.InvalidDicomError
        If the file is no DICOM file: without preamble, it must name its SOP Class or its modality and size.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        dataset = pydicom.dcmread(path, force=True)
        plain = "SOPClassUID" in dataset or ("Modality" in dataset and "Rows" in dataset)
    if not has_preamble(path) and not plain:
        raise InvalidDicomError(f"{path.name} has neither the DICOM preamble nor the tags of an image")
    if "TransferSyntaxUID" not in dataset.file_meta and not _is_encapsulated(dataset):
        is_implicit, is_little = dataset.original_encoding
        explicit = ExplicitVRLittleEndian if is_little else ExplicitVRBigEndian
        dataset.file_meta.TransferSyntaxUID = ImplicitVRLittleEndian if is_implicit else explicit
    return dataset


def _is_encapsulated(dataset: FileDataset) -> bool:
    return "PixelData" in dataset and bool(dataset["PixelData"].is_undefined_length)
