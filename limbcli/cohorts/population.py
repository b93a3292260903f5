"""Model of the rows of a cohort as layered slabs: readings predicted from the tissue, and their noise.

Tissue: theta = ln c_muscle (MPa), ln c_fat (MPa), ln m. Readings of a row, at the largest strain it reached:

    ln of largest force over (face, strain)              overall stiffness
    ln of the secant's slope over that of the line       stiffening, which determines m
    fat's fraction of the shortening of fat and muscle   which of the two layers is softer

The shortening of the skin is compared with the prediction of the slab but not used in the fit, because the
skin's stiffness is fixed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limbcli.inference.layered_family import (
    CONVEXITY,
    EXPONENT,
    FORCE,
    HIGH,
    LOW,
    MUSCLE_PART,
    RATIO,
    SKIN_PART,
    LayeredFamily,
    OfTissue,
    is_inside,
)
from limbcli.model import Array

PARAMETERS = ("c_muscle", "c_fat", "m")
C_MUSCLE, C_FAT, M = range(3)
# Initial guess of the population mean, and the standard deviation that the weak prior on the spread expects:
# c of some kPa, within a factor 2.
START = np.log(np.array([0.008, 0.008, 3.0]))
PRIOR_DEVIATION = np.array([0.5, 0.7, 0.4])
FORCE_NOISE = 0.02  # relative standard deviation of the force, from transducer and hold
_STEEPNESS = 1.4  # typical d ln force / d ln depth, which converts depth error into force error
# Rows needed to determine the slope's noise; difference of R2 up to which a parabola fits no better than a
# line; and standard deviation of ln slope where the table does not determine it.
_LEAST_NEAR_LINE, _NEAR_LINE, _ASSUMED_SLOPE = 20, 0.003, 0.05
_LOGISTIC = 0.25  # largest derivative of a fraction by its logit
_TO_DEVIATION = 1.4826  # standard deviation over median absolute deviation, for a Gaussian


@dataclass(frozen=True, eq=False)
class CohortModel:
    """Rows of one population: coordinates (n, 6), those of the tissue left open, and the readings as
    functions of the tissue."""

    shape: Array
    of_tissue: OfTissue

    @staticmethod
    def of(family: LayeredFamily, thickness: Array, face: Array, strain: Array) -> CohortModel:
        """Build the model from thickness (n, 3: skin, fat, muscle) mm, face area (n,) mm2 and strain (n,) of
        the whole thickness."""
        root = np.sqrt(face)
        whole = thickness.sum(axis=1)
        share = thickness[:, 1] / (thickness[:, 1] + thickness[:, 2])
        open_ = np.zeros(len(whole))
        shape = np.column_stack([np.log(whole / root), share, thickness[:, 0] / root, open_, open_, strain])
        return CohortModel(shape, family.of_shape(shape))

    def __call__(self, theta: Array, slopes: bool) -> tuple[Array, Array]:
        """Readings (..., n, 3) for tissue parameters (..., n, 3), and their derivatives (..., n, 3, 3)."""
        values, rates = self.of_tissue(tissue(theta), slopes=slopes)
        part = 1.0 / (1.0 + np.exp(-values[..., MUSCLE_PART]))
        seen = np.stack(
            [theta[..., C_MUSCLE] + values[..., FORCE], values[..., CONVEXITY], 1.0 - part], axis=-1
        )
        if not slopes:
            return seen, np.empty((*seen.shape, 0))
        by_part = -(part * (1 - part))[..., None] * rates[..., MUSCLE_PART, :]
        by = np.stack([rates[..., FORCE, :], rates[..., CONVEXITY, :], by_part], axis=-2)
        found = np.stack([-by[..., 0], by[..., 0], by[..., 1]], axis=-1)
        found[..., 0, C_MUSCLE] += 1.0
        return seen, found

    def skin_part(self, theta: Array) -> Array:
        """Skin's fraction (n,) of the total shortening."""
        return np.asarray(self.of_tissue(tissue(theta))[0][..., SKIN_PART])

    def log_slope(self, theta: Array) -> Array:
        """ln of the stiffness (n,): pressure over displacement (MPa/mm) times the thickness (mm)."""
        values, _ = self.of_tissue(tissue(theta))
        return np.asarray(theta[..., C_MUSCLE] + values[..., FORCE] - values[..., CONVEXITY])

    def at_an_end(self, theta: Array) -> NDArray[np.bool_]:
        """Rows (n,) whose tissue parameters lie at a limit of the family's range."""
        x, ends = tissue(theta), [RATIO, EXPONENT]
        return np.asarray(((x <= LOW[ends] + 1e-3) | (x >= HIGH[ends] - 1e-3)).any(axis=1))

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Rows (n,) whose shape and strain lie within the family's range."""
        return is_inside(self.shape)


def tissue(theta: Array) -> Array:
    """Tissue coordinates ln(c_fat / c_muscle) and ln m (..., 2) of theta (..., 3)."""
    return np.stack([theta[..., C_FAT] - theta[..., C_MUSCLE], theta[..., M]], axis=-1)


def readings(force: Array, face: Array, whole: Array, shortened: Array, slope: Array) -> Array:
    """The three readings (n, 3) of each row from force (N), face (mm2), whole thickness (mm), shortening of
    the layers (n, 3) (mm) and slope (MPa/mm)."""
    depth = shortened.sum(axis=1)
    below = shortened[:, 1] + shortened[:, 2]
    secant = force / face / depth
    return np.column_stack([np.log(secant * whole), np.log(secant / slope), shortened[:, 1] / below])


def reading_noise(
    shortened: Array, layer_deviation: Array, slope_deviation: float, emulator_error: Array
) -> Array:
    """Noise covariances (n, 3, 3) of the readings, from the errors of layer edges, slope, force and emulator.

    layer_deviation : (3,) standard deviation of the shortening of a layer (mm)
    emulator_error : (4,) as LayeredFamily.error
    """
    depth, below = shortened.sum(axis=1), shortened[:, 1] + shortened[:, 2]
    part = np.clip(shortened[:, 1] / below, 0.0, 1.0)
    edge = layer_deviation.max()  # the whole thickness has two edges in each image, as a layer has
    out = np.zeros((len(depth), 3, 3))
    out[:, 0, 0] = FORCE_NOISE**2 + (_STEEPNESS * edge / depth) ** 2 + emulator_error[FORCE] ** 2
    out[:, 1, 1] = slope_deviation**2 + emulator_error[CONVEXITY] ** 2
    marks = (layer_deviation[1] * (1 - part)) ** 2 + (layer_deviation[2] * part) ** 2
    out[:, 2, 2] = marks / below**2 + (_LOGISTIC * emulator_error[MUSCLE_PART]) ** 2
    return out


def slope_noise(convexity: Array, r2_line: Array | None, r2_parabola: Array | None) -> tuple[float, bool]:
    """Standard deviation of ln stiffness, and whether the table determines it.

    Where a parabola fits no better than a line, the slope of the line must equal that of the secant, so their
    difference is noise.

    convexity : (n,) ln of secant over slope
    """
    if r2_line is None or r2_parabola is None:
        return _ASSUMED_SLOPE, False
    near = np.abs(r2_parabola - r2_line) < _NEAR_LINE
    if near.sum() < _LEAST_NEAR_LINE:
        return _ASSUMED_SLOPE, False
    values = convexity[near]
    return float(_TO_DEVIATION * np.median(np.abs(values - np.median(values)))), True
