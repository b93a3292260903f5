"""Write a volume as a DICOM MR Image Storage series, one file per slice.

The tags are those that PS3.3 section A.4 requires of the MR image object. All personal data are synthetic,
and the same volume and seed give identical bytes. Stored values have 12 bits with a RescaleSlope other than
1, as some scanners write them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pydicom
from pydicom.dataset import FileDataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, MRImageStorage, generate_uid

from limbcli.model import Array
from limbcli.phantom.mri import VoxelGrid
from limbcli.version import __version__

BITS = 12
DATE = "20260101"


def write_series(
    folder: Path, signal: Array, grid: VoxelGrid, *, subject: str = "phantom", seed: int = 0
) -> list[Path]:
    """Write `signal` (ni columns, nj rows, nk slices; >= 0) as files IM_0001.dcm, ... in `folder`.

    Files are numbered against the slice direction, so that sorting by name alone turns the limb upside down.
    Returns the paths in the order of the slices.
    """
    folder.mkdir(parents=True, exist_ok=True)
    top = 2**BITS - 1
    slope = float(f"{float(signal.max()) / top:.6g}") or 1.0
    stored = np.clip(np.rint(signal / slope), 0, top).astype("<u2")
    # UIDs that depend only on the content (study, series, frame, and a stem for instances)
    stem = [subject, str(seed), str(int(stored.sum(dtype=np.int64))), str(stored.shape)]
    names = ("study", "series", "frame")
    uid = {name: str(generate_uid(entropy_srcs=[*stem, name])) for name in names}
    uid["stem"] = "/".join(stem)
    paths = []
    for k in range(grid.shape[2]):
        number = grid.shape[2] - k
        path = folder / f"IM_{number:04d}.dcm"
        dataset = _empty(path, uid, number)
        _describe(dataset, subject=subject)
        _place(dataset, grid, k, number)
        _pixels(dataset, stored[:, :, k].T, slope=slope)
        dataset.save_as(path, enforce_file_format=True)
        paths.append(path)
    return paths


def _empty(path: Path, uid: dict[str, str], number: int) -> FileDataset:
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = MRImageStorage
    meta.MediaStorageSOPInstanceUID = generate_uid(entropy_srcs=[uid["stem"], f"instance {number}"])
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    meta.ImplementationVersionName = "LIMBCLI"
    dataset = FileDataset(str(path), {}, file_meta=meta, preamble=b"\0" * 128)
    dataset.SOPClassUID = MRImageStorage
    dataset.SOPInstanceUID = meta.MediaStorageSOPInstanceUID
    dataset.StudyInstanceUID = uid["study"]
    dataset.SeriesInstanceUID = uid["series"]
    dataset.FrameOfReferenceUID = uid["frame"]
    return dataset


def _describe(dataset: pydicom.Dataset, *, subject: str) -> None:
    """Patient, study, series, equipment and acquisition: all synthetic."""
    values = {
        "SpecificCharacterSet": "ISO_IR 100",
        "ImageType": ["DERIVED", "PRIMARY", "M", "SE"],
        "StudyDate": DATE,
        "SeriesDate": DATE,
        "ContentDate": DATE,
        "StudyTime": "120000",
        "SeriesTime": "120000",
        "ContentTime": "120000",
        "AccessionNumber": "",
        "Modality": "MR",
        "Manufacturer": "limbcli",
        "ManufacturerModelName": "synthetic subject",
        "SoftwareVersions": __version__,
        "ReferringPhysicianName": "",
        "StudyDescription": "Synthetic residual limb",
        "SeriesDescription": "T1 TSE oblique axial, synthetic",
        "PatientName": f"Phantom^{subject}",
        "PatientID": subject,
        "PatientBirthDate": "",
        "PatientSex": "O",
        "PatientIdentityRemoved": "YES",
        "DeidentificationMethod": "never a person: made by limbcli phantom",
        "BodyPartExamined": "LEG",
        "PatientPosition": "FFS",
        "StudyID": "1",
        "SeriesNumber": 1,
        "AcquisitionNumber": 1,
        "Laterality": "L",
        "PositionReferenceIndicator": "",
        "ScanningSequence": "SE",
        "SequenceVariant": "SK",
        "ScanOptions": "",
        "MRAcquisitionType": "2D",
        "RepetitionTime": "600",
        "EchoTime": "10",
        "EchoTrainLength": 6,
        "MagneticFieldStrength": "3",
        "FlipAngle": "90",
        "ImagedNucleus": "1H",
    }
    for keyword, value in values.items():
        setattr(dataset, keyword, value)


def _place(dataset: pydicom.Dataset, grid: VoxelGrid, k: int, number: int) -> None:
    position = grid.points(np.array([[0.0, 0.0, float(k)]]))[0]
    dataset.InstanceNumber = number
    dataset.ImagePositionPatient = [_decimal(each) for each in position]
    dataset.ImageOrientationPatient = [_decimal(each) for each in grid.axes[:2].ravel()]
    dataset.PixelSpacing = [_decimal(grid.spacing[1]), _decimal(grid.spacing[0])]
    dataset.SliceThickness = _decimal(grid.spacing[2])
    dataset.SpacingBetweenSlices = _decimal(grid.spacing[2])
    dataset.SliceLocation = _decimal(float(position @ grid.axes[2]))


def _decimal(value: float) -> str:
    """A DICOM decimal string: at most 16 characters."""
    return f"{value:.9g}"


def _pixels(dataset: pydicom.Dataset, rows: Array, *, slope: float) -> None:
    dataset.SamplesPerPixel = 1
    dataset.PhotometricInterpretation = "MONOCHROME2"
    dataset.Rows, dataset.Columns = rows.shape
    dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit = 16, BITS, BITS - 1
    dataset.PixelRepresentation = 0
    dataset.RescaleIntercept, dataset.RescaleSlope = "0", _decimal(slope)
    dataset.RescaleType = "US"
    dataset.WindowCenter, dataset.WindowWidth = _decimal(500.0), _decimal(1000.0)
    dataset.PixelData = np.ascontiguousarray(rows).tobytes()
