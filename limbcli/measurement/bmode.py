"""Skin-bone distance on B-mode images, tracked through the force levels.

Bone is a bright line across the image with shadow below it. It is detected once, at the first level (or
given), and then tracked: a strip around it is matched in the next image by normalised cross-correlation, with
sub-pixel resolution, in several bands of columns; the spread between the bands is the uncertainty. The skin
is at the probe face, depth 0 of the calibrated region.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from limbcli.errors import MeasurementError
from limbcli.measurement.ultrasound_image import UltrasoundImage
from limbcli.model import Array

_STRIP_WIDTH = 10.0  # width of the strip around the centre line, mm
_BANDS = 5
_LEAST_DEPTH = 4.0  # mm below the probe face at which the search for the bone begins
_LARGEST_CHANGE = 8.0  # mm, search range between adjacent levels
_TEMPLATE_HALF = 2.5  # half height of the template around the line, mm
_WORST_CORRELATION = 0.3
_SHADOW = 4.0  # smallest height of image below the bone, mm
# Depth (mm) behind the line over which it must be dark. Farther down an image also fades behind an
# aponeurosis, and a screen shot is black below the image: when everything below was used, bone was found in
# two of 18 frames of calf muscle.
_NEAR_BEHIND = 6.0
# smallest brightness of the weakest column of the line, relative to the brightest row
_LEAST_BRIGHTNESS = 0.45
_BY_HAND = 0.3  # mm: standard deviation of a distance read off the image by hand
_DARKEST_SHADE = 0.2  # largest brightness behind the line, relative to the tissue in front


@dataclass(frozen=True)
class BoneLine:
    """Position of the bone below the probe face at one level.

    distance, sd : mm; correlation : of the match, -1 to 1 (1 for the first level)
    """

    distance: float
    sd: float
    correlation: float


def find_bone(image: UltrasoundImage) -> BoneLine:
    """Detect the bone line of a single image: bright right across the strip, with shadow below.

    An aponeurosis is as bright, but the muscle behind it still echoes; behind bone the image is dark compared
    with the tissue above. If nothing satisfies this, no bone is reported.

    Raises MeasurementError if nothing in the image looks like bone.
    """
    strip, step = _strip(image)
    smooth = gaussian_filter(strip, (0.4 / step, 1.0 / step))
    row, brightness, shade = _darkest_behind(smooth, round(_LEAST_DEPTH / step), step)
    if row is None or brightness < _LEAST_BRIGHTNESS or shade > _DARKEST_SHADE:
        raise MeasurementError(
            "no bone line is visible: nothing bright across the image with shadow below it",
            where=image.where,
            fix="state where it is with bone_mm (below the probe face), or choose a better frame",
            brightness=brightness,
            shade=shade,
        )
    distances = [
        _peak(gaussian_filter1d(band.mean(axis=1), 0.3 / step), row, round(1.0 / step)) * step
        for band in _bands(strip)
    ]
    return BoneLine(float(np.median(distances)), _spread(distances), 1.0)


def _darkest_behind(smooth: Array, first: int, step: float) -> tuple[int | None, float, float]:
    """The best candidate for bone: its row, its brightness across the strip, and the darkness behind it.

    Brightness is relative to the brightest row; shade is the brightness just behind relative to the tissue
    above.
    """
    profile, weakest = smooth.mean(axis=1), smooth.min(axis=1)
    gap, shadow, near = round(1.5 / step), round(_SHADOW / step), round(_NEAR_BEHIND / step)
    best: tuple[int | None, float, float] = (None, 0.0, float("inf"))
    for row in range(first, len(profile) - shadow):
        if profile[row] < profile[max(0, row - gap) : row + gap].max():
            continue
        front = float(profile[first // 2 : max(first, row - gap)].mean())
        behind = float(profile[row + gap : row + gap + near].mean())
        shade = behind / max(front, 1e-6)
        brightness = float(weakest[row] / max(profile.max(), 1e-6))
        if brightness >= _LEAST_BRIGHTNESS and shade < best[2]:
            best = (row, brightness, shade)
    return best


def follow_bone(
    images: Sequence[UltrasoundImage], *, bone: float | Sequence[float] | None = None
) -> list[BoneLine]:
    """The skin-bone distance at every level.

    bone : mm below the probe face at the first level, or at every level (then there is no search); None:
        detected automatically

    Raises MeasurementError if the line cannot be found or is lost; the message names the image.
    """
    if isinstance(bone, Sequence):
        return _stated(images, bone)
    if bone is not None:
        _check_inside(images[0], bone)
    first = find_bone(images[0]) if bone is None else BoneLine(bone, _BY_HAND, 1.0)
    lines = [first]
    for previous, image in pairwise(images):
        lines.append(follow_line(previous, image, lines[-1], _LARGEST_CHANGE))
    return lines


def _stated(images: Sequence[UltrasoundImage], bone: Sequence[float]) -> list[BoneLine]:
    """The distances as read by hand."""
    if len(bone) != len(images):
        raise MeasurementError(
            f"bone_mm states {len(bone)} distances, there are {len(images)} images",
            where=str(images[0].path.parent),
            fix="state one distance per image, or only that of the first",
        )
    for image, each in zip(images, bone, strict=True):
        _check_inside(image, each)
    return [BoneLine(float(each), _BY_HAND, 1.0) for each in bone]


def _check_inside(image: UltrasoundImage, bone: float) -> None:
    strip, step = _strip(image)
    deepest = len(strip) * step
    if not 0.0 < bone < deepest:
        raise MeasurementError(
            f"the bone is stated at {bone:g} mm; the image ends at {deepest:.1f} mm below the probe face",
            where=image.where,
            fix="correct bone_mm, or mm_per_pixel",
        )


def follow_line(
    previous: UltrasoundImage, image: UltrasoundImage, line: BoneLine, largest_change: float, *,
    name: str = "bone line", by_hand: str = "skin_bone_mm", half: float = _TEMPLATE_HALF,
) -> BoneLine:  # fmt: skip
    """Find the position of a line of one image in the next.

    largest_change : search range, mm; name, by_hand : name of the line, and the column for a reading by hand;
        half : half height of the compared strip, mm

    Raises MeasurementError if the scale changes, the best correlation is too low, or it lies at the end of
    the search range.
    """
    old, old_step = _strip(previous)
    new, step = _strip(image)
    n = min(old.shape[1], new.shape[1])  # widths may differ by a pixel
    old, new = _middle(old, n), _middle(new, n)
    if abs(step / old_step - 1.0) > 0.02:
        raise MeasurementError(
            f"the scale changes from {old_step:.4f} to {step:.4f} mm per pixel",
            where=image.where,
            fix=f"give every level the same depth setting, or measure this one manually ({by_hand})",
        )
    shifts, correlations, beyond = [], [], []
    for a, b in zip(_bands(old), _bands(new), strict=True):
        shift, correlation, at_end = _match(a, b, line.distance / step, largest_change / step, step, half)
        shifts.append(shift * step)
        correlations.append(correlation)
        beyond.append(at_end)
    best = float(np.median(correlations))
    if best < _WORST_CORRELATION:
        raise MeasurementError(
            f"the {name} is lost: the best match has a correlation of only {best:.2f}",
            where=image.where,
            fix=f"measure this level manually ({by_hand}), or omit the image",
            correlation=best,
        )
    keep = np.array(correlations) >= min(best, 0.5)
    if np.mean(np.array(beyond)[keep]) > 0.5:
        raise MeasurementError(
            f"the {name} is lost: it moved by {largest_change:.1f} mm or more from the previous image, "
            "outside the search range",
            where=image.where,
            fix=f"add images of intermediate levels, or measure manually, level by level ({by_hand})",
        )
    moved = np.array(shifts)[keep]
    sd = float(np.hypot(_spread(moved.tolist()), line.sd if len(moved) < 2 else 0.0))
    return BoneLine(line.distance + float(np.median(moved)), max(sd, 0.1 * step), best)


def _strip(image: UltrasoundImage) -> tuple[Array, float]:
    """Brightness around the centre line from the probe face down, and mm per pixel along the depth."""
    region = image.main_region()
    centre = (region.left + region.right) / 2.0
    half = _STRIP_WIDTH / 2.0 / region.mm_per_pixel_x
    left, right = max(region.left, int(centre - half)), min(region.right, int(centre + half))
    strip = image.grey[region.top : region.bottom + 1, left : right + 1]
    if min(strip.shape) < 2 * _BANDS:
        what = f"the calibrated region is only {strip.shape[1]} by {strip.shape[0]} pixels"
        raise MeasurementError(what, where=image.where, fix="export the frame in full resolution")
    return strip, region.mm_per_pixel_y


def _middle(strip: Array, n_columns: int) -> Array:
    first = (strip.shape[1] - n_columns) // 2
    return strip[:, first : first + n_columns]


def _bands(strip: Array) -> list[Array]:
    return np.array_split(strip, _BANDS, axis=1)


def _match(
    old: Array, new: Array, row: float, reach: float, step: float, half_mm: float
) -> tuple[float, float, bool]:
    """Sub-pixel shift of the neighbourhood of `row`, its correlation, and whether it is at the range's end.

    At the end of the range, a better match may lie beyond.
    """
    half = round(half_mm / step)
    centre = round(row)
    top = max(0, centre - half)
    template = gaussian_filter(old, 0.15 / step)[top : centre + half + 1]
    field = gaussian_filter(new, 0.15 / step)
    template = template - template.mean()
    norm = float(np.sqrt((template**2).sum()))
    rows = range(max(0, top - int(reach)), min(len(field) - len(template), top + int(reach)) + 1)
    values = np.full(len(rows), -1.0)
    for k, start in enumerate(rows):
        part = field[start : start + len(template)]
        part = part - part.mean()
        values[k] = float((part * template).sum()) / (norm * float(np.sqrt((part**2).sum())) + 1e-12)
    if not len(values):
        return 0.0, -1.0, False
    best = int(np.argmax(values))
    at_end = 0 < int(reach) == abs(rows[best] - top)
    return rows[0] + _parabola(values, best) - top, float(values[best]), at_end


def _peak(profile: Array, row: int, reach: int) -> float:
    low, high = max(0, row - reach), min(len(profile), row + reach + 1)
    best = low + int(np.argmax(profile[low:high]))
    return _parabola(profile, best)


def _parabola(values: Array, best: int) -> float:
    """Sub-sample position of the maximum, from a parabola through its two neighbours."""
    if not 0 < best < len(values) - 1:
        return float(best)
    left, middle, right = values[best - 1 : best + 2]
    curvature = left - 2.0 * middle + right
    return best + (0.5 * (left - right) / curvature if curvature < 0 else 0.0)


def _spread(values: Sequence[float]) -> float:
    """Standard deviation of the median of the bands, from their median absolute deviation."""
    if len(values) < 2:
        return 0.0
    deviation = float(np.median(np.abs(np.asarray(values) - np.median(values))))
    return float(1.4826 * deviation * 1.2533 / np.sqrt(len(values)))
