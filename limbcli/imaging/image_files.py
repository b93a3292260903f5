"""Read the image that a case names: a folder with a DICOM series, or one volume file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from limbcli.case.schema import VOLUME_ENDINGS
from limbcli.errors import CaseError
from limbcli.files.dicom import has_preamble
from limbcli.imaging.dicom import PIXEL_MM, STEP_MM, Series, facts_of, read_series
from limbcli.imaging.volume import Volume, require_placed
from limbcli.progress import SILENT, Progress

_LEAST = 3  # smallest number of voxels along every axis
_RIGHT_ANGLE = 1e-2  # largest cosine between two axes that count as perpendicular
# HU: a volume counts as CT if _AIR_SHARE of its values lie below (air is at -1000), which is so in no MRI
_AIR_HU = -500.0
_AIR_SHARE = 5.0  # per cent
# different whole numbers in a volume of that many voxels; an image has hundreds, also one of 8 bits
_MOST_LABELS, _FEWEST_VOXELS = 32, 10_000


def read_image(path: Path, *, progress: Progress = SILENT) -> Series:
    """A DICOM series (a folder, or one file of many frames), or a volume file, in patient LPS.

    A volume file does not state its modality: it is taken as CT if its air is below -500.

    Raises CaseError if it cannot be read, or is not one scalar volume of a limb with its position in the
    patient frame.
    """
    reader = _reader_of(path.name.lower())
    if path.is_dir() or (reader is None and has_preamble(path)):
        return read_series(path, progress=progress)
    if reader is None:
        raise CaseError(
            f"{path.name} is not in a supported image format",
            where=str(path),
            fix="give a folder with one DICOM series, a multi-frame DICOM file, or a volume that ends in "
            f"{', '.join(VOLUME_ENDINGS)}",
        )
    volume = _plausible(reader(path), path)
    # a label map has a few whole numbers, whatever its format
    found = np.unique(volume.values[:, :, :: max(1, volume.shape[2] // 8)])
    few = 1 < len(found) <= _MOST_LABELS and volume.values.size > _FEWEST_VOXELS
    if few and np.array_equal(found, np.round(found)):
        raise CaseError(
            f"the image has {len(found)} different values only, all whole numbers: it is a label map",
            where=str(path),
            fix="[imaging] mri takes the image; a label map belongs in [imaging] labels",
        )
    volume = volume.with_values(np.asarray(volume.values, dtype=np.float32))
    progress.event("note", text=f"{path.name}: {' x '.join(map(str, volume.shape))} voxels")
    notes: list[str] = []
    finite = np.isfinite(volume.values)
    if not finite.all():
        missing = 1.0 - float(finite.mean())
        least = float(volume.values[finite].min()) if finite.any() else 0.0
        volume = volume.with_values(np.where(finite, volume.values, least))
        notes.append(f"{missing:.1%} of the voxels are not numbers; they were treated as air")
    is_ct = float(np.percentile(volume.values, _AIR_SHARE)) < _AIR_HU
    if is_ct:
        notes.append("treated as CT (HU), because of values far below 0")
    return Series(volume=volume, facts=facts_of("CT" if is_ct else "MR", volume), notes=tuple(notes))


def _reader_of(name: str) -> Callable[[Path], Volume] | None:
    """The reader of a volume file of that name; the libraries of the other formats are not imported."""
    end = next((each[:3] for each in VOLUME_ENDINGS if name.endswith(each)), None)
    if end in (".ni", ".hd", ".mg"):
        from limbcli.imaging.nifti import read_nifti

        return read_nifti
    if end == ".mh":
        from limbcli.imaging.metaimage import read_metaimage

        return read_metaimage
    if end is not None:
        from limbcli.imaging.nrrd import read_nrrd_image

        return read_nrrd_image
    return None


def _plausible(volume: Volume, path: Path) -> Volume:
    """Check for enough voxels, perpendicular axes, and sizes suitable for an image of a limb."""
    if min(volume.shape) < _LEAST:
        what = f"the image has {' x '.join(map(str, volume.shape))} voxels; a volume needs {_LEAST} each way"
        raise CaseError(what, where=str(path), fix="use the whole volume")
    units = require_placed(volume.affine, path, noun="image")[:3, :3] / volume.spacing
    if np.abs(units.T @ units - np.eye(3)).max() > _RIGHT_ANGLE:
        what = "the image's axes are not at right angles (a gantry tilt, or a registration with shear)"
        raise CaseError(what, where=str(path), fix="resample it to a straight grid, in 3D Slicer")
    spacing = np.sort(volume.spacing)
    (low, high), (_, highest) = PIXEL_MM, STEP_MM
    if spacing[0] < low or spacing[1] > high or spacing[2] > highest:
        listed = " x ".join(f"{each:g}" for each in volume.spacing)
        raise CaseError(
            f"the image's voxels are {listed} mm; a limb's image has {low:g} to {high:g} mm "
            f"(slices up to {highest:g})",
            where=str(path),
            fix="correct the unit: the format's lengths are mm",
        )
    return volume
