"""Detect the colour bar and the colour box in an elastography image, if they are not given.

A bar is a narrow coloured strip, of uniform colour across and many colours along. The box is the largest
coloured area beside it. If either is ambiguous, an error is raised instead of a guess.
"""

from __future__ import annotations

import colorsys
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.errors import MeasurementError
from limbcli.measurement.swe_image import Box
from limbcli.measurement.ultrasound_image import UltrasoundImage
from limbcli.model import Array

# smallest difference of the largest and smallest channel (of 255) in the bar and in the box
_BAR_COLOUR, _BOX_COLOUR = 60.0, 24.0
_SLENDER = 4.0  # smallest length-to-width ratio of a bar
_SHORTEST, _NARROWEST = 40, 4  # smallest length and width of a bar, pixels
_UNEVEN = 14.0  # largest standard deviation of the colours across a bar, of 255
_BLURRED = 0.2  # fraction of a bar's width at each side that compression may have blurred
_EVEN_STEP = 20.0, 45.0  # bounds (of 255) of the colour step between lines above which the bar has ended
_GREY_END = 0.15  # largest fraction of a bar that may be nearly grey at an end
_HUES = 0.3  # smallest fraction of the hue circle that a bar spans
_SMALLEST_BOX = 900  # smallest number of coloured pixels of a box
_COLOURED = 0.2  # smallest coloured fraction of a row or column of the box, relative to the fullest one


@dataclass(frozen=True)
class Screen:
    """Where a scanner's screen of columns x rows pixels has its colour bar, from end to end."""

    columns: int
    rows: int
    bar: Box

    def bar_in(self, image: UltrasoundImage) -> Box:
        """The bar in a picture of the whole screen, at any size.

        Raises MeasurementError if the picture is not of the screen's shape.
        """
        rows, columns = image.rgb.shape[:2]
        scale = columns / self.columns
        if abs(rows - scale * self.rows) > scale:
            raise MeasurementError(
                f"the picture of {columns} by {rows} pixels is not a whole screen of {self.columns} by "
                f"{self.rows}, which the preset is for",
                where=image.where,
                fix="remove preset (the bar is then searched), or state bar_pixels",
            )
        left, top, right, bottom = self.bar
        return (
            math.ceil(left * scale),
            math.ceil(top * scale),
            math.floor((right + 1) * scale) - 1,
            math.floor((bottom + 1) * scale) - 1,
        )


# SuperSonic/Hologic Mach 30, bar of Young's modulus: bar as read by swepy (oseynnes/swepy 244a650,
# swepy/processing/data.py) and as seen in its picture of the screen (src/sc0.png, bar to 300 kPa).
SCREENS = {"mach30": Screen(720, 540, (693, 70, 699, 179))}


def find_bar(image: UltrasoundImage) -> Box:
    """The colour bar of the elastogram: left, top, right, bottom (pixels, inclusive).

    Raises MeasurementError if there is none or more than one candidate, or its end is not distinct from its
    surroundings.
    """
    rgb = image.rgb.astype(np.float64)
    marks, _ = ndimage.label(np.ptp(rgb, axis=2) >= _BAR_COLOUR)
    found = []
    for rows, columns in ndimage.find_objects(marks):
        box = (columns.start, rows.start, columns.stop - 1, rows.stop - 1)
        span = _hue_span(rgb, box)
        if span >= _HUES:
            found.append((span, box))
    if len(found) != 1:
        places = "; ".join(str(list(box)) for _, box in found)
        raise MeasurementError(
            f"{len(found)} strips look like a colour bar ({places})" if found else "no colour bar was found",
            where=image.where,
            fix="state bar_pixels = [left, top, right, bottom] of the elastography bar",
        )
    return _to_its_ends(rgb, found[0][1], image)


def _to_its_ends(rgb: Array, box: Box, image: UltrasoundImage) -> Box:
    """Extend a bar over its nearly grey ends, where its colours continue smoothly up to an edge."""
    left, top, right, bottom = box
    upright = bottom - top >= right - left
    lines = rgb[:, left : right + 1] if upright else rgb[top : bottom + 1].transpose(1, 0, 2)
    lines = _without_sides(lines)
    first, last = (top, bottom) if upright else (left, right)
    line, even = np.median(lines, axis=1), lines.std(axis=1).max(axis=1) <= _UNEVEN
    steps = np.abs(np.diff(line, axis=0)).max(axis=1)
    goes_on = steps <= np.clip(5 * float(np.median(steps[first:last])), *_EVEN_STEP)
    most = round(_GREY_END * (last - first + 1))
    begin, end = first, last
    while begin > 0 and goes_on[begin - 1] and even[begin - 1] and first - begin <= most:
        begin -= 1
    while end < len(line) - 1 and goes_on[end] and even[end + 1] and end - last <= most:
        end += 1
    if max(first - begin, end - last) > most:
        raise MeasurementError(
            f"the colour bar at {list(box)} blends into its surroundings: its end is not clear",
            where=image.where,
            fix="state bar_pixels = [left, top, right, bottom] of the elastography bar, from end to end",
        )
    return (left, begin, right, end) if upright else (begin, top, end, bottom)


def _hue_span(rgb: Array, box: Box) -> float:
    """Fraction of the hue circle spanned by a strip; 0 if it is not a bar."""
    left, top, right, bottom = box
    part = rgb[top : bottom + 1, left : right + 1]
    if part.shape[0] < part.shape[1]:
        part = part.transpose(1, 0, 2)
    length, width = part.shape[:2]
    if length < _SHORTEST or width < _NARROWEST or length < _SLENDER * width:
        return 0.0
    inner = _without_sides(part)
    if np.median(inner.std(axis=1).max(axis=1)) > _UNEVEN:
        return 0.0
    line = np.median(inner, axis=1)
    hues = np.sort([colorsys.rgb_to_hsv(*each)[0] for each in line[np.ptp(line, axis=1) >= _BAR_COLOUR]])
    gaps = np.diff(np.r_[hues, hues[0] + 1.0]) if len(hues) else np.ones(1)
    return float(1.0 - gaps.max())


def _without_sides(lines: Array) -> Array:
    """The middle of a strip (length, width, 3), at least 4 wide."""
    side = max(1, round(_BLURRED * lines.shape[1]))
    return lines[:, side:-side]


def find_box(image: UltrasoundImage, bar: Box) -> Box:
    """The colour box: the largest coloured area apart from the bar.

    Raises MeasurementError if nothing else in the image is coloured.
    """
    coloured = np.ptp(image.rgb.astype(np.float64), axis=2) >= _BOX_COLOUR
    left, top, right, bottom = bar
    coloured[max(0, top - 4) : bottom + 5, max(0, left - 4) : right + 5] = False
    marks, count = ndimage.label(ndimage.binary_closing(coloured, iterations=3))
    sizes = ndimage.sum_labels(coloured, marks, np.arange(1, count + 1)) if count else np.zeros(0)
    if not count or sizes.max() < _SMALLEST_BOX:
        raise MeasurementError(
            "no coloured box was found",
            where=image.where,
            fix="state box_pixels = [left, top, right, bottom] of the elastography box",
        )
    own = coloured & (marks == 1 + int(np.argmax(sizes)))
    rows, columns = (_extent(own.sum(axis=axis)) for axis in (1, 0))
    return columns[0], rows[0], columns[1], rows[1]


def _extent(counts: NDArray[np.int_]) -> tuple[int, int]:
    """First and last line whose coloured part is a sufficient fraction of that of the fullest one."""
    full = np.flatnonzero(counts >= _COLOURED * counts.max())
    return int(full[0]), int(full[-1])
