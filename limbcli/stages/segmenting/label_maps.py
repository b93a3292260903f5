"""Skin, bones, fat and markers from the label maps of a case, with what only its image shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.case import Case
from limbcli.errors.problems import Problem, errors_of
from limbcli.imaging.dicom import Series
from limbcli.imaging.image_files import read_image
from limbcli.imaging.label_files import read_label_map
from limbcli.imaging.label_frame import frame_problems, in_order_of, same_grid
from limbcli.imaging.labels import segmentation_from
from limbcli.imaging.limbs import Side
from limbcli.imaging.segmentation import BONE, FAT, SOFT_TISSUE, Segmentation, SegmentationHints, segment_limb
from limbcli.imaging.signed_distance import filled_by_slice
from limbcli.imaging.volume import Volume, unplaced
from limbcli.progress import SILENT, Progress

# Fraction of the limb in the image that may lie outside a map of muscles, fat and bones for the map to count
# as one that reaches to the skin: 0.7 mm all round a limb of 50 mm radius. Skin alone is 1 to 2 mm thick.
_WITHOUT_SKIN = 0.03
_ASTRAY = 0.05  # largest fraction of the labelled voxels outside the limb in the image
_CUT_MM = 5.0  # length of the limb beyond the map's grid above which a warning tells it
_LIMB = (SOFT_TISSUE, BONE, FAT)
_FIX = "add the image, [imaging] mri: what is missing up to the skin is then taken from it"


@dataclass(frozen=True, eq=False)
class LabelledLimb:
    """A segmentation from label maps; image : to be shown below it; lines : what was taken for what.

    problems : of position and of what is missing, errors first to be raised by the caller
    own_grid : whether the grid of the labels is not that of the image
    """

    found: Segmentation
    image: Volume
    problems: tuple[Problem, ...]
    lines: tuple[str, ...]
    own_grid: bool


def labelled_limb(case: Case, *, side: Side, progress: Progress = SILENT) -> LabelledLimb:
    """The limb in the label maps of a case.

    Muscles, bones and fat seldom reach to the skin. Where they do not, the rest of the limb, with its fat and
    markers, is segmented on the image; without one, a warning says what is missing.

    Raises CaseError if a file cannot be read or understood, or the image shows no limb.
    """
    series = None if case.imaging.mri is None else read_image(case.imaging.mri, progress=progress)
    sources = case.imaging.label_maps
    where = str(sources[0].path)
    read = read_label_map(sources, is_whole=series is None)
    labels, lines, problems = read.volume, list(read.lines), []
    if series is None and not read.up_to_skin:
        what = (
            "the label map has neither skin nor soft tissue: the outermost muscle, fat or bone is taken for "
            "the skin, which then lies too deep"
        )
        problems.append(Problem(what, where, _FIX, severity="warning"))
    own_grid = False
    if series is None:
        problems += unplaced(labels, where, noun="label map")
    else:
        problems += unplaced(series.volume, str(case.imaging.mri))
        own_grid = not same_grid(labels, series.volume)
        problems += frame_problems(labels, series.volume, where=where, up_to_skin=read.up_to_skin)
        if not read.up_to_skin and not errors_of(problems):
            labels, more, found = _up_to_skin(labels, series, side, where, progress)
            lines += more
            problems += found
    named = read.bone_of.values if labels is read.volume else _resampled(read.bone_of, labels)
    bone_of = labels.with_values(np.where(labels.values == BONE, named, 0))
    found_limb = segmentation_from(labels, side=side, bone_of=bone_of, bone_names=read.bone_names)
    image = labels if series is None or own_grid else in_order_of(labels, series.volume)
    return LabelledLimb(found_limb, image, tuple(problems), tuple(lines), own_grid)


def _up_to_skin(
    labels: Volume, series: Series, side: Side, where: str, progress: Progress
) -> tuple[Volume, list[str], list[Problem]]:
    """The labels, with the rest of the limb from the image unless they fill it; lines and problems.

    The grid of the labels may be a part of the image only: it then grows across the limb, not along it.
    """
    modality = str(series.facts.get("modality", "MR"))
    seen = segment_limb(
        series.volume, modality=modality, hints=SegmentationHints(side=side), progress=progress
    )
    problems = _cut_along(labels, seen.labels, where)
    labels = _widened(labels, seen.labels)
    around = _resampled(seen.labels, labels)
    limb = np.isin(around, _LIMB)
    ours = labels.values > 0
    outside = ours & ~ndimage.binary_dilation(limb, iterations=2)
    astray = float(outside.sum() / max(ours.sum(), 1))
    if astray > _ASTRAY:
        what = f"{astray:.0%} of what the label map names lies outside the limb in the image"
        fix = "export the label map again with this image as its reference; or set [subject] limb"
        return labels, [], [Problem(what, where, fix)]
    turned, order, flipped = labels.with_values(ours).along_limb()
    filled = filled_by_slice(np.ascontiguousarray(turned.values))
    inside = np.transpose(limb, order)
    inside = inside[:, :, ::-1] if flipped else inside
    missing = float((inside & ~filled).sum() / max(inside.sum(), 1))
    if missing <= _WITHOUT_SKIN:
        return labels, [], problems
    rest = np.where(around == BONE, SOFT_TISSUE, around)
    line = f"{missing:.0%} of the limb is in no segment of the label map: taken from the image"
    values = np.where(ours, labels.values, rest).astype(np.uint8)
    return labels.with_values(values), [line], problems


def _cut_along(labels: Volume, limb: Volume, where: str) -> list[Problem]:
    """A warning if the limb in the image goes on beyond an end of the map's grid."""
    index = np.argwhere(np.isin(limb.values, _LIMB)).astype(np.float64)
    along = labels.limb_axis
    at = labels.to_voxel(limb.to_patient(index))[:, along]
    if not len(at):
        return []
    beyond = np.array([-at.min(), at.max() - (labels.shape[along] - 1)]) * labels.spacing[along]
    distal, proximal = beyond if labels.affine[2, along] > 0 else beyond[::-1]
    told = [
        f"{mm:.0f} mm {word}" for mm, word in ((distal, "distally"), (proximal, "proximally")) if mm > _CUT_MM
    ]
    if not told:
        return []
    what = (
        f"the limb in the image goes on {' and '.join(told)} of the label map's grid: that part is left out"
    )
    fix = (
        "if no bone is missing there, as at the end of a residual limb, export the label map on the grid of "
        "the image (programs crop it to what is drawn)"
    )
    return [Problem(what, where, fix, severity="warning")]


