"""Read label maps in the formats of segmentation programs and convert them to our labels.

Whatever the format, a file is a list of segments, each with a number, a name or both. A segment is, in this
order, what [imaging.labels] says of its number or name, what its name says (of a file of names that the
table names, else its own), what the preset says of its number. A file without names, preset and table
contains our numbers (1 soft tissue, 2 bone, 3 marker, 4 fat), unless no limb can be so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from limbcli.case.label_sources import LabelSource
from limbcli.case.schema import VOLUME_ENDINGS
from limbcli.errors import CaseError
from limbcli.errors.problems import shortened
from limbcli.files.dicom import has_preamble
from limbcli.imaging.dicom_seg import read_dicom_segments
from limbcli.imaging.label_frame import in_order_of, same_grid
from limbcli.imaging.label_names import (
    OURS,
    OUTSIDE,
    PRESETS,
    WORDS,
    Meaning,
    meaning_of,
    preset_of,
    presets_with,
)
from limbcli.imaging.labels import checked_labels, require_three_dimensions
from limbcli.imaging.metaimage import read_metaimage
from limbcli.imaging.nifti import read_nifti_labels
from limbcli.imaging.nrrd import Nrrd, read_nrrd
from limbcli.imaging.segmentation import BONE, FAT, MARKER, SOFT_TISSUE
from limbcli.imaging.unnamed_labels import unnamed_label_doubts
from limbcli.imaging.volume import Volume, require_placed

_ORDER = (SOFT_TISSUE, FAT, BONE, MARKER)  # drawing order: a later kind overwrites an earlier one
_DICOM, _NRRD, _META = (".dcm", ".ima"), (".nrrd", ".nhdr"), (".mha", ".mhd")
_MOST_NUMBERS = 500  # with more different values, a file is an image, not a label map
_ROUNDING = 1e-3  # numbers stored as scaled integers or floats are whole within this
_SHOWN = 40  # numbers or names listed in one message
_TABLE = "[imaging.labels]"


@dataclass(frozen=True, eq=False)
class Segment:
    """One segment of a label map.

    number : its number in the file, None if it has none; name : empty if the file gives none
    load : its layer; value : the segment's voxels have this value, with None all above 0.5
    """

    number: int | None
    name: str
    load: Callable[[], Volume]
    value: int | None

    @property
    def title(self) -> str:
        return " ".join(each for each in (str(self.number or ""), self.name) if each)

    def mask(self) -> Volume:
        layer = self.load()
        return layer.with_values(layer.values > 0.5 if self.value is None else layer.values == self.value)


@dataclass(frozen=True, eq=False)
class LabelMap:
    """A label map in our numbers, and what each segment was taken for.

    volume : uint8, our labels
    bone_of : uint8, on the same grid: n where the voxel is of the bone `bone_names[n - 1]`, else 0
    up_to_skin : whether the map contains everything up to the skin; muscles and bones alone do not
    lines : a sentence for every kind of tissue and file
    """

    volume: Volume
    bone_of: Volume
    bone_names: tuple[str, ...]
    up_to_skin: bool
    lines: tuple[str, ...]


def read_label_file(path: Path) -> Volume:
    """Read a label map of one file or folder, without a table or preset, in patient LPS.

    Raises CaseError if the file cannot be read, its values or names are not understood, or soft tissue or
    bone is missing.
    """
    return read_label_map((LabelSource(path),)).volume


def read_label_map(sources: Sequence[LabelSource], *, is_whole: bool = True) -> LabelMap:
    """Combine the segments of one or several label maps into one in our numbers, in patient LPS.

    Bone overwrites soft tissue, markers overwrite everything, and of two bones the later source counts.
    Several sources must have one grid.

    is_whole : whether soft tissue is required; without, an image can supply it

    Raises CaseError if a file cannot be read; listing all its segments that are not understood; if a tissue
    is missing.
    """
    named = [(source, *each) for source in sources for each in read_segments(source)]
    path = sources[0].path
    if not named:
        raise CaseError("the label map is empty", where=str(path), fix="export the segmentation again")
    drawn = sorted(
        (n for n, (_, _, meaning) in enumerate(named) if meaning.label in _ORDER),
        key=lambda n: _ORDER.index(named[n][2].label),
    )
    if not drawn:
        what = "nothing in the label map is a tissue of a limb"
        raise CaseError(what, where=str(path), fix=f"name its segments in {_TABLE}: {WORDS}")
    grid = named[drawn[0]][1].load()
    labels, bone_of = (np.zeros(grid.values.shape, np.uint8) for _ in range(2))
    bone_names = tuple(dict.fromkeys(meaning.bone for *_, meaning in named if meaning.bone))
    found = set()
    for n in drawn:
        source, segment, meaning = named[n]
        inside = _on_grid(segment.mask(), grid, source.path, path)
        if inside.any():
            found.add(n)
        labels[inside] = meaning.label
        bone_of[inside] = bone_names.index(meaning.bone) + 1 if meaning.bone else 0
    present = [each for n, each in enumerate(named) if n in found or each[2].label not in _ORDER]
    volume = checked_labels(grid.with_values(labels), path, is_whole=is_whole)
    return LabelMap(
        volume=volume,
        bone_of=volume.with_values(bone_of),
        bone_names=bone_names,
        up_to_skin=any(meaning.up_to_skin for *_, meaning in present),
        lines=tuple(line for source in sources for line in _lines(source, present)),
    )


def read_segments(source: LabelSource) -> list[tuple[Segment, Meaning]]:
    """The segments of one source and what each is; empty ones whose name is not understood are left out.

    Raises CaseError if a file cannot be read, or listing every number or name that is not understood.
    """
    segments = [
        replace(each, name=source.titles.get(str(each.number), each.name)) for each in _segments(source.path)
    ]
    numbers = [each.number for each in segments if each.number is not None]
    stated = _stated(source)
    preset = _preset(source, numbers)
    is_ours = not (stated or preset or source.titles or any(each.name for each in segments))
    meanings = [
        OURS.get(each.number or 0) if is_ours else _meaning(each, stated, preset) for each in segments
    ]
    unknown = [
        segment
        for segment, meaning in zip(segments, meanings, strict=True)
        if meaning is None and segment.mask().values.any()
    ]
    if unknown:
        raise _not_understood(unknown, segments, source)
    if is_ours and segments and (doubts := unnamed_label_doubts(_in_numbers(segments, source.path))):
        raise CaseError(
            "the label map does not say what its numbers are, and they cannot be limbcli's: "
            + "; ".join(doubts),
            where=str(source.path),
            fix=f'in {_TABLE} with file = "{source.path.name}", say what each is: '
            + ", ".join(f'{each.number} = "..."' for each in segments)
            + f" ({WORDS})",
        )
    found = [(segment, each) for segment, each in zip(segments, meanings, strict=True) if each is not None]
    _agree(found, preset, stated, source)
    return [(_called(segment, preset), each) for segment, each in found]


def _in_numbers(segments: Sequence[Segment], path: Path) -> Volume:
    """The segments of one grid as a map of their numbers, whose position is checked."""
    grid = segments[0].load()
    require_placed(grid.affine, path, noun="label map")
    values = np.zeros(grid.values.shape, np.uint8)
    for each in segments:
        values[each.mask().values] = each.number or 0
    return grid.with_values(values)


def _meaning(
    segment: Segment, stated: dict[str, Meaning], preset: dict[int, tuple[str, Meaning]]
) -> Meaning | None:
    for key in (str(segment.number), segment.name.strip().lower()):
        if key in stated:
            return stated[key]
    by_name = meaning_of(segment.name)
    return by_name or (preset[segment.number][1] if segment.number in preset else None)


def _called(segment: Segment, preset: dict[int, tuple[str, Meaning]]) -> Segment:
    """The segment with the preset's name if the file gives it none."""
    if segment.name or segment.number not in preset:
        return segment
    return replace(segment, name=preset[segment.number][0])


