"""Division of the scanner's region into parts: averages of a map's pixels, and sampling points of a model.

A map is reduced to the actual resolution of a shear-wave image: parts a few millimetres wide and deep.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from limbcli.effects.frozen_deformation import ScannerView
from limbcli.effects.stiffness_places import Places
from limbcli.measurement.elastography import SweMap
from limbcli.model import Array, IntArray, LimbModel
from limbcli.shear_waves.pixels import Window, pixel_averages

_PART_MM = 4.0  # approximate side length of a part
_USUAL_MM, _INNER_MM = 20.0, 12.0  # largest and smallest half width of a mean's region, if no map defines it
_WIDTH_PARTS = 10  # number of parts across the usual region; parts within the inner width are complete
_SHARE = 0.6  # fraction of a part's sampling points that must lie in the model's tissue
_SHARE_READ = 0.75  # fraction of a part's pixels that must have been read: near bone they show edge effects
_ROUNDED = 1e-6  # rounding tolerance of positions, in parts or pixels
_SUBDIVIDED = 2  # subdivisions of each side of a part for the sampling points of a model
# Each point is blurred by the scanner's smoothing in x and z, and averaged over the slice thickness in y.
_BLUR, _BLUR_WEIGHT = (-(3.0**0.5), 0.0, 3.0**0.5), (1 / 6, 2 / 3, 1 / 6)  # in std. deviations: Gauss-Hermite
# The same over the slice, in half slices: Gauss-Legendre.
_SLICE, _SLICE_WEIGHT = (-(0.6**0.5), 0.0, 0.6**0.5), (5 / 18, 8 / 18, 5 / 18)


@dataclass(frozen=True)
class Windows:
    """A region `left` to `right`, `top` to `bottom` (mm, below the face) of `across` x `down` parts.

    Tables list the whole region first, then its parts row by row downwards.
    whole_is_known : the region is given by maps; else a mean may be over all of it or only over what lies
    within 12 mm of its centre
    """

    left: float = -_USUAL_MM
    right: float = _USUAL_MM
    top: float = 2.0
    bottom: float = 25.0
    across: int = _WIDTH_PARTS
    down: int = 3
    smoothing: float = 3.0
    elevation: float = 2.0
    whole_is_known: bool = False

    @staticmethod
    def usual(probe_length: float) -> Windows:
        """Region where only means are given: as wide as the probe, at most 40 mm."""
        half = min(_USUAL_MM, probe_length / 2)
        return Windows(-half, half, across=max(2 * round(half / _PART_MM), 2))

    @staticmethod
    def of_maps(maps: Sequence[SweMap]) -> Windows:
        """The region of measured maps, in parts of about 4 mm."""
        lateral, depth = (
            np.concatenate([getattr(each, name) for each in maps]) for name in ("lateral", "depth")
        )
        half_x, half_z = (0.5 * pitch_of(values) for values in (lateral, depth))
        left, right = float(lateral.min() - half_x), float(lateral.max() + half_x)
        top, bottom = float(depth.min() - half_z), float(depth.max() + half_z)
        across, down = (max(round(size / _PART_MM), 1) for size in (right - left, bottom - top))
        return Windows(left, right, max(top, 0.0), bottom, across, down, whole_is_known=True)

    @property
    def n_parts(self) -> int:
        return self.across * self.down

    @cached_property
    def middles(self) -> Array:
        """Lateral position and depth below the face (n_parts, 2) of each part's centre, in mm."""
        x = self.left + (self.right - self.left) * (np.arange(self.across) + 0.5) / self.across
        z = self.top + (self.bottom - self.top) * (np.arange(self.down) + 0.5) / self.down
        return np.array([(a, b) for b in z for a in x])

    @cached_property
    def _inner(self) -> NDArray[np.bool_]:
        """Parts (n_parts,) within the narrowest region that a mean may be over."""
        return np.asarray(np.abs(self.middles[:, 0]) < _INNER_MM)

    def without_spikes(self, ln_speed: Array) -> Array:
        """ln speeds (n, 1 + n_parts) with the parts median-filtered (3 x 3): a change between meshes in a
        single part, but not in its neighbours, is discretisation error."""
        parts = ln_speed[:, 1:].reshape(-1, self.down, self.across)
        smooth = median_filter(parts, size=(1, 3, 3), mode="nearest")
        return np.column_stack([ln_speed[:, 0], smooth.reshape(len(ln_speed), -1)])

    @property
    def depths(self) -> Array:
        """Depth of each part's centre below the face (mm), the whole region first."""
        return np.concatenate([[0.5 * (self.top + self.bottom)], self.middles[:, 1]])

    def names(self) -> list[str]:
        """Names of the whole and of every part, by the third of the region it lies in."""
        sides, levels = ("left", "middle", "right"), ("shallow", "mid-depth", "deep")
        found = ["whole"]
        for x, z in self.middles:
            column = int(3 * (x - self.left) / (self.right - self.left))
            row = int(3 * (z - self.top) / (self.bottom - self.top))
            found.append(f"{levels[min(row, 2)]} {sides[min(column, 2)]}")
        return found

    @cached_property
    def pixels(self) -> tuple[Array, Array]:
        """Lateral position and depth (n_pixels,) of the sampling points of a model, part after part."""
        share = (np.arange(_SUBDIVIDED) + 0.5) / _SUBDIVIDED - 0.5
        dz, dx = np.meshgrid(
            share * (self.bottom - self.top) / self.down, share * (self.right - self.left) / self.across,
            indexing="ij",
        )  # fmt: skip
        lateral = self.middles[:, :1] + dx.ravel()
        return lateral.ravel(), (self.middles[:, 1:] + dz.ravel()).ravel()

    def seen(
        self, model: LimbModel, places: Array, rest: Array, gradient: Array, *, depth: float
    ) -> ScannerView:
        """View of the region on deformed cells, with the probe's face at this depth (mm).

        places, rest : (n_cells, 3) mm, deformed and undeformed positions; gradient : (n_cells, 3, 3)
        """
        window = Window(smoothing=self.smoothing, elevation=self.elevation, pixel=_PART_MM / _SUBDIVIDED)
        averages = pixel_averages(places, self.pixels, face_height=-depth, window=window)
        at, F = averages(rest), averages(gradient.reshape(-1, 9)).reshape(-1, 3, 3)
        # one pixel averages 27 quadrature points
        sigma = self.smoothing / 2.355
        offsets = np.array(list(product(_BLUR, _SLICE, _BLUR))) * (sigma, self.elevation, sigma)
        weight = np.prod(list(product(_BLUR_WEIGHT, _SLICE_WEIGHT, _BLUR_WEIGHT)), axis=1)
        F = np.where(np.asarray(np.isfinite(F).all(axis=(1, 2)))[:, None, None], F, np.eye(3))
        back = np.linalg.solve(F, np.broadcast_to(offsets.T, (len(F), 3, len(offsets))))
        blurred = np.nan_to_num(at)[:, None, :] + np.swapaxes(back, 1, 2)
        return ScannerView(averages, Places(blurred, model), weight, self.log_means_of)

    def log_means_of(self, speed_m_per_s: Array) -> Array:
        """ln mean speed of the whole and of every part (..., 1 + n_parts), from speeds at `pixels`."""
        table = speed_m_per_s.reshape(*speed_m_per_s.shape[:-1], self.n_parts, -1)
        known = np.isfinite(table) & (table > 0)  # a linear fit through few elements may be negative
        counts = known.sum(axis=-1)
        total = np.where(known, table, 0.0).sum(axis=-1)
        enough = counts >= _SHARE * table.shape[-1]
        parts = np.where(enough, _log_mean(total, counts), np.nan)
        return np.concatenate([self._whole(total, counts)[..., None], parts], axis=-1)

    def _whole(self, total: Array, counts: IntArray) -> Array:
        every = _log_mean(total.sum(axis=-1), counts.sum(axis=-1))
        if self.whole_is_known:
            return every
        inner = _log_mean(total[..., self._inner].sum(axis=-1), counts[..., self._inner].sum(axis=-1))
        return np.where(np.isfinite(inner), 0.5 * (every + inner), every)

    def width_uncertainty(self, log_speed: Array) -> Array:
        """Uncertainty of ln mean speed (n,) from the unknown width of the region: half the difference between
        the narrowest and the widest region. log_speed : (n, 1 + n_parts)"""
        if self.whole_is_known:
            return np.zeros(len(log_speed))
        speed = np.exp(log_speed[:, 1:])
        inner = self._inner
        with np.errstate(invalid="ignore"):
            narrow, wide = (
                np.nanmean(np.where(mask, speed, np.nan), axis=1) for mask in (inner, np.isfinite(inner))
            )
        return np.nan_to_num(0.5 * np.log(narrow / wide))

    def part_of(self, lateral: Array, depth: Array) -> IntArray:
        """Index of the part that each pixel (n,) lies in; -1 outside the region."""
        column = _along_side(lateral, self.left, self.right, self.across)
        row = _along_side(depth, self.top, self.bottom, self.down)
        inside = (column >= 0) & (column < self.across) & (row >= 0) & (row < self.down)
        return np.asarray(np.where(inside, row * self.across + column, -1))

    def log_means(self, swe: SweMap) -> tuple[Array, Array]:
        """ln of the mean speed and the pixel count of the whole and every part, (1 + n_parts,) each; NaN
        where too few of a part's pixels were read, as at the edge of bone."""
        part = self.part_of(swe.lateral, swe.depth)
        inside = part >= 0
        counts = np.bincount(part[inside], minlength=self.n_parts)
        total = np.bincount(part[inside], swe.speed_m_per_s[inside], minlength=self.n_parts)
        # pixels of each part if none is missing, which varies on a coarse grid; the grid is continued where
        # nothing was read: rows that end in bone count as missing
        across = _grid_per_part(swe.lateral, self.left, self.right, self.across)
        down = _grid_per_part(swe.depth, self.top, self.bottom, self.down)
        most = np.minimum(np.outer(down, across).ravel(), counts.max(initial=0))
        enough = counts >= np.maximum(_SHARE_READ * most, 1)
        means = np.where(enough, np.log(np.maximum(total, 1e-9) / np.maximum(counts, 1)), np.nan)
        whole = np.log(swe.speed_m_per_s[inside].mean()) if inside.any() else np.nan
        return np.r_[whole, means], np.r_[inside.sum(), counts]