def _widened(labels: Volume, limb: Volume) -> Volume:
    """The labels on a grid that reaches beyond the limb beside them; along the limb it stays as it is."""
    index = np.argwhere(np.isin(limb.values, _LIMB))
    at = labels.to_voxel(limb.to_patient(index.astype(np.float64)))
    along, shape = labels.limb_axis, np.array(labels.shape)
    beside = at[(at[:, along] > -0.5) & (at[:, along] < shape[along] - 0.5)]
    if not len(beside):
        return labels
    before = np.maximum(0, np.ceil(1 - beside.min(axis=0))).astype(int)
    after = np.maximum(0, np.ceil(beside.max(axis=0)).astype(int) + 2 - shape)
    before[along] = after[along] = 0
    affine = labels.affine.copy()
    affine[:3, 3] = labels.to_patient(-before[None].astype(np.float64))[0]
    return Volume(np.pad(labels.values, list(zip(before, after, strict=True))), affine)


def _resampled(source: Volume, grid: Volume) -> NDArray:
    """The source at the voxel nearest to each one of the grid (0 outside)."""
    values = np.empty(grid.shape, source.values.dtype)
    i, j = np.meshgrid(*(np.arange(n) for n in grid.shape[:2]), indexing="ij")
    for k in range(grid.shape[2]):
        index = np.stack([i.ravel(), j.ravel(), np.full(i.size, k)], axis=1)
        at = np.round(source.to_voxel(grid.to_patient(index))).astype(int)
        valid = ((at >= 0) & (at < source.shape)).all(axis=1)
        plane = np.zeros(i.size, source.values.dtype)
        plane[valid] = source.values[tuple(at[valid].T)]
        values[:, :, k] = plane.reshape(grid.shape[:2])
    return values