def _stated(source: LabelSource) -> dict[str, Meaning]:
    """What the table says of each number, or name in lower case."""
    meanings = {key.strip().lower(): meaning_of(word) for key, word in source.names.items()}
    wrong = [
        f"{key} = {source.names[key]!r}" for key in source.names if meanings[key.strip().lower()] is None
    ]
    if wrong:
        what = f"{_TABLE} has words that are no tissue: {', '.join(wrong)}"
        raise CaseError(what, where=str(source.path), fix=f"use {WORDS}")
    return {key: each for key, each in meanings.items() if each is not None}


def _preset(source: LabelSource, numbers: Sequence[int]) -> dict[int, tuple[str, Meaning]]:
    if source.preset is None:
        return {}
    found = preset_of(source.preset, numbers)
    if found:
        return found
    if found is None:
        what = f"{_TABLE} preset = {source.preset!r} is not known"
        fix = f"use {', '.join(PRESETS)}, or give the numbers themselves (number = {WORDS})"
    else:
        what = f"versions of {source.preset} give the numbers in this file different meanings"
        start = source.preset.lower()
        fix = f"say which version wrote it: preset = {' or '.join(p for p in PRESETS if p.startswith(start))}"
    raise CaseError(what, where=str(source.path), fix=fix)


def _agree(
    found: Sequence[tuple[Segment, Meaning]],
    preset: dict[int, tuple[str, Meaning]],
    stated: dict[str, Meaning],
    source: LabelSource,
) -> None:
    """Check that the file's own names do not contradict the preset, unless the table decides."""
    for segment, meaning in found:
        if segment.number not in preset or not segment.name:
            continue
        if str(segment.number) in stated or segment.name.strip().lower() in stated:
            continue
        name, other = preset[segment.number]
        if (other.label, other.bone) != (meaning.label, meaning.bone):
            raise CaseError(
                f"the file calls {segment.number} {segment.name!r}, but the preset {source.preset} calls it "
                f"{name!r}",
                where=str(source.path),
                fix=f"remove the preset (the file's own names count), or give {segment.number} in {_TABLE}",
            )


