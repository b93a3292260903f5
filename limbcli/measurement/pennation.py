"""Measure the pennation angle of muscle fibres in a B-mode image by its structure tensor.

Fascicles and the septa between them are lines longer than the width of speckle; the brightness changes most
across them. The tensor of brightness gradients, summed over a tile, gives the direction of least change and
how distinct it is (coherence). The angle is the mean over tiles by doubled angles, weighted by coherence. Its
uncertainty is the spread of the tiles, not divided by the root of their number: speckle biases all of them
the same way (a vastus lateralis whose septa lie at 20 degrees by eye is read as 14, with tiles spread by 7).
Speckle itself is longer across the beam than along it and would be read as 0 degrees; so the image is first
smoothed over the length of a speckle, and the little direction left in it is below the required coherence.

Source: Bigun & Granlund 1987, Proc. ICCV 433 (structure tensor); Rana, Hamarneh & Wakeling 2009, J Biomech
42:2068 (fascicles in B-mode images).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from skimage.feature import structure_tensor
from skimage.filters import gaussian
from skimage.transform import resize

from limbcli.errors import MeasurementError
from limbcli.measurement.ultrasound_image import UltrasoundImage
from limbcli.model import Array

STEP = 0.15  # mm per pixel of the resampled image, equal along and across
SMOOTHING = 0.45  # mm, standard deviation of the smoothing, about the length of a speckle
TILE = 5.0  # mm, side length of a tile
LEAST_COHERENCE = 0.4  # smallest coherence of a tile; speckle alone has 0.2
LEAST_AGREEMENT = 0.5  # smallest length of the mean of the tiles' doubled-angle unit vectors
FEWEST_TILES, LEAST_SHARE = 6, 0.25  # smallest number and fraction of tiles that show a direction
LEAST_DEVIATION_DEG = 2.0


@dataclass(frozen=True, eq=False)
class PennationReading:
    """A pennation angle and the tiles it was read from.

    angle_deg : of the fibres to the image's lateral axis, positive if they get deeper to the right
    deviation_deg : standard deviation: that of the tiles, not of their mean (see above), combined with 2
        degrees
    spread_deg : of the tiles about the mean; coherence : mean over the tiles used
    lateral, depth (n,) mm from the centre of the image and the probe face, tile_deg (n,) : of the tiles used
    """

    angle_deg: float
    deviation_deg: float
    spread_deg: float
    coherence: float
    lateral: Array
    depth: Array
    tile_deg: Array


def read_pennation(image: UltrasoundImage, *, top: float, bottom: float) -> PennationReading:
    """The fibre angle between two depths (mm below the probe face), over the whole width of the image.

    Raises MeasurementError if the muscle is too thin, or shows no direction or no common one.
    """
    region = image.main_region()
    width = (region.right - region.left + 1) * region.mm_per_pixel_x
    first = region.top + round(max(top, 0.0) / region.mm_per_pixel_y)
    last = min(region.top + round(bottom / region.mm_per_pixel_y), region.bottom + 1)
    height = (last - first) * region.mm_per_pixel_y
    where = image.where
    if height < 2 * TILE or width < 2 * TILE:
        what = f"{max(height, 0.0):.1f} mm of muscle by {width:.1f} mm are too small to detect fibres in"
        raise MeasurementError(what, where=where, fix="enter the angle manually ([[site.pennation]])")
    grey = image.grey[first:last, region.left : region.right + 1]
    shape = (max(2, round(height / STEP)), max(2, round(width / STEP)))
    alike = resize(grey, shape, order=1, anti_aliasing=True)
    smooth = gaussian(alike, SMOOTHING / STEP, mode="nearest")
    parts = structure_tensor(smooth, sigma=1.0, order="rc", mode="nearest")
    found = _tiles(np.stack(parts), round(TILE / STEP))
    keep = found[3] >= LEAST_COHERENCE
    if keep.sum() < max(FEWEST_TILES, LEAST_SHARE * len(keep)):
        raise MeasurementError(
            f"no fibres can be detected: {int(keep.sum())} of {len(keep)} tiles show a direction",
            where=where,
            fix="choose a frame along the fibres, or enter the angle manually ([[site.pennation]])",
        )
    rows, columns, angle, coherence = found[:, keep]
    mean, agreement = _axial_mean(angle, coherence)
    if agreement < LEAST_AGREEMENT:
        raise MeasurementError(
            f"the fibres show no common direction (agreement {agreement:.2f} of 1)",
            where=where,
            fix="give the depths of one muscle, or enter the angle manually ([[site.pennation]])",
        )
    off = np.mod(angle - mean + np.pi / 2, np.pi) - np.pi / 2  # of axes: within a quarter turn
    spread = float(np.degrees(np.sqrt(np.average(off**2, weights=coherence))))
    return PennationReading(
        angle_deg=float(np.degrees(mean)),
        deviation_deg=float(np.hypot(spread, LEAST_DEVIATION_DEG)),
        spread_deg=spread,
        coherence=float(coherence.mean()),
        lateral=columns * STEP - width / 2,
        depth=rows * STEP + (first - region.top) * region.mm_per_pixel_y,
        tile_deg=np.degrees(angle),
    )


def _tiles(tensor: Array, size: int) -> Array:
    """(4, n_tiles): centre (row, column), direction of least change (rad) and coherence of each tile.

    tensor (3, n_rows, n_columns) : rr, rc, cc
    """
    n_rows, n_columns = (each // size for each in tensor.shape[1:])
    cut = tensor[:, : n_rows * size, : n_columns * size]
    sums = cut.reshape(3, n_rows, size, n_columns, size).sum(axis=(2, 4)).reshape(3, -1)
    rr, rc, cc = sums
    # The gradient's axis is at 0.5 atan2(2 rc, cc - rr) to the column axis; fibres are perpendicular to it.
    angle = 0.5 * np.arctan2(2 * rc, cc - rr) + np.pi / 2
    angle = np.mod(angle + np.pi / 2, np.pi) - np.pi / 2
    coherence = np.hypot(cc - rr, 2 * rc) / np.maximum(rr + cc, 1e-30)
    row, column = np.divmod(np.arange(n_rows * n_columns), n_columns)
    return np.stack([(row + 0.5) * size, (column + 0.5) * size, angle, coherence])


def _axial_mean(angle: Array, weight: Array) -> tuple[float, float]:
    """Mean of axes (rad) and their agreement (0 to 1).

    >>> mean, agreement = _axial_mean(np.radians([80.0, -80.0]), np.ones(2))
    >>> round(abs(np.degrees(mean))), round(agreement, 2)
    (90, 0.94)
    """
    total = np.sum(weight * np.exp(2j * angle)) / np.sum(weight)
    return float(np.angle(total) / 2), float(np.abs(total))
