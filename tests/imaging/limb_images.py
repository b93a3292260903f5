"""A small limb in formulas and its DICOM series, for tests of imaging."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from numpy.typing import NDArray
from pydicom.dataset import FileDataset, FileMetaDataset
from pydicom.filebase import DicomBytesIO
from pydicom.filewriter import write_dataset
from pydicom.uid import (
    ExplicitVRLittleEndian,
    ImplicitVRLittleEndian,
    MRImageStorage,
    SegmentationStorage,
    generate_uid,
)

from limbcli.imaging.volume import Volume

SKIN, FAT, MUSCLE, CORTEX, MARROW, MARKER = 150.0, 900.0, 330.0, 30.0, 860.0, 1000.0


@dataclass(frozen=True)
class Limb:
    """Ellipse with fat, muscle and round bones; z along the limb, mm. The bones end at `bone_end`.

    bones : (x, y, radius, wall) or (x, y, radius, wall, lowest z, highest z)
    """

    half_width: float = 42.0
    half_depth: float = 36.0
    bones: tuple[tuple[float, ...], ...] = ((-4.0, -14.0, 11.0, 3.0), (16.0, 2.0, 6.5, 2.2))
    bone_end: float = -1e9
    markers: tuple[tuple[float, float, float], ...] = ()
    marker_radius: float = 4.5
    signals: dict[str, float] = field(default_factory=dict)

    def signal_and_label(self, points: NDArray) -> tuple[NDArray, NDArray]:
        x, y, z = points.T
        level = {"skin": SKIN, "fat": FAT, "muscle": MUSCLE, "cortex": CORTEX, "marrow": MARROW, "air": 0.0}
        level |= {"marker": MARKER} | self.signals
        depth = (1 - np.hypot(x / self.half_width, y / self.half_depth)) * self.half_depth
        signal, label = np.full(len(x), level["air"]), np.zeros(len(x), np.uint8)
        for floor, name in ((0.0, "skin"), (1.6, "fat"), (6.5, "muscle")):
            signal[depth > floor] = level[name]
        label[depth > 0] = 1
        for bx, by, radius, wall, *ends in self.bones:
            low, high = ends or (self.bone_end, 1e9)
            inside = np.max([np.hypot(x - bx, y - by) - radius, low - z, z - high], axis=0)
            signal[inside < 0] = level["cortex"]
            label[inside < 0] = 2
            signal[inside < -wall] = level["marrow"]
        for centre in self.markers:
            capsule = (np.linalg.norm(points - np.array(centre), axis=1) < self.marker_radius) & (depth <= 0)
            signal[capsule], label[capsule] = level["marker"], 3
        return signal, label

    def image(
        self,
        *,
        shape: tuple[int, int, int] = (104, 92, 16),
        spacing: tuple[float, float, float] = (1.0, 1.0, 4.0),
        rotation: NDArray | None = None,
        noise: float = 12.0,
        seed: int = 7,
        samples: int = 2,
    ) -> tuple[Volume, NDArray]:
        """Image with partial volume and noise, and its true labels (what fills most of a voxel)."""
        affine = np.eye(4)
        affine[:3, :3] = (np.eye(3) if rotation is None else rotation) * np.array(spacing)
        middle = (np.array(shape) - 1) / 2
        affine[:3, 3] = -affine[:3, :3] @ middle
        index = np.indices(shape).reshape(3, -1).T.astype(float)
        offsets = (np.indices((samples,) * 3).reshape(3, -1).T + 0.5) / samples - 0.5
        signal = np.zeros(len(index))
        votes = np.zeros((4, len(index)))
        for offset in offsets:
            points = (index + offset) @ affine[:3, :3].T + affine[:3, 3]
            value, label = self.signal_and_label(points)
            signal += value / len(offsets)
            votes[label, np.arange(len(index))] += 1
        rng = np.random.default_rng(seed)
        noisy = np.hypot(
            signal + noise * rng.standard_normal(len(signal)), noise * rng.standard_normal(len(signal))
        )
        return Volume(noisy.reshape(shape).astype(np.float32), affine), votes.argmax(axis=0).reshape(shape)


def dice(a: NDArray, b: NDArray) -> float:
    return float(2 * (a & b).sum() / max(a.sum() + b.sum(), 1))


Change = Callable[[pydicom.Dataset, int], None]


def write_dicom(
    folder: Path,
    volume: Volume,
    *,
    slope: float = 1.0,
    intercept: float = 0.0,
    syntax: str = ExplicitVRLittleEndian,
    series: int = 1,
    change: Change | None = None,
    skip: tuple[int, ...] = (),
    signed: bool = False,
    bits: int = 16,
    stem: str = "im",
) -> list[Path]:
    """A slice a file, named in a scrambled order. `change(dataset, k)` edits each before it is written."""
    folder.mkdir(parents=True, exist_ok=True)
    kind = {(16, False): "<u2", (16, True): "<i2", (8, False): "u1"}[bits, signed]
    stored = np.rint((volume.values - intercept) / slope).astype(kind)
    series_uid, paths = generate_uid(entropy_srcs=[str(folder), str(series)]), []
    for k in range(volume.shape[2]):
        if k in skip:
            continue
        path = folder / f"{stem}{(k * 7) % volume.shape[2]:03d}_{k}.dcm"
        dataset = _header(path, volume, k, series_uid, series, syntax)
        dataset.RescaleSlope, dataset.RescaleIntercept = f"{slope:.6g}", f"{intercept:.6g}"
        dataset.BitsAllocated = dataset.BitsStored = bits
        dataset.HighBit, dataset.PixelRepresentation = bits - 1, int(signed)
        dataset.PixelData = np.ascontiguousarray(stored[:, :, k].T).tobytes()
        dataset["PixelData"].VR = "OW"
        if change is not None:
            change(dataset, k)
        dataset.save_as(path, enforce_file_format=True)
        paths.append(path)
    return paths


def _header(path: Path, volume: Volume, k: int, series_uid: str, series: int, syntax: str) -> FileDataset:
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = MRImageStorage
    meta.MediaStorageSOPInstanceUID = generate_uid(entropy_srcs=[str(path)])
    meta.TransferSyntaxUID = syntax
    dataset = FileDataset(str(path), {}, file_meta=meta, preamble=b"\0" * 128)
    directions = volume.affine[:3, :3] / volume.spacing
    values: dict[str, Any] = {
        "SOPClassUID": MRImageStorage,
        "SOPInstanceUID": meta.MediaStorageSOPInstanceUID,
        "SeriesInstanceUID": series_uid,
        "StudyInstanceUID": "1.2.3",
        "PatientName": "Secret^Name",
        "PatientID": "ID-4711",
        "PatientBirthDate": "19700131",
        "InstitutionName": "Hidden Hospital",
        "Modality": "MR",
        "SeriesNumber": series,
        "InstanceNumber": 1,
        "Rows": volume.shape[1],
        "Columns": volume.shape[0],
        "SamplesPerPixel": 1,
        "PhotometricInterpretation": "MONOCHROME2",
        "PixelSpacing": [f"{volume.spacing[1]:.9g}", f"{volume.spacing[0]:.9g}"],
        "ImageOrientationPatient": [f"{each:.10g}" for each in directions[:, :2].T.ravel()],
        "ImagePositionPatient": [f"{each:.10g}" for each in volume.to_patient(np.array([[0.0, 0.0, k]]))[0]],
    }
    for keyword, value in values.items():
        setattr(dataset, keyword, value)
    return dataset


def without_meta(path: Path, syntax: str = ImplicitVRLittleEndian) -> None:
    """Write a DICOM file anew as its plain dataset: no preamble, no file meta information."""
    dataset = pydicom.dcmread(path)
    plain = pydicom.Dataset(dataset)
    buffer = DicomBytesIO()
    buffer.is_implicit_VR, buffer.is_little_endian = syntax == ImplicitVRLittleEndian, True
    write_dataset(buffer, plain)
    path.write_bytes(buffer.getvalue())


def dicom_seg(path: Path, truth: Volume, names: dict[str, int]) -> Path:
    """A DICOM SEG of binary segments; names : the value of each in `truth`."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = SegmentationStorage, "1.2.3.4"
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset = FileDataset(str(path), {}, file_meta=meta, preamble=b"\0" * 128)
    dataset.SOPClassUID, dataset.SOPInstanceUID, dataset.Modality = SegmentationStorage, "1.2.3.4", "SEG"
    dataset.Rows, dataset.Columns, dataset.SegmentationType = truth.shape[1], truth.shape[0], "BINARY"
    dataset.SamplesPerPixel, dataset.PhotometricInterpretation = 1, "MONOCHROME2"
    dataset.BitsAllocated = dataset.BitsStored = 1
    dataset.HighBit = dataset.PixelRepresentation = 0
    orientation, measures, shared = pydicom.Dataset(), pydicom.Dataset(), pydicom.Dataset()
    directions = truth.affine[:3, :3] / truth.spacing
    orientation.ImageOrientationPatient = [f"{x:.9g}" for x in directions[:, :2].T.ravel()]
    measures.PixelSpacing, measures.SliceThickness = [truth.spacing[1], truth.spacing[0]], truth.spacing[2]
    shared.PlaneOrientationSequence, shared.PixelMeasuresSequence = [orientation], [measures]
    dataset.SharedFunctionalGroupsSequence = [shared]
    planes, groups, segments = [], [], []
    for number, (name, value) in enumerate(names.items(), 1):
        segment = pydicom.Dataset()
        segment.SegmentNumber, segment.SegmentLabel = number, name
        segments.append(segment)
        for k in range(truth.shape[2]):
            mask = truth.values[:, :, k] == value
            if not mask.any():
                continue
            position, identity, group = pydicom.Dataset(), pydicom.Dataset(), pydicom.Dataset()
            place = truth.to_patient(np.array([[0.0, 0.0, k]]))[0]
            position.ImagePositionPatient = [f"{x:.10g}" for x in place]
            identity.ReferencedSegmentNumber = number
            group.PlanePositionSequence, group.SegmentIdentificationSequence = [position], [identity]
            planes.append(mask.T)
            groups.append(group)
    dataset.SegmentSequence, dataset.PerFrameFunctionalGroupsSequence = segments, groups
    dataset.NumberOfFrames = len(planes)
    bits = np.packbits(np.stack(planes).ravel(), bitorder="little").tobytes()
    dataset.PixelData = bits + b"\0" * (len(bits) % 2)
    dataset["PixelData"].VR = "OB"
    dataset.save_as(path, enforce_file_format=True)
    return path