def _not_understood(
    unknown: Sequence[Segment], segments: Sequence[Segment], source: LabelSource
) -> CaseError:
    names = [each.name for each in unknown if each.name]
    titles = [each.title for each in unknown]
    listed = shortened(titles, most=_SHOWN)
    if names:
        what = f"the segment name(s) {listed} are not recognised, or refer to several kinds of tissue"
    else:
        what = f"the label map contains the value(s) {listed}"
    lines = ", ".join(f'{_key(each)} = "ignore"' for each in unknown[:_SHOWN])
    table = "" if source.preset or source.names else f' with file = "{source.path.name}"'
    fix = f"in {_TABLE}{table}, say what each is, or that it is not needed: {lines} (or {WORDS})"
    numbers = [each.number for each in segments if each.number is not None and not each.name]
    presets = [] if len(numbers) < len(segments) or source.preset else presets_with(numbers)
    if table and len(numbers) == len(segments):
        fix += '; or names = "..." where a file names them (of ITK-SNAP, 3D Slicer, nnU-Net)'
    if presets:
        fix += f"; if one of these programs wrote it: preset = {' or '.join(map(repr, presets[:4]))}"
    if table and len(numbers) == len(segments):
        fix = f"use 0 outside, 1 soft tissue, 2 bone, 3 marker, 4 fat; or {fix}"
    return CaseError(what, where=str(source.path), fix=fix, unknown=titles)


def _key(segment: Segment) -> str:
    """A segment as a key of TOML: its number where it has one."""
    return str(segment.number) if segment.number is not None else f'"{segment.name}"'


def label_lines(source: LabelSource) -> list[str]:
    """A line for each kind of tissue in a source: which numbers and names are taken for it.

    Raises CaseError as `read_segments`.
    """
    found = [(source, *each) for each in read_segments(source)]
    return _lines(source, [each for each in found if each[2].label == OUTSIDE or each[1].mask().values.any()])


def _lines(source: LabelSource, present: Sequence[tuple[LabelSource, Segment, Meaning]]) -> list[str]:
    """A line for each kind in the source: which numbers and names were taken for it."""
    kinds: dict[str, list[str]] = {}
    for other, segment, meaning in present:
        if other is source:
            kinds.setdefault(meaning.words, []).append(segment.title)
    return [f"{source.path.name}: taken for {kind}: {', '.join(titles)}" for kind, titles in kinds.items()]


