"""Signal levels of muscle and fat, and the smooth bias field that modulates them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.imaging.signed_distance import depth_inside
from limbcli.imaging.volume import Volume
from limbcli.model import Array

SHADING_LENGTH = 25.0  # mm: length over which the bias field of a coil varies
_WORK_SPACING = 3.0  # mm: spacing of the coarse grid on which the field is estimated
_ROUNDS = 8
_DEEP = 12.0  # mm: depth below the skin beyond which most voxels are muscle


@dataclass(frozen=True, eq=False)
class TissueIntensities:
    """Normalised image: muscle is 1 everywhere, fat is `fat`, air and cortex are near 0.

    values : float32 array, the image divided by the local level of muscle
    fat : ratio of fat to muscle
    noise : standard deviation of the signal inside muscle, muscle = 1
    """

    values: NDArray[np.float32]
    fat: float
    noise: float

    @property
    def between(self) -> float:
        """The level half way between muscle and fat."""
        return 0.5 * (1.0 + self.fat)


def otsu(values: Array) -> float:
    """The threshold that best separates values into two groups (Otsu 1979).

    >>> values = np.concatenate([np.full(50, 1.0), np.full(50, 5.0)])
    >>> 1.0 < otsu(values) < 5.0
    True
    """
    counts, edges = np.histogram(values, bins=256)
    centres = 0.5 * (edges[1:] + edges[:-1])
    below = np.cumsum(counts)
    above = below[-1] - below
    sums = np.cumsum(counts * centres)
    mean_below = sums / np.maximum(below, 1)
    mean_above = (sums[-1] - sums) / np.maximum(above, 1)
    between = below * above * (mean_below - mean_above) ** 2
    best = np.flatnonzero(between >= between.max() * (1 - 1e-12))
    return float(centres[best].mean())


def normalise(volume: Volume, limb: NDArray[np.bool_]) -> TissueIntensities:
    """Divide the image by its bias field and by the level of muscle.

    The bright part of the image is modelled by two tissue classes (muscle, fat) times one smooth field:
    voxels are assigned to the nearest level in the logarithm, the field is the smoothed residual, and the two
    are determined alternately (the idea of Wells et al. 1996, IEEE TMI 15:429, with hard classes). Dark
    voxels (cortex, vessels, air) are excluded.

    volume : image with k along the limb
    limb : bool array, the limb's rough outline
    """
    step = np.maximum(1, np.round(_WORK_SPACING / volume.spacing)).astype(int)
    coarse = _block_mean(volume.values, step)
    inside = _block_mean(limb.astype(np.float32), step) > 0.9
    sigma = SHADING_LENGTH / (volume.spacing * step)
    near_mean = _smoothing(coarse.shape, sigma, mode="constant")
    wide_mean = _smoothing(coarse.shape, 3 * sigma, mode="nearest")
    floor = 0.3 * np.median(coarse[inside])
    use = inside & (coarse > floor)
    log_signal = np.log(np.maximum(coarse, floor))
    # well under the skin, most is muscle
    within_slices = np.array([*(volume.spacing * step)[:2], 1e6])
    field = _slope(log_signal, use & (depth_inside(inside, within_slices) > _DEEP))
    split = otsu((log_signal - field)[use])
    low, high = use & (log_signal - field < split), use & (log_signal - field >= split)
    intensities = np.array([np.median((log_signal - field)[each]) for each in (low, high)])
    for _ in range(_ROUNDS):
        flat = log_signal - field
        fat = np.abs(flat - intensities[1]) < np.abs(flat - intensities[0])
        residual = log_signal - np.where(fat, intensities[1], intensities[0])
        near = use & (np.abs(residual - field) < 0.5)
        field = _smooth(residual, near, near_mean, wide_mean)
        flat = log_signal - field
        intensities = np.array([np.median(flat[near & ~fat]), np.median(flat[near & fat])])
    shading = _refine(np.exp(field), step, volume.shape)
    muscle = float(np.exp(intensities[0]))
    values = (volume.values / (shading * muscle)).astype(np.float32)
    fat_ratio = float(np.exp(intensities[1] - intensities[0]))
    return TissueIntensities(values=values, fat=fat_ratio, noise=_noise(values, limb))


def _slope(log_signal: Array, use: NDArray[np.bool_]) -> Array:
    """Fit a plane by least absolute deviations (iterative reweighting); 0 if there are too few values."""
    if use.sum() < 50:
        return np.zeros_like(log_signal)
    where = np.moveaxis(np.indices(log_signal.shape), 0, -1).reshape(-1, 3) / np.array(log_signal.shape)
    terms = np.column_stack([np.ones(len(where)), where])
    chosen, values = terms[use.ravel()], log_signal[use]
    weight = np.ones(len(values))
    plane = np.zeros(4)
    for _ in range(15):
        root = np.sqrt(weight)
        plane, *_ = np.linalg.lstsq(chosen * root[:, None], values * root, rcond=None)
        weight = 1.0 / np.maximum(np.abs(values - chosen @ plane), 0.05)
    plane[0] = 0.0
    field = (terms @ plane).reshape(log_signal.shape)
    return np.asarray(field - np.median(field[use]))


def _block_mean(values: NDArray, step: NDArray[np.int_]) -> NDArray[np.float64]:
    """Mean over blocks of `step` voxels; the last incomplete blocks are padded with the edge."""
    pad = [(0, -n % s) for n, s in zip(values.shape, step, strict=True)]
    padded = np.pad(np.asarray(values, dtype=np.float32), pad, mode="edge")
    a, b, c = (n // s for n, s in zip(padded.shape, step, strict=True))
    return padded.reshape(a, step[0], b, step[1], c, step[2]).mean(axis=(1, 3, 5)).astype(float)


def _smoothing(shape: tuple[int, ...], sigma: Array, *, mode: str) -> list[Array]:
    """Gaussian smoothing as one matrix per axis: a width like the image's makes a filter that is longer."""
    return [
        ndimage.gaussian_filter1d(np.eye(n), each, axis=0, mode=mode)
        for n, each in zip(shape, sigma, strict=True)
    ]


