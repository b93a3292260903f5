"""Label maps in our numbers: written as NIfTI, checked, and what is in them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import nibabel as nib
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.errors import CaseError
from limbcli.files.atomic import atomic_file
from limbcli.imaging.limbs import Side
from limbcli.imaging.markers import MarkerCapsule, number_markers
from limbcli.imaging.segmentation import BONE, FAT, MARKER, SOFT_TISSUE, Segmentation
from limbcli.imaging.signed_distance import distance_to, filled_by_slice, largest
from limbcli.imaging.volume import RAS_FROM_LPS, Volume, require_placed
from limbcli.model import Array

_LIMB = (SOFT_TISSUE, BONE, FAT)
_SECOND_LIMB = 0.35  # fraction of the largest component: a second one at least this large is a second limb
_KNOWN = (0, SOFT_TISSUE, BONE, MARKER, FAT)
_LEAST_BONE = 150.0  # mm^3: smaller specks of bone are discarded
# cosine between axes, above which a qform, which can represent only right angles, would change the geometry
_STRAIGHT = 1e-4
_LEAST_MARKER = 0.1  # fraction of the largest marker's volume: smaller ones are specks


def write_labels(path: Path, labels: Volume) -> None:
    """Write a label map as NIfTI (uint8); the affine is converted from LPS to the format's RAS."""
    affine = RAS_FROM_LPS @ labels.affine
    image = nib.Nifti1Image(np.ascontiguousarray(labels.values, dtype=np.uint8), affine)
    image.header.set_xyzt_units("mm")
    image.set_sform(affine, code=1)
    axes = labels.affine[:3, :3] / labels.spacing
    is_straight = np.abs(axes.T @ axes - np.eye(3)).max() < _STRAIGHT
    image.set_qform(affine if is_straight else None, code=int(is_straight))
    with atomic_file(
        path.with_name(path.name.removesuffix(".gz").removesuffix(".nii") + ".nii.gz")
    ) as partial:
        whole = partial.with_name(partial.name + ".nii.gz")
        try:
            nib.save(image, whole)
            whole.replace(partial)
        finally:
            whole.unlink(missing_ok=True)


def checked_labels(labels: Volume, path: Path, *, is_whole: bool = True) -> Volume:
    """The label map as uint8; raises an error that says what is wrong with it.

    is_whole : whether soft tissue is required
    """
    require_three_dimensions(labels, path)
    require_placed(labels.affine, path, noun="label map")
    found = np.unique(labels.values)
    unknown = [each for each in found if each not in _KNOWN]
    if unknown:
        raise CaseError(
            f"the label map contains the value(s) {', '.join(f'{each:g}' for each in unknown[:6])}",
            where=str(path),
            fix="use 0 outside, 1 soft tissue, 2 bone, 3 marker, 4 fat",
        )
    needed = ((SOFT_TISSUE, "1 (soft tissue)"), (BONE, "2 (bone)"))[0 if is_whole else 1 :]
    missing = [name for value, name in needed if value not in found]
    if missing:
        raise CaseError(
            f"the label map has no voxel of {' and '.join(missing)}",
            where=str(path),
            fix="use 0 outside, 1 soft tissue, 2 bone, 3 marker, 4 fat, or say what its numbers are in "
            "[imaging.labels]; add the file that has it as another [[imaging.labels]]; soft tissue is also "
            "taken from the image, [imaging] mri",
        )
    return labels.with_values(labels.values.astype(np.uint8))


def require_three_dimensions(labels: Volume, path: Path) -> None:
    """Refuse a label map that is not three-dimensional, or has fewer than 3 voxels along an axis.

    Raises CaseError if it is so.
    """
    if labels.values.ndim != 3 or min(labels.values.shape) < 3:
        raise CaseError(
            f"the label map has shape {labels.values.shape}; it needs three dimensions of at least 3 voxels",
            where=str(path),
            fix="export the segmentation as one label map volume",
        )


def segmentation_from(
    labels: Volume, *, side: Side | None = None, bone_of: Volume | None = None, bone_names: Sequence[str] = ()
) -> Segmentation:
    """Skin, bones and markers of a label map (k need not run along the limb).

    side : the limb to use, the patient's left or right, if the map contains two side by side
    bone_of : n where a voxel is of the bone `bone_names[n - 1]`, else 0, on the grid of the labels: bones
        that touch are kept apart; None: bones are what is connected
    """
    turned, _, _ = labels.along_limb()
    turned, notes = _of_one_limb(turned, side)
    limb = np.isin(turned.values, _LIMB)
    limb = filled_by_slice(largest(limb))
    bones, names, specks = _bones(turned, bone_of.along_limb()[0].values if bone_of else None, bone_names)
    markers, dots = _markers(turned, limb)
    return Segmentation(
        labels=labels,
        skin=turned.with_values(limb),
        bones=tuple(turned.with_values(each) for each in bones),
        bone_names=names,
        fat=turned.with_values(turned.values == FAT) if (labels.values == FAT).any() else None,
        markers=markers,
        notes=(*notes, *_left_out(specks, "bone", turned), *_left_out(dots, "marker", turned)),
    )


