"""Quality of a segmentation: figures, and a verdict.

"good" needs no comment, "check" comes with warnings to look at, "poor" means that later stages are unreliable
until the segmentation is corrected.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.imaging.segmentation import Segmentation
from limbcli.imaging.signed_distance import box_around, depth_inside, distance_to
from limbcli.imaging.volume import Volume
from limbcli.model import Array

# relative change of the section's area within 5 mm: limits for "check" and "poor" (as in all pairs below)
_JUMP = (0.35, 0.8)
_BONE_JUMP = (0.9, 2.5)  # bones flare towards a joint
_SECTION = (0.45, 0.6)  # bone as a fraction of the limb's section
_AT_SKIN = (0.02, 0.15)  # fraction of a bone's surface that lies on the skin
_BORDER = (0.03, 0.15)  # fraction of the limb's outline that is cut off by the sides of the image
_THIN = (2.0, 1.0)  # half thickness of a bone at its thinnest section, mm (lower limits)
_HOLE = (20.0, 500.0)  # volume of enclosed holes, mm^3
_IN_SLICE = ndimage.generate_binary_structure(2, 1)[:, :, None]
_END = 0.4  # fraction of the largest section: a smaller first or last section belongs to a rounded end
_TWO_LIMBS = (0.1, 0.3)  # fraction of the sections that fall into two parts
# thinning level, as a fraction of a section's greatest depth; smallest ratio of the areas of two comparable
# parts
_APART, _COMPARABLE = 0.6, 0.35
_COARSE = 2.0  # mm: grid spacing sufficient to see whether a section falls into two parts
_EVERY = 5.0  # mm along the limb over which a change of area is measured


@dataclass(frozen=True)
class ImageQuality:
    """verdict "good" | "check" | "poor"; figures with units in their names; findings as text."""

    verdict: str
    figures: dict[str, float] = field(default_factory=dict)
    findings: tuple[str, ...] = ()


def assess(found: Segmentation, names: tuple[str, ...]) -> ImageQuality:
    """Check a segmentation for leakage, holes, jumps in cross-section and thin places.

    names : of the bones, in order
    """
    figures: dict[str, float] = {}
    remarks: list[tuple[int, str]] = []

    def judge(key: str, value: float, limits: tuple[float, float], text: str) -> None:
        figures[key] = round(float(value), 4)
        worse = limits[1] > limits[0]
        grade = sum(value > limit if worse else value < limit for limit in limits)
        if grade:
            remarks.append((grade, text.format(value)))

    limb = found.skin
    judge("limb_jump_share", _jump(limb), _JUMP, "the limb's cross-section changes by {:.0%} within 5 mm")
    judge("limb_cut_share", _cut_off(limb.values), _BORDER, "the image's side cuts off {:.0%} of the limb")
    judge("limb_holes_mm3", _holes(limb), _HOLE, "the limb has holes of {:.0f} mm3")
    # a limb is cut proximally and ends distally; a wrong orientation tag reverses it
    areas = _areas(limb.values)
    turned = int(areas[0] > 0.3 * areas.max() and areas[-1] == 0)
    judge("limb_ends_proximally", turned, (0, 2), "the limb ends towards the head: upside down?")
    judge(
        "limb_in_two_share", _in_two(limb), _TWO_LIMBS,
        "{:.0%} of the limb's sections are two that touch: two limbs? Crop the image to one, or separate "
        "them in the label map",
    )  # fmt: skip
    figures["n_bones"] = len(names)
    if len(names) == 1:
        remarks.append((1, "only one bone was found (right for a thigh; a lower leg has two)"))
    allowed = np.zeros(limb.shape, bool)
    for name, bone in zip(names, found.bones, strict=True):
        allowed |= bone.values
        at_skin = _share_at_skin(bone.values, limb.values)
        for key, value, limits, text in (
            ("jump_share", _jump(bone), _BONE_JUMP, "changes its cross-section by {:.0%} within 5 mm"),
            ("at_skin_share", at_skin, _AT_SKIN, "has {:.0%} of its surface on the skin"),
            ("holes_mm3", _holes(bone), _HOLE, "has holes of {:.0f} mm3"),
            ("half_thickness_mm", _thinnest(bone), _THIN, "has a half-thickness of only {:.1f} mm"),
            ("gaps", _gaps(bone.values), (0, 2), "is missing in {:.0f} slice(s) between its ends"),
        ):
            judge(f"{name}_{key}", value, limits, f"bone {name} {text}")
    share = _largest_share(allowed, limb.values)
    judge("bone_section_share", share, _SECTION, "bone fills {:.0%} of a section of the limb (a leak?)")
    worst = max((grade for grade, _ in remarks), default=0)
    return ImageQuality(("good", "check", "poor")[worst], figures, tuple(text for _, text in remarks))


def _areas(mask: NDArray[np.bool_]) -> Array:
    return mask.sum(axis=(0, 1)).astype(np.float64)


def _jump(mask: Volume) -> float:
    """Largest relative change of the section's area over 5 mm, except at rounded ends."""
    areas = _areas(mask.values)
    filled = np.flatnonzero(areas)
    step = max(1, round(_EVERY / mask.spacing[2]))
    margin = int(np.ceil(20.0 / mask.spacing[2]))
    # Some files omit empty slices: an end without them also counts as rounded if its section is small.
    round_low, round_high = areas[filled[[0, -1]]] < _END * areas.max()
    low = filled[0] + (margin if filled[0] > 0 or round_low else 0)
    high = filled[-1] + 1 - (margin if filled[-1] < len(areas) - 1 or round_high else 0)
    inner = areas[low:high]
    if len(inner) <= step or inner.min() == 0:
        return 0.0
    ratio = np.abs(np.log(inner[step:] / inner[:-step]))
    return float(np.expm1(ratio.max() * min(1.0, _EVERY / (step * mask.spacing[2]))))