def _smoothed(values: Array, along: list[Array]) -> Array:
    for matrix in along:  # each turns the first axis to the end, so that three give the order back
        values = np.tensordot(values, matrix, (0, 1))
    return values


def _smooth(
    values: Array, weight: NDArray[np.bool_], near_mean: list[Array], wide_mean: list[Array]
) -> Array:
    """Gaussian mean of `values` where `weight`, extrapolated smoothly elsewhere."""
    w = weight.astype(float)
    top, bottom = _smoothed(values * w, near_mean), _smoothed(w, near_mean)
    wide, wide_weight = _smoothed(values * w, wide_mean), _smoothed(w, wide_mean)
    trust = 1e-3
    return (top + trust * wide / np.maximum(wide_weight, 1e-9)) / (bottom + trust)


def _refine(coarse: Array, step: NDArray[np.int_], shape: tuple[int, int, int]) -> NDArray[np.float32]:
    """The coarse field on the full grid, by linear interpolation along one axis at a time."""
    fine = coarse.astype(np.float32)
    for axis in range(3):
        at = (np.arange(shape[axis]) - (step[axis] - 1) / 2) / step[axis]
        at = np.clip(at, 0, fine.shape[axis] - 1)
        low = np.minimum(at.astype(int), max(fine.shape[axis] - 2, 0))
        high = np.minimum(low + 1, fine.shape[axis] - 1)
        shape_of_weight = [1, 1, 1]
        shape_of_weight[axis] = len(at)
        weight = (at - low).astype(np.float32).reshape(shape_of_weight)
        fine = np.take(fine, low, axis) * (1 - weight) + np.take(fine, high, axis) * weight
    return fine


def _noise(values: NDArray[np.float32], limb: NDArray[np.bool_]) -> float:
    """Robust standard deviation of the noise inside muscle, from second differences."""
    muscle = limb & (np.abs(values - 1.0) < 0.4)
    triple = muscle[:-2] & muscle[1:-1] & muscle[2:]
    if triple.sum() < 100:
        return 0.0
    second = (values[:-2] - 2 * values[1:-1] + values[2:])[triple]
    return float(1.4826 * np.median(np.abs(second)) / np.sqrt(6.0))