def _on_grid(mask: Volume, grid: Volume, path: Path, first: Path) -> NDArray[np.bool_]:
    """The mask in the order of the grid's axes."""
    if mask.values.shape == grid.values.shape and np.allclose(mask.affine, grid.affine, atol=1e-3):
        return np.asarray(mask.values)
    if not same_grid(mask, grid):
        raise CaseError(
            f"the label maps have different grids: {path.name} {' x '.join(map(str, mask.shape))} voxels, "
            f"{first.name} {' x '.join(map(str, grid.shape))}, or another position",
            where=str(path),
            fix="export all of them on the grid of the image",
        )
    return np.asarray(in_order_of(grid, mask).values)


def _segments(path: Path) -> list[Segment]:
    """Every segment of a file or folder."""
    if path.is_dir():
        return _of_folder(path)
    name = path.name.lower()
    if _is_dicom(path):
        return _of_dicom(path)
    if not name.endswith(VOLUME_ENDINGS):
        raise CaseError(
            f"{path.name} is not in a format of label maps that is read",
            where=str(path),
            fix=f"give a DICOM SEG or RTSTRUCT, or a file that ends in {', '.join(VOLUME_ENDINGS)}; of a "
            "pair (.hdr, .img) the .hdr; a mesh: convert it in 3D Slicer or ITK-SNAP, with the image as "
            "reference",
        )
    if name.endswith(_NRRD):
        nrrd = read_nrrd(path)
        return _of_seg_nrrd(nrrd, path) or _by_number(Volume(nrrd.values, nrrd.affine), {}, path)
    return _by_number(*_numbers_in(path), path)


def _is_dicom(path: Path) -> bool:
    """Whether a file is DICOM, by its ending, or by its content where it has no ending of a volume."""
    name = path.name.lower()
    unnamed = not name.endswith(VOLUME_ENDINGS) and path.is_file()
    return name.endswith(_DICOM) or (unnamed and has_preamble(path))


def _numbers_in(path: Path) -> tuple[Volume, dict[int, str]]:
    """The values of a file of numbers, and the names that it gives them."""
    name = path.name.lower()
    if name.endswith(_NRRD):
        nrrd = read_nrrd(path)
        return Volume(nrrd.values, nrrd.affine), {}
    if name.endswith(_META):
        return read_metaimage(path, noun="label map"), {}
    return read_nifti_labels(path)


def _by_number(volume: Volume, names: dict[int, str], path: Path) -> list[Segment]:
    """A segment for every number other than 0 in a map of numbers."""
    require_three_dimensions(volume, path)
    found = np.unique(volume.values)
    if len(found) > _MOST_NUMBERS:
        raise CaseError(
            f"the label map has {len(found)} different values: it is an image, or was resampled with "
            "interpolation",
            where=str(path),
            fix="[imaging] labels takes a label map; an image belongs in [imaging] mri",
        )
    broken = [each for each in found if abs(each - np.round(each)) > _ROUNDING]
    if broken:
        raise CaseError(
            f"the label map contains the value(s) {', '.join(f'{each:.8g}' for each in broken[:6])}",
            where=str(path),
            fix="use whole numbers, in an integer type that holds them, and resample without interpolation",
        )
    volume = volume.with_values(np.round(volume.values))
    found = np.unique(volume.values)
    numbers = [int(each) for each in found if each != 0]
    return [Segment(each, names.get(each, ""), lambda: volume, each) for each in numbers]


def _of_dicom(path: Path) -> list[Segment]:
    found = read_dicom_segments(path)

    def layer(values: NDArray) -> Callable[[], Volume]:
        return lambda: Volume(values, found.affine)

    return [
        Segment(number, name, layer(values), number if found.is_label_map else None)
        for number, name, values in found.named
    ]


