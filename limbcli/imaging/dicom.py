"""Read a DICOM series as a `Volume`: slices in order of position, in the patient frame.

Only geometry, signal and a few technical facts leave this module; nothing that could identify the patient.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset
from pydicom.errors import InvalidDicomError

from limbcli.case.schema import VOLUME_ENDINGS
from limbcli.errors import CaseError
from limbcli.errors.problems import shortened
from limbcli.files.dicom import DICOM_DAMAGED, has_preamble, read_dicom, tag_words
from limbcli.imaging.dicom_identity import one_body, public_name
from limbcli.imaging.frames import FLOAT_PIXELS, Slice, damaged, should_be_image, slices_of, turned_over
from limbcli.imaging.stacking import stack
from limbcli.imaging.volume import Volume
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

_PIXELS = ("PixelData", *FLOAT_PIXELS)
_PARALLEL = 1e-3  # largest change of a direction cosine between slices of one series
_OWN_UIDS = 0.4  # with more distinct series UIDs than this fraction of the images, the UIDs are uninformative
_DOUBLED = 0.05  # slices closer than this fraction of the slice spacing are duplicates
# tags that tell apart echoes, the images of Dixon's method, time points and diffusion weightings; of a series
# and of the frames of one file
_OF_CONTRAST = (
    "ImageType", "EchoNumbers", "EchoTime", "InversionTime", "TemporalPositionIdentifier", "DiffusionBValue",
    "AcquisitionNumber", "FrameType", "EffectiveEchoTime", "TemporalPositionIndex", "StackID",
)  # fmt: skip
_MOST_CONTRASTS = 8
_FEWEST = 3  # slices of a volume
_PLAIN, _SHORT = str.maketrans("", "", "[]'"), 60  # of a tag's value as it is shown
# this many gaps that differ by less than this fraction are a spacing of their own
_RUN, _SAME_GAP = 3, 0.05
# plausible pixel size and slice spacing of an image of a limb, mm
PIXEL_MM, STEP_MM = (0.05, 8.0), (0.05, 30.0)
_MISSING = 1.5  # a gap wider than this multiple of the slice spacing lacks a slice


@dataclass(frozen=True, eq=False)
class Series:
    """One image series.

    volume : signal after rescale slope and intercept, with its position in the patient frame
    facts : technical facts without identity (modality, spacing_mm, n_slices, ...)
    notes : repairs made on reading, one sentence each
    """

    volume: Volume
    facts: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_series(folder: Path, *, progress: Progress = SILENT) -> Series:
    """Read the only DICOM series in a folder.

    folder : searched recursively; other files (licence, DICOMDIR) are ignored. Or one multi-frame file

    Returns the series, signal in the scanner's units (HU for CT)

    Raises CaseError for no DICOM files, no pixel data, two series; slices missing, duplicate, not parallel or
    of different size; the message names the tag and the fix.
    """
    datasets, left_out = _images(folder, progress)
    try:
        remarks = left_out + _one_series(datasets, folder) + one_body(datasets, folder)
    except DICOM_DAMAGED as error:
        raise damaged(str(folder), error) from error
    slices: list[Slice] = []
    for name, dataset in datasets:
        try:
            slices += slices_of(dataset, name)
        except DICOM_DAMAGED as error:
            raise damaged(name, error) from error
    if len(slices) < _FEWEST:
        raise CaseError(
            f"the series has {len(slices)} image(s); a volume needs at least {_FEWEST}",
            where=str(folder),
            fix=f"give the folder with all of its slices: [imaging] mri names the file {folder.name} alone"
            if folder.is_file()
            else "put every slice of the series into the folder",
        )
    _same_shape(slices, folder)
    normal = _common_normal(slices, folder)
    heights = np.array([each.position @ normal for each in slices])
    order = np.argsort(heights, kind="stable")
    slices, heights = [slices[n] for n in order], heights[order]
    step = _slice_step(slices, heights, folder, datasets)
    _plausible(slices[0], step, folder)
    volume, notes = stack(slices, heights, step)
    if turned_over(datasets[0][1]):
        volume = volume.with_values(volume.values - volume.values.min())
        notes = (*notes, "Photometric Interpretation (0028,0004) is MONOCHROME1: the signal was inverted")
    return Series(
        volume=volume, facts=facts_of(str(datasets[0][1].get("Modality", "")), volume), notes=remarks + notes
    )


def _images(folder: Path, progress: Progress) -> tuple[list[tuple[str, Dataset]], tuple[str, ...]]:
    """Every DICOM image below `folder`, by name; and a note on the DICOM files that are none."""
    if not folder.exists():
        raise CaseError(
            "the folder of the MRI series does not exist",
            where=str(folder),
            fix="set [imaging] mri in case.toml",
        )
    below = [folder] if folder.is_file() else folder.rglob("*")
    paths = sorted(path for path in below if path.is_file() and path.name != "DICOMDIR")
    found, without_pixels, cut = [], Counter[str](), []
    for number, path in enumerate(paths, 1):
        dataset = _read(path, number)
        if dataset is None:
            continue
        if any(each in dataset for each in _PIXELS):
            try:
                found.append((public_name(path, dataset, number), dataset))
            except DICOM_DAMAGED as error:
                raise damaged(f"file {number} in order of name", error) from error
        else:
            without_pixels[str(dataset.get("Modality", ""))[:_SHORT] or "no modality"] += 1
            cut += [number] if should_be_image(dataset) else []
        if number % 20 == 0 or number == len(paths):
            progress.event("task", name="reading DICOM", done=number, total=len(paths))
    if found and cut:
        listed = ", ".join(map(str, cut[:6]))
        raise CaseError(
            f"{len(cut)} of {len(found) + len(cut)} images end before their pixel data (7FE0,0010): "
            f"file {listed} in order of name",
            where=str(folder),
            fix="the files are truncated: copy the series again",
            n_cut=len(cut),
        )
    kinds = ", ".join(f"{count} {kind}" for kind, count in without_pixels.items())
    if found:
        contours = "; to use the contours, give the file as [imaging] labels" * ("RTSTRUCT" in without_pixels)
        left_out = (f"DICOM files without an image were left out: {kinds}{contours}",) if kinds else ()
        return found, left_out
    if without_pixels:
        raise CaseError(
            f"the {without_pixels.total()} DICOM files contain no pixel data (7FE0,0010): {kinds}",
            where=str(folder),
            fix="export the images again, not only their headers or a DICOMDIR",
        )
    volumes = [
        path.relative_to(folder).as_posix() for path in paths if path.name.lower().endswith(VOLUME_ENDINGS)
    ]
    raise CaseError(
        f"there is no DICOM file among the {len(paths)} files" if paths else "the folder is still empty",
        where=str(folder),
        fix=f"name the file itself in [imaging] mri: the folder holds {shortened(volumes)}"
        if volumes
        else "put the files of one DICOM series there; [imaging] mri gives the folder",
    )


def _read(path: Path, number: int) -> Dataset | None:
    """A dataset, or None if the file is not DICOM. Files without the DICM preamble are also accepted.

    A file with the preamble that cannot be read is an error: if it were skipped, its absence might go
    unnoticed.
    """
    try:
        dataset = read_dicom(path)
    except InvalidDicomError:
        return None
    except DICOM_DAMAGED as error:
        if has_preamble(path):
            raise damaged(f"file {number} in order of name", error) from error
        return None
    return dataset if has_preamble(path) or "Rows" in dataset else None


def _one_series(datasets: list[tuple[str, Dataset]], folder: Path) -> tuple[str, ...]:
    """Refuse a folder with several series; return a note if the series UIDs are uninformative."""
    uids = Counter(str(dataset.get("SeriesInstanceUID", "")) for _, dataset in datasets)
    if len(uids) == 1:
        return ()
    kinds = Counter(_kind(dataset) for _, dataset in datasets)
    if len(kinds) == 1 and len(uids) > _OWN_UIDS * len(datasets):
        return ("every image has its own Series Instance UID (0020,000E); treated as one series",)
    if len(uids) == len(datasets):
        listed = ", ".join(
            f"series {kind[0] or '?'} with {count} images" for kind, count in kinds.most_common()
        )
        n_series = len(kinds)
    else:
        numbers = {
            str(dataset.get("SeriesInstanceUID", "")): dataset.get("SeriesNumber") for _, dataset in datasets
        }
        listed = ", ".join(f"series {numbers[uid] or '?'} with {n} images" for uid, n in uids.most_common(6))
        n_series = len(uids)
    raise CaseError(
        f"the folder contains {n_series} series: {listed}",
        where=str(folder),
        fix="move all series except one (Series Instance UID, 0020,000E) to another folder",
        n_series=n_series,
    )


def _kind(dataset: Dataset) -> tuple[str, ...]:
    """Properties that images of one series share, regardless of their UIDs."""
    names = (
        "SeriesNumber", "Modality", "Rows", "Columns", "EchoTime", "ImageOrientationPatient", "PixelSpacing",
    )  # fmt: skip
    return tuple(str(dataset.get(name, "")) for name in names)


def _same_shape(slices: list[Slice], folder: Path) -> None:
    kinds = [(each.pixels.shape, tuple(np.round(each.pixel_spacing, 4))) for each in slices]
    if len(set(kinds)) > 1:
        ((usual, _),) = Counter(kinds).most_common(1)
        odd = [each.name for each, kind in zip(slices, kinds, strict=True) if kind != usual]
        raise CaseError(
            f"{len(odd)} of {len(slices)} images differ in size or Pixel Spacing (0028,0030): "
            f"{shortened(odd)}",
            where=str(folder),
            fix="remove the images that do not belong to the volume (localiser, screenshot)",
        )


def _common_normal(slices: list[Slice], folder: Path) -> Array:
    first = slices[0]
    odd = [
        each.name
        for each in slices
        if np.abs(each.along_row - first.along_row).max() > _PARALLEL
        or np.abs(each.along_column - first.along_column).max() > _PARALLEL
    ]
    if odd:
        raise CaseError(
            f"{len(odd)} of {len(slices)} slices are not parallel to the first, by Image Orientation "
            f"(0020,0037): {shortened(odd)}",
            where=str(folder),
            fix="remove the slices that do not belong to the volume (localiser)",
            n_not_parallel=len(odd),
        )
    return first.normal


def _separately(datasets: list[tuple[str, Dataset]]) -> str:
    """What to do about several images of one position, and by what these can be told apart, if known."""
    fix = "remove the duplicate files; several echoes, contrasts or time points must be separate folders"
    if len(datasets) == 1:
        fix = (
            "the file holds several echoes, contrasts or time points: dcm2niix makes a NIfTI file of each; "
            "give one of these"
        )
    images = [image for _, dataset in datasets for image in _described(dataset)]
    for keyword in _OF_CONTRAST:
        found = Counter(str(each.get(keyword, "none")).translate(_PLAIN)[:_SHORT] for each in images)
        if 1 < len(found) <= _MOST_CONTRASTS:
            listed = ", ".join(f"{value} ({count} images)" for value, count in found.most_common())
            return f"{fix}; these differ in {tag_words(keyword)}: {listed}"
    return fix


def _described(dataset: Dataset) -> list[Dataset]:
    """What is said of each image in a file: of every frame, if they have groups of their own."""
    frames = []
    try:
        for groups in dataset.get("PerFrameFunctionalGroupsSequence", ()):
            frames.append(Dataset())
            for each in groups:
                if each.VR == "SQ" and len(each.value):
                    frames[-1].update(each.value[0])
    except DICOM_DAMAGED:
        return [dataset]
    return frames or [dataset]


def _slice_step(
    slices: list[Slice], heights: Array, folder: Path, datasets: list[tuple[str, Dataset]]
) -> float:
    """The usual slice spacing; duplicate and missing slices are errors."""
    gaps = np.diff(heights)
    step = float(np.median(gaps))
    if step <= 0 or (gaps < _DOUBLED * max(step, 1e-6)).any():
        pairs = np.flatnonzero(gaps < max(_DOUBLED * step, 1e-3))
        named = [f"{slices[n].name} = {slices[n + 1].name}" for n in pairs]
        raise CaseError(
            f"{len(pairs)} slices lie at the same position as another: {shortened(named)}",
            where=str(folder),
            fix=_separately(datasets),
            n_doubled=len(pairs),
        )
    wide = np.flatnonzero(gaps > _MISSING * step)
    if len(wide) and not _spaced_wider(slices, gaps, wide):
        named = [f"between {slices[n].name} and {slices[n + 1].name} ({gaps[n]:.2f} mm)" for n in wide]
        missing = int(np.round(gaps[wide] / step - 1).sum())
        raise CaseError(
            f"about {missing} slice(s) are missing: {shortened(named)}; the usual distance is {step:.2f} mm",
            where=str(folder),
            fix="copy the whole series again"
            + "; if they were taken at this distance, give their Instance Numbers (0020,0013)"
            * (len(wide) > 2),
            n_missing=missing,
        )
    return step


def _spaced_wider(slices: list[Slice], gaps: Array, wide: NDArray[np.integer]) -> bool:
    """Whether wide gaps are the series' own spacing there: runs of equal gaps, numbered without a gap."""
    numbers = [each.number for each in slices]
    if any(each is None for each in numbers):
        return False
    steps = np.abs(np.diff(np.array(numbers, dtype=np.float64)))
    runs = np.split(wide, np.flatnonzero(np.diff(wide) > 1) + 1)
    even = all(len(run) >= _RUN and np.ptp(gaps[run]) <= _SAME_GAP * gaps[run].min() for run in runs)
    return bool(even and (steps == steps[0]).all() and steps[0] > 0)


def _plausible(first: Slice, step: float, folder: Path) -> None:
    """Check that pixel size and slice spacing suit a limb; other values come from a wrong unit or tag."""
    for what, tag, value, (low, high) in (
        ("Pixel Spacing", "0028,0030", max(first.pixel_spacing), PIXEL_MM),
        ("the distance of slices by Image Position", "0020,0032", step, STEP_MM),
    ):
        if not low <= value <= high:
            raise CaseError(
                f"{what} ({tag}) is {value:g} mm; a limb's image has {low:g} to {high:g} mm",
                where=str(folder),
                fix="correct the tag (mm), or use a label map or surfaces instead",
            )


def facts_of(modality: str, volume: Volume) -> dict[str, Any]:
    """Technical facts only.

    Free-text tags (descriptions, institution) may identify the patient and are omitted.
    """
    return {
        "modality": modality,
        "n_slices": volume.shape[2],
        "matrix": list(volume.shape[:2]),
        "spacing_mm": [round(float(each), 4) for each in volume.spacing],
    }