def _log_mean(total: Array, counts: IntArray) -> Array:
    """ln of means (...,); NaN where nothing was counted."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.log(total / counts))


def _along_side(at: Array, low: float, high: float, n_parts: int) -> IntArray:
    """Part along one side that each position lies in; on a border, within rounding, the next one."""
    return np.asarray(np.floor((at - low) / (high - low) * n_parts + _ROUNDED).astype(np.int64))


def _grid_per_part(values: Array, low: float, high: float, n_parts: int) -> IntArray:
    """Number of grid positions in each part along one side (n_parts,), for the grid on which `values` lie.

    >>> _grid_per_part(np.array([3.75, 6.25]), 0.0, 15.0, 4).tolist()
    [1, 2, 1, 2]
    """
    if not len(values):
        return np.zeros(n_parts, dtype=np.int64)
    pitch, nearest = pitch_of(values), float(values.min())
    first = nearest - pitch * np.floor((nearest - low) / pitch + _ROUNDED)
    part = _along_side(np.arange(first, high, pitch), low, high, n_parts)
    return np.bincount(np.clip(part, 0, n_parts - 1), minlength=n_parts)


def pitch_of(values: Array) -> float:
    """Distance between neighbouring pixels (mm); 1 if there is only one."""
    apart = np.diff(np.unique(np.round(values, 6)))
    return float(np.median(apart)) if len(apart) else 1.0
