"""Automatic segmentation of a limb on T1 MRI or CT: skin, bones, fat, markers.

No machine learning is used, only basic anatomical facts: air is dark, skin encloses everything, muscle and
fat have two signal levels under a smooth bias field, bone is bright marrow in a dark shell that is continuous
along the limb, markers are bright and protrude from the skin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.errors import CaseError
from limbcli.imaging.cortex import with_cortex
from limbcli.imaging.ct import bones_on_ct, fat_on_ct, limb_on_ct
from limbcli.imaging.fat import fat_of
from limbcli.imaging.intensity import normalise
from limbcli.imaging.limbs import Side, one_limb, require_bright_fat, upright
from limbcli.imaging.markers import MarkerCapsule, find_markers
from limbcli.imaging.marrow import find_marrow
from limbcli.imaging.nearest_skin import is_inside, reach_of
from limbcli.imaging.skin_segmentation import rough_outline, skin_outline
from limbcli.imaging.volume import Volume, back
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

SOFT_TISSUE, BONE, MARKER, FAT = 1, 2, 3, 4
_FINEST = 1.0  # mm: pixel size above which images are resampled to twice (or more) their resolution
_COARSE = 2.5  # mm: pixel size above which a note warns of coarse sections
_PARTS = 6


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Result of a segmentation, on the image's own grid, and on a finer one where the image is coarse.

    labels : Volume of uint8 on the image's grid: 0 outside, 1 soft tissue, 2 bone, 3 marker, 4 fat
    skin : Volume of bool on the working grid (k along the limb): everything inside the skin
    bones : one Volume of bool per bone, largest first
    bone_names : their names, if a label map gives them; else empty
    fat : Volume of bool, or None if it cannot be distinguished from muscle
    markers : numbered capsules
    notes : processing steps that the user should know of
    """

    labels: Volume
    skin: Volume
    bones: tuple[Volume, ...]
    fat: Volume | None = None
    markers: tuple[MarkerCapsule, ...] = ()
    notes: tuple[str, ...] = ()
    bone_names: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Masks:
    """Result of `_on_mri` and `_on_ct` on the working grid."""

    limb: NDArray[np.bool_]
    bones: list[NDArray[np.bool_]]
    fat: NDArray[np.bool_] | None
    marker: NDArray[np.bool_]
    markers: tuple[MarkerCapsule, ...]


@dataclass(frozen=True, eq=False)
class SegmentationHints:
    """User input to a segmentation.

    threshold : signal between air and skin (image units, HU on CT); None: determined automatically
    bone_seeds : patient LPS (n, 3), mm, points in marrow of bones to add
    soft_seeds : patient LPS (n, 3), mm, points in regions wrongly taken for bone
    side : which of two limbs in view
    """

    threshold: float | None = None
    bone_seeds: Array | None = None
    soft_seeds: Array | None = None
    side: Side | None = None


def segment_limb(
    image: Volume,
    *,
    modality: str = "MR",
    hints: SegmentationHints | None = None,
    progress: Progress = SILENT,
) -> Segmentation:
    """Segment skin, bones, fat and markers of a limb.

    image : T1-weighted image, or CT in HU, of one limb (or two: then `hints.side`), any orientation
    modality : "CT" for Hounsfield units; anything else is treated as T1

    Raises CaseError if no limb stands out from the background, two do, fat is not bright, or a seed lies
    outside the image or, for a bone seed, outside the limb.
    """
    hints = hints or SegmentationHints()
    _require_within(image, hints)
    turned, order, flipped = image.along_limb()
    notes: tuple[str, ...] = ()
    if modality != "CT":
        turned, notes = upright(turned)
    coarsest = float(turned.spacing[:2].max())
    if coarsest > _COARSE:
        text = (
            f"a pixel of the limb's cross section is up to {coarsest:.1f} mm wide: look closely at thin bones"
        )
        notes = (*notes, text)
    chosen = one_limb(turned, hints.side, threshold=hints.threshold)
    if chosen is not turned:
        notes = (*notes, f"two limbs are in view: the patient's {hints.side} one was taken")
    work, factors = supersampled(chosen)
    masks = (_on_ct if modality == "CT" else _on_mri)(work, hints, progress)
    bones = _without_soft(masks.bones, work, hints.soft_seeds)
    notes = (*notes, *_useless(hints, modality, masks.bones, bones))
    labels = np.where(masks.limb, SOFT_TISSUE, 0).astype(np.uint8)
    if masks.fat is not None:
        labels[masks.fat & masks.limb] = FAT
    for bone in bones:
        labels[bone] = BONE
    labels[masks.marker & ~masks.limb] = MARKER
    progress.event("task", name="segmenting", done=_PARTS, total=_PARTS)
    return Segmentation(
        labels=image.with_values(back(_coarse(labels, factors), order, flipped)),
        skin=work.with_values(masks.limb),
        bones=tuple(work.with_values(bone) for bone in bones),
        fat=None if masks.fat is None else work.with_values(masks.fat),
        markers=masks.markers,
        notes=notes
        if masks.fat is not None
        else (*notes, "fat and muscle cannot be distinguished; no label 4"),
    )


def _require_within(image: Volume, hints: SegmentationHints) -> None:
    """Refuse seeds outside the image's voxels, which would otherwise be moved to its border."""
    for kind, seeds in (("bone", hints.bone_seeds), ("soft", hints.soft_seeds)):
        for each in () if seeds is None else np.atleast_2d(seeds):
            if not is_inside(image, each):
                low, high = reach_of(image)
                what = f"lies outside of the image, which goes from {_words(low)} to {_words(high)} mm"
                raise _seed_error(kind, each, what)