def _of_seg_nrrd(nrrd: Nrrd, path: Path) -> list[Segment]:
    """The segments that a `.seg.nrrd` describes; none if it describes none.

    Older versions of 3D Slicer wrote a layer for each segment, with neither its layer nor its value. Missing
    entries mean what 3D Slicer takes them for: the layer of the segment's own number, value 1. A value that
    several layers use is no number of a segment, whose name then tells it from the others.
    """
    described: list[str] = []
    while f"Segment{len(described)}_Name" in nrrd.pairs or f"Segment{len(described)}_ID" in nrrd.pairs:
        described.append(f"Segment{len(described)}_")
    layers = nrrd.values if nrrd.values.ndim == 4 else nrrd.values[None]
    found: list[Segment] = []
    told: list[list[int]] = [[] for _ in layers]
    for number, key in enumerate(described):
        try:
            own = int(nrrd.pairs.get(key + "Layer", number if len(layers) > 1 else 0))
            usual = 1 if len(layers) > 1 or len(described) == 1 else number + 1
            value = int(nrrd.pairs.get(key + "LabelValue", usual))
        except ValueError as error:
            raise CaseError(
                f"the label map's description of segment {number} cannot be read ({error})",
                where=str(path),
                fix="save it again from 3D Slicer",
            ) from error
        if not 0 <= own < len(layers):
            raise CaseError(
                f"segment {number} of the label map is in layer {own}, but there are {len(layers)}",
                where=str(path),
                fix="save it again from 3D Slicer",
            )
        volume = Volume(layers[own], nrrd.affine)
        name = nrrd.pairs.get(key + "Name", nrrd.pairs.get(key + "ID", ""))
        found.append(Segment(value, name, lambda volume=volume: volume, value))  # type: ignore[misc]
        told[own].append(value)
    values = [each.number for each in found]
    found = [replace(each, number=None) if values.count(each.number) > 1 else each for each in found]
    return [*found, *_undescribed([Volume(each, nrrd.affine) for each in layers], told)] if found else []


def _undescribed(layers: Sequence[Volume], told: Sequence[Sequence[int]]) -> Iterator[Segment]:
    """A nameless segment for each value of a layer that no description tells of; told : values by layer"""
    for layer, known in zip(layers, told, strict=True):
        for value in np.setdiff1d(layer.values, [0, *known]):
            yield Segment(int(value), "", lambda layer=layer: layer, int(value))  # type: ignore[misc]


def _of_folder(folder: Path) -> list[Segment]:
    """A folder with a file for each segment, whose name is the file's."""
    files = sorted(each for each in folder.iterdir() if each.is_file() and not each.name.startswith("."))
    masks = [each for each in files if each.name.lower().endswith(VOLUME_ENDINGS)]
    dicom = [] if masks else [each for each in files if _is_dicom(each)]
    if len(dicom) == 1:
        return _of_dicom(dicom[0])
    if not masks:
        raise CaseError(
            "the folder contains no label map",
            where=str(folder),
            fix=f"give a folder with a file for each segment ({', '.join(VOLUME_ENDINGS)}), or one DICOM SEG "
            "or RTSTRUCT",
        )
    return [Segment(None, _stem(each), _mask_of(each), None) for each in masks]


def _stem(path: Path) -> str:
    """
    >>> _stem(Path("femur_left.nii.gz")), _stem(Path("Tibia.seg.nrrd"))
    ('femur_left', 'Tibia')
    """
    ending = max((each for each in VOLUME_ENDINGS if path.name.lower().endswith(each)), key=len)
    return path.name[: -len(ending)].removesuffix(".seg")


def _mask_of(path: Path) -> Callable[[], Volume]:
    def load() -> Volume:
        volume, _ = _numbers_in(path)
        require_three_dimensions(volume, path)
        high = float(volume.values.max(initial=0))
        values = volume.values / high if high > 0 else volume.values
        several = np.unique(values[(values > 0) & (values < 1)])
        if high > 1 and len(several):
            raise CaseError(
                f"{path.name} has several values; in a folder, each file is the mask of one segment",
                where=str(path),
                fix="name this file itself under [imaging] labels, or move it out of the folder",
            )
        return volume.with_values(values)

    return load