def _gaps(mask: NDArray[np.bool_]) -> int:
    filled = np.flatnonzero(_areas(mask))
    return int(filled[-1] - filled[0] + 1 - len(filled))


def _in_two(limb: Volume) -> float:
    """Fraction of the limb's larger sections that fall into two comparable parts when thinned."""
    steps = [max(1, int(_COARSE // each)) for each in limb.spacing[:2]]
    areas = _areas(limb.values)
    large = np.flatnonzero(areas > _END * areas.max())[:: max(1, round(_EVERY / limb.spacing[2]))]
    found = []
    for k in large.tolist():
        section = np.pad(limb.values[:: steps[0], :: steps[1], k], 1)
        depth = distance_to(~section, limb.spacing[:2] * steps)
        parts, n_parts = ndimage.label(depth > _APART * depth.max())
        sizes = np.sort(np.bincount(parts.ravel(), minlength=n_parts + 1)[1:])
        found.append(n_parts > 1 and sizes[-2] > _COMPARABLE * sizes[-1])
    return float(np.mean(found)) if found else 0.0


def _cut_off(limb: NDArray[np.bool_]) -> float:
    """Fraction of the limb's outline that lies on the sides of the image."""
    sides = limb[0].sum() + limb[-1].sum() + limb[:, 0].sum() + limb[:, -1].sum()
    outline = limb & ~ndimage.binary_erosion(limb, _IN_SLICE)
    return float(sides / max(outline.sum(), 1))


def _share_at_skin(bone: NDArray[np.bool_], limb: NDArray[np.bool_]) -> float:
    """Fraction of the bone's edge without soft tissue between it and the air, within the slices."""
    edge = bone & ~ndimage.binary_erosion(bone, _IN_SLICE, border_value=1)
    beside_air = bone & ndimage.binary_dilation(~limb, _IN_SLICE)
    return float((edge & beside_air).sum() / max(edge.sum(), 1))


def _holes(mask: Volume) -> float:
    here = mask.values[box_around(mask.values, 1)]
    filled = ndimage.binary_fill_holes(here)
    return float((filled & ~here).sum() * mask.voxel_volume)


def _thinnest(bone: Volume) -> float:
    """Minimum over the slices, except at the ends, of the largest distance to the bone's edge, mm."""
    filled = np.flatnonzero(_areas(bone.values))
    margin = int(np.ceil(8.0 / bone.spacing[2]))
    low = margin if filled[0] > 0 else 0
    high = margin if filled[-1] < bone.shape[2] - 1 else 0
    inner = filled[low : len(filled) - high]
    if not len(inner):
        inner = filled
    depths = [depth_inside(np.pad(bone.values[:, :, k], 1), bone.spacing[:2]).max() for k in inner]
    return float(min(depths))


def _largest_share(bone: NDArray[np.bool_], limb: NDArray[np.bool_]) -> float:
    areas = _areas(limb)
    large = areas > 0.3 * areas.max()
    return float((_areas(bone)[large] / areas[large]).max()) if large.any() else 0.0