def _require_in_limb(seeds: Array, limb: NDArray[np.bool_], work: Volume) -> None:
    last = np.array(limb.shape) - 1
    for each in np.atleast_2d(seeds):
        voxel = np.clip(np.round(work.to_voxel(each[None])[0]), 0, last).astype(int)
        if not limb[tuple(voxel)]:
            raise _seed_error("bone", each, "lies outside the limb")


def _words(corner: Array) -> str:
    return "(" + ", ".join(f"{each:.0f}" for each in corner) + ")"


def _seed_error(kind: str, seed: Array, what: str) -> CaseError:
    written = ",".join(f"{each:g}" for each in seed)
    return CaseError(
        f"the seed {kind}={written} {what}",
        where="--seed",
        fix="write the point in patient LPS, mm (programs that show RAS have x and y with the opposite sign)",
    )


def _on_mri(work: Volume, hints: SegmentationHints, progress: Progress) -> Masks:
    def report(done: int) -> None:
        progress.event("task", name="segmenting", done=done, total=_PARTS)

    rough = rough_outline(work, threshold=hints.threshold)
    require_bright_fat(work, rough)
    report(1)
    intensities = normalise(work, rough)
    report(2)
    found = find_markers(work, intensities, rough)
    report(3)
    limb = skin_outline(work, intensities, rough, without=found.around, threshold=hints.threshold)
    report(4)
    points = None
    if hints.bone_seeds is not None:
        _require_in_limb(hints.bone_seeds, limb, work)
        points = np.clip(work.to_voxel(hints.bone_seeds), 0, np.array(limb.shape) - 1)
    marrow = find_marrow(intensities, limb, work.spacing, seeds=points)
    report(5)
    bones = [with_cortex(each, intensities, limb, work.spacing) & limb for each in marrow]
    bone = np.any(bones, axis=0) if bones else np.zeros_like(limb)
    return Masks(limb, bones, fat_of(intensities, limb, bone, work), found.mask, found.markers)


def _on_ct(work: Volume, hints: SegmentationHints, progress: Progress) -> Masks:
    limb = limb_on_ct(work, threshold=hints.threshold)
    progress.event("task", name="segmenting", done=2, total=_PARTS)
    bones = bones_on_ct(work, limb)
    nothing = np.zeros_like(limb)
    return Masks(limb, bones, fat_on_ct(work, limb), nothing, ())


def _without_soft(
    bones: list[NDArray[np.bool_]], work: Volume, seeds: Array | None
) -> list[NDArray[np.bool_]]:
    """The bones that contain none of the points known to be soft tissue."""
    if seeds is None:
        return bones
    last = np.array(work.shape) - 1
    points = [tuple(each) for each in np.clip(np.round(work.to_voxel(seeds)), 0, last).astype(int)]
    return [bone for bone in bones if not any(bone[point] for point in points)]


def _useless(
    hints: SegmentationHints, modality: str, before: list[NDArray[np.bool_]], after: list[NDArray[np.bool_]]
) -> tuple[str, ...]:
    """Notes on seeds that had no effect."""
    found = []
    if modality == "CT" and hints.bone_seeds is not None:
        found.append("--seed bone has no effect on CT, where bone is defined by its HU")
    if hints.soft_seeds is not None and len(after) == len(before):
        found.append("--seed soft does not lie in anything labelled as bone, and has no effect")
    return tuple(found)


def supersampled(volume: Volume) -> tuple[Volume, tuple[int, int]]:
    """The image resampled to at most 1 mm within the slices, and the factors along both axes.

    >>> fine, factors = supersampled(Volume(np.zeros((4, 4, 3)), np.diag([2.0, 1.0, 5.0, 1.0])))
    >>> factors, fine.shape, fine.affine[0]
    ((2, 1), (8, 4, 3), array([ 1. ,  0. ,  0. , -0.5]))
    """
    first, second = (max(1, int(np.ceil(each / _FINEST - 1e-6))) for each in volume.spacing[:2])
    if first == second == 1:
        return volume, (1, 1)
    values = ndimage.zoom(
        volume.values.astype(np.float32), (first, second, 1), order=3, mode="nearest", grid_mode=True
    )
    affine = volume.affine.copy()
    for axis, factor in enumerate((first, second)):
        affine[:3, 3] -= volume.affine[:3, axis] * (factor - 1) / (2 * factor)
        affine[:3, axis] /= factor
    return Volume(values, affine), (first, second)


def _coarse(labels: NDArray[np.uint8], factors: tuple[int, int]) -> NDArray[np.uint8]:
    """Downsample the labels: each voxel takes the label that fills most of it."""
    if factors == (1, 1):
        return labels
    a, b, c = labels.shape
    blocks = labels.reshape(a // factors[0], factors[0], b // factors[1], factors[1], c)
    shares = [(blocks == value).mean(axis=(1, 3)) for value in (0, SOFT_TISSUE, BONE, MARKER, FAT)]
    inside = np.add(shares[SOFT_TISSUE], shares[FAT])
    body = np.argmax([shares[0], inside, shares[BONE], shares[MARKER]], axis=0)
    return np.where((body == SOFT_TISSUE) & (shares[FAT] > shares[SOFT_TISSUE]), FAT, body).astype(np.uint8)
