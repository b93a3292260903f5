"""Decode shear-wave speeds from a colour-overlay image by means of its own colour bar.

A pixel of the colour box is a colour of the bar blended with the grey B-mode image at some opacity:

    p = a c(v) + (1 - a) g (1, 1, 1)

For every colour of the bar the best-fitting grey g is subtracted; the speed is that of the colour with the
smallest misfit. A pixel without colour, with no matching colour, or with two distant speeds that fit equally
well, is excluded and counted, never guessed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import MeasurementError
from limbcli.measurement.elastography import SweMap
from limbcli.measurement.ultrasound_image import UltrasoundImage
from limbcli.model import Array

_LEAST_COLOUR = 24.0  # smallest difference (of 255) of the largest and smallest channel of a coloured pixel
_WORST_FIT = 18.0  # largest RGB distance (of 255) to the best colour of the bar
_AMBIGUOUS_FIT = 6.0  # of 255: a second colour with a misfit larger by less than this ...
_AMBIGUOUS_SPAN = 0.08  # ... and farther along the bar than this fraction makes the pixel ambiguous
_MOST_UNLIKE = (
    0.5  # of the coloured pixels: above this fraction, the matching ones match by chance, at wrong speeds
)
_BAR_COLOURS = 192
_SAMPLED_MM = 0.5  # spacing of the samples: adjacent screen pixels are not independent readings
_CHUNK = 4096

Box = tuple[int, int, int, int]


@dataclass(frozen=True)
class Overlay:
    """Positions of colour box and colour bar in the image (left, top, right, bottom, pixels, inclusive).

    low, high : m/s at the two ends of the bar; high is its top (or right) end
    opacity : of the colours over the B-mode image, 0 to 1
    of_modulus : whether the bar is linear in kPa, so that the square of the speed is linear along it
    """

    box_pixels: Box
    bar_pixels: Box
    low_m_per_s: float
    high_m_per_s: float
    opacity: float = 1.0
    of_modulus: bool = False


@dataclass(frozen=True, eq=False)
class DecodedMap:
    """The decoded speeds, and the number of pixels excluded for each reason.

    saturated : (n_pixels,) bool, pixels at either end of the bar
    """

    swe: SweMap
    saturated: NDArray[np.bool_]
    n_masked: int
    n_unlike: int
    n_ambiguous: int

    @property
    def share_unlike(self) -> float:
        """Fraction of the coloured pixels whose colour does not match the bar."""
        return self.n_unlike / (len(self.swe) + self.n_unlike + self.n_ambiguous)

    @property
    def unsaturated(self) -> SweMap:
        keep = ~self.saturated
        return SweMap(
            self.swe.lateral[keep], self.swe.depth[keep], self.swe.speed_m_per_s[keep], self.swe.path
        )


def decode_overlay(image: UltrasoundImage, overlay: Overlay) -> DecodedMap:
    """The wave-speed map of a colour-overlay image, in the probe frame.

    Raises MeasurementError if a box lies outside the image, the colour box in no calibrated region or across
    two, the bar has no colours or repeats them, nothing could be read, or most colours do not match the bar.
    """
    _check_box(image, overlay.box_pixels, "box_pixels")
    _check_box(image, overlay.bar_pixels, "bar_pixels")
    colours, speeds = bar_colours(image, overlay)
    columns, rows, lateral, depth = _samples(image, overlay.box_pixels, _SAMPLED_MM)
    rgb = image.rgb[rows, columns].astype(np.float64)
    coloured = np.ptp(rgb, axis=1) >= _LEAST_COLOUR * overlay.opacity
    index, fit, ambiguous = _nearest(rgb[coloured], colours, overlay.opacity)
    unlike = fit > _WORST_FIT
    good = ~unlike & ~ambiguous
    if not good.any() or unlike.mean() > _MOST_UNLIKE:
        raise MeasurementError(
            f"{'few pixels' if good.any() else 'no pixel'} of the box could be read "
            f"({int((~coloured).sum())} without colour, "
            f"{int(unlike.sum())} unlike the bar, {int(ambiguous.sum())} ambiguous, {int(good.sum())} read)",
            where=image.where,
            fix="correct box_pixels, bar_pixels and opacity (1 is opaque)",
        )
    kept = np.flatnonzero(coloured)[good]
    index = index[good]
    edge = max(1, len(colours) // 100)
    return DecodedMap(
        swe=SweMap(lateral[kept], depth[kept], speeds[index], image.path),
        saturated=(index < edge) | (index >= len(colours) - edge),
        n_masked=int((~coloured).sum()),
        n_unlike=int(unlike.sum()),
        n_ambiguous=int((ambiguous & ~unlike).sum()),
    )


def bar_colours(image: UltrasoundImage, overlay: Overlay) -> tuple[Array, Array]:
    """Colours (n, 3) along the bar from its low end to its high end, and their speeds (n,) m/s.

    Raises MeasurementError if the bar is mostly grey: it is another bar, or its position is wrong.
    """
    left, top, right, bottom = overlay.bar_pixels
    bar = image.rgb[top : bottom + 1, left : right + 1].astype(np.float64)
    upright = bar.shape[0] >= bar.shape[1]
    line = np.median(bar, axis=1)[::-1] if upright else np.median(bar, axis=0)
    if (np.ptp(line, axis=1) >= _LEAST_COLOUR).mean() < 0.5:
        raise MeasurementError(
            "the colour bar is mostly grey",
            where=f"{image.where}, bar_pixels {list(overlay.bar_pixels)}",
            fix="state bar_pixels = [left, top, right, bottom] of the elastography bar, without its frame",
        )
    place = np.linspace(0, len(line) - 1, min(_BAR_COLOURS, len(line)))
    colours = np.column_stack([np.interp(place, np.arange(len(line)), line[:, k]) for k in range(3)])
    low, high = overlay.low_m_per_s, overlay.high_m_per_s
    if overlay.of_modulus:
        return colours, np.sqrt(np.linspace(low**2, high**2, len(colours)))
    return colours, np.linspace(low, high, len(colours))


def _nearest(rgb: Array, colours: Array, opacity: float) -> tuple[NDArray[np.intp], Array, NDArray[np.bool_]]:
    """For each pixel: the index of the best colour, its misfit, and whether a distant colour fits as well."""
    n, span = len(colours), max(1, round(_AMBIGUOUS_SPAN * len(colours)))
    index, fit = np.zeros(len(rgb), dtype=np.intp), np.zeros(len(rgb))
    ambiguous = np.zeros(len(rgb), dtype=bool)
    for start in range(0, len(rgb), _CHUNK):
        part = slice(start, start + _CHUNK)
        misfit = _misfit(rgb[part], colours, opacity)
        best = misfit.argmin(axis=1)
        least = misfit[np.arange(len(best)), best]
        far = np.abs(np.arange(n)[None, :] - best[:, None]) > span
        rival = np.where(far, misfit, np.inf).min(axis=1)
        index[part], fit[part] = best, least
        ambiguous[part] = rival < least + _AMBIGUOUS_FIT
    return index, fit, ambiguous


def _misfit(rgb: Array, colours: Array, opacity: float) -> Array:
    """RGB distance (n_pixels, n_colours) after subtraction of the best-fitting grey under the colour."""
    rest = rgb[:, None, :] - opacity * colours[None, :, :]
    if opacity < 1.0:
        grey = np.clip(rest.mean(axis=2), 0.0, (1.0 - opacity) * 255.0)
        rest = rest - grey[:, :, None]
    return np.asarray(np.sqrt((rest**2).sum(axis=2)))


def _samples(
    image: UltrasoundImage, box: Box, pixel: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], Array, Array]:
    """Columns, rows, lateral and depth (mm), each (n,), of a sampling grid that is fixed to the image region.

    Boxes that are displaced by a pixel, as may happen from level to level, are thus sampled at the same
    positions.
    """
    region = image.region_of(box)
    step_x = max(1, round(pixel / region.mm_per_pixel_x))
    step_y = max(1, round(pixel / region.mm_per_pixel_y))
    first_row, first_column = (
        box[1] + (region.top - box[1]) % step_y,
        box[0] + (region.left - box[0]) % step_x,
    )
    rows, columns = np.mgrid[first_row : box[3] + 1 : step_y, first_column : box[2] + 1 : step_x]
    lateral = (columns - (region.left + region.right) / 2.0) * region.mm_per_pixel_x
    depth = (rows - region.top) * region.mm_per_pixel_y
    return columns.ravel(), rows.ravel(), lateral.ravel(), depth.ravel()


def _check_box(image: UltrasoundImage, box: Box, name: str) -> None:
    rows, columns = image.rgb.shape[:2]
    left, top, right, bottom = box
    if not (0 <= left < right < columns and 0 <= top < bottom < rows):
        raise MeasurementError(
            f"{name} = {list(box)} does not lie in the image of {columns} by {rows} pixels",
            where=image.where,
            fix=f"state {name} = [left, top, right, bottom] in pixels of this image",
        )