def _of_one_limb(turned: Volume, side: Side | None) -> tuple[Volume, tuple[str, ...]]:
    """Remove the other of two limbs side by side; returns the labels and a note."""
    parts, n_parts = ndimage.label(np.isin(turned.values, _LIMB))
    sizes = np.bincount(parts.ravel(), minlength=n_parts + 1)[1:]
    limbs = np.flatnonzero(sizes > _SECOND_LIMB * sizes.max(initial=0)) + 1
    if side is None or len(limbs) != 2:
        return turned, ()
    heights = [np.flatnonzero((parts == each).any(axis=(0, 1))) for each in limbs]
    if min(each[-1] for each in heights) < max(each[0] for each in heights):
        return turned, ()  # components above one another are parts of one limb
    to_the_left = turned.to_patient(np.array(ndimage.center_of_mass(parts > 0, parts, limbs)))[:, 0]
    order = np.argsort(to_the_left)  # LPS: x increases towards the patient's left
    other, wanted = limbs[order if side == "left" else order[::-1]]
    far, near = (distance_to(parts == each, turned.spacing) for each in (other, wanted))
    values = np.where((turned.values > 0) & (far < near), 0, turned.values)
    return turned.with_values(values), (
        f"the label map contains two limbs: the patient's {side} one was taken",
    )


def _left_out(places: Array, kind: str, volume: Volume) -> tuple[str, ...]:
    """A note on discarded specks, given the voxel indices (n, 3) of their centres."""
    if not len(places):
        return ()
    x, y, z = volume.to_patient(places[:1])[0]
    several = "s" if len(places) > 1 else ""
    where = f"at ({x:.0f}, {y:.0f}, {z:.0f}) mm" + (" and elsewhere" if several else "")
    return (f"{len(places)} speck{several} of {kind} in the label map, {where}, excluded",)


def _parts(mask: NDArray[np.bool_], volume: Volume, *, least: float) -> tuple[list[NDArray[np.bool_]], Array]:
    """Connected components of at least `least` mm^3, largest first; centres (n, 3), voxels, of the others."""
    parts, n_parts = ndimage.label(mask)
    sizes = np.bincount(parts.ravel(), minlength=n_parts + 1)[1:] * volume.voxel_volume
    order = np.argsort(-sizes, kind="stable")
    small = np.flatnonzero(sizes < least) + 1
    middles = np.array(ndimage.center_of_mass(mask, parts, small)).reshape(-1, 3)
    return [parts == n + 1 for n in order if sizes[n] >= least], middles


def _bones(
    turned: Volume, bone_of: NDArray | None, bone_names: Sequence[str]
) -> tuple[list[NDArray[np.bool_]], tuple[str, ...], Array]:
    """The bones, largest first, their names (none if the map names none), and the centres of specks."""
    bone = turned.values == BONE
    if bone_of is None or not bone_names:
        bones, specks = _parts(bone, turned, least=_LEAST_BONE)
        return bones, (), specks
    found: list[tuple[NDArray[np.bool_], str]] = []
    centres = []
    for n, name in enumerate(("", *bone_names)):
        parts, specks = _parts(bone & (bone_of == n), turned, least=_LEAST_BONE)
        centres.append(specks)
        found += [(each, f"{name}_{k}" if k > 1 else name) for k, each in enumerate(parts, 1)]
    found.sort(key=lambda each: -int(each[0].sum()))
    unnamed = iter(range(1, len(found) + 1))
    names = tuple(str(next(unnamed)) if name.partition("_")[0] == "" else name for _, name in found)
    return [each for each, _ in found], names, np.concatenate(centres)


def _markers(volume: Volume, limb: NDArray[np.bool_]) -> tuple[tuple[MarkerCapsule, ...], Array]:
    """The capsules, and the centres (n, 3), voxels, of specks.

    Specks would otherwise be numbered as capsules.
    """
    parts, n_parts = ndimage.label(volume.values == MARKER, np.ones((3, 3, 3), bool))
    if n_parts == 0:
        return (), np.zeros((0, 3))
    centres = np.array(ndimage.center_of_mass(parts > 0, parts, np.arange(1, n_parts + 1)))
    sizes = np.asarray(np.bincount(parts.ravel())[1:] * volume.voxel_volume, dtype=np.float64)
    whole = sizes >= _LEAST_MARKER * sizes.max()
    found = number_markers(volume.to_patient(centres[whole]), sizes[whole], volume, limb)
    return found, centres[~whole]
