"""What the scanner would show of simulated tissue: wave speeds on the pixels of its window.

Positions are in the site's frame (x along the probe's long side, z outward); the window is fixed to the probe
face and moves with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from limbcli.errors import MeasurementError
from limbcli.measurement.elastography import SweMap
from limbcli.model import Array, IntArray

_FEWEST, _MOST = 32, 400  # smallest and largest number of elements used in the fit at a pixel
_REACH = 2.5  # cut-off of the Gaussian, in standard deviations


@dataclass(frozen=True)
class Window:
    """The scanner's region of interest: centred under the probe, mm.

    smoothing : full width at half maximum of the averaging; elevation : half thickness of the slice
    """

    half_width: float = 12.0
    depth_from: float = 2.0
    depth_to: float = 25.0
    pixel: float = 1.0
    smoothing: float = 3.0
    elevation: float = 3.0

    @property
    def slice_reach(self) -> float:
        """Distance (mm) on either side of the image plane over which pixels average."""
        return self.elevation + self.smoothing

    def pixels(self) -> tuple[Array, Array]:
        """lateral, depth of all pixels, (n_pixels,) each, row by row downwards."""
        n = round(self.half_width / self.pixel)
        lateral = self.pixel * np.arange(-n, n + 1)
        depth = np.arange(self.depth_from, self.depth_to + 1e-9, self.pixel)
        z, x = np.meshgrid(depth, lateral, indexing="ij")
        return x.ravel(), z.ravel()


def predict_map(
    positions: Array,
    speed_m_per_s: Array,
    *,
    face_height: float,
    window: Window = Window(),
    pixels: tuple[Array, Array] | None = None,
) -> SweMap:
    """Average speeds at elements onto the window's pixels.

    Each pixel takes the value at its centre of a local linear fit to the surrounding speeds, with Gaussian
    weights of the window's smoothing: a linear speed field is reproduced exactly, at edges too. Pixels
    outside the tissue (bone, beyond the model) and points where no wave propagates are omitted.

    positions : (n_elements, 3) mm, in the deformed tissue, site frame
    speed_m_per_s : (n_elements,), NaN where no wave propagates
    face_height : z of the probe face, mm
    pixels : lateral and depth of pixels other than the window's own, such as those of a measured map, mm

    Raises MeasurementError if no pixel lies in the tissue.
    """
    lateral, depth = window.pixels() if pixels is None else pixels
    known = np.flatnonzero(np.isfinite(speed_m_per_s))
    averages = pixel_averages(positions[known], (lateral, depth), face_height=face_height, window=window)
    inside = averages.inside
    if not inside.any():
        raise MeasurementError(
            "the scanner's window contains no tissue of the model",
            where=f"shear-wave prediction, probe face at z = {face_height:.1f} mm",
            fix="check that the positions are in the site's frame and in mm",
        )
    speed = averages(speed_m_per_s[known])[inside]
    good = np.isfinite(speed) & (speed > 0)
    return SweMap(lateral[inside][good], depth[inside][good], speed[good])


@dataclass(frozen=True, eq=False)
class PixelAverages:
    """The averaging from elements to pixels, as a linear map of the element values.

    inside (n_pixels,) bool: in the tissue; index, weight (n_inside, k): elements and their weights
    """

    inside: NDArray[np.bool_]
    index: IntArray
    weight: Array

    def __call__(self, values: Array) -> Array:
        """Values (n_elements,) or (n_elements, q) averaged to all pixels (n_pixels, ...); NaN outside."""
        out = np.full((len(self.inside), *values.shape[1:]), np.nan)
        out[self.inside] = np.einsum("pk,pk...->p...", self.weight, values[self.index])
        return out


def pixel_averages(
    positions: Array, pixels: tuple[Array, Array], *, face_height: float, window: Window
) -> PixelAverages:
    """The averages of `predict_map` for elements at positions (n_elements, 3) mm.

    pixels : lateral and depth (n_pixels,) mm
    """
    lateral, depth = pixels
    nothing = PixelAverages(
        np.zeros(len(lateral), dtype=np.bool_), np.zeros((0, 1), np.int64), np.zeros((0, 1))
    )
    near = np.flatnonzero(np.abs(positions[:, 1]) <= window.slice_reach)
    targets = np.stack([lateral, np.zeros_like(lateral), face_height - depth], axis=1)
    if len(near) < _FEWEST:
        return nothing
    points = positions[near]
    tree = cKDTree(points)
    sigma = window.smoothing / 2.355
    counts = tree.query_ball_point(targets, _REACH * sigma, return_length=True)
    count = min(int(np.clip(np.max(counts), _FEWEST, _MOST)), len(points))
    distance, index = tree.query(targets, k=count)
    spacing = tree.query(points[index[:, 0]], k=9)[0][:, 8]  # local spacing, because meshes are graded
    reach = np.maximum(spacing, window.pixel)
    inside = _surrounded(points, targets, distance, index, reach=reach)
    if not inside.any():
        return nothing
    offset = points[index[inside]] - targets[inside][:, None, :]
    return PixelAverages(inside, near[index[inside]], _local_linear(offset, sigma=sigma))


def _surrounded(
    points: Array, targets: Array, distance: Array, index: Array, *, reach: Array
) -> NDArray[np.bool_]:
    """(n_targets,) bool: an element is near, and the nearest eight do not form a distant cluster."""
    offset = points[index[:, :8]] - targets[:, None, :]
    center = np.linalg.norm(offset.mean(axis=1), axis=1)
    spread = np.linalg.norm(offset - offset.mean(axis=1, keepdims=True), axis=2).mean(axis=1)
    return np.asarray((distance[:, 0] <= reach) & (center <= 1.5 * spread))


def _local_linear(offset: Array, *, sigma: float) -> Array:
    """Weights (n, k) of values at offsets (n, k, 3) that give the value at 0 of a weighted linear fit."""
    weight = np.exp(-0.5 * np.sum((offset / sigma) ** 2, axis=2)) + 1e-9
    design = np.concatenate([np.ones((*weight.shape, 1)), offset], axis=2)
    weighted = weight[:, :, None] * design
    normal = np.einsum("nki,nkj->nij", weighted, design)
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.diag([0.0, 1.0, 1.0, 1.0])
    first = np.linalg.solve(normal, np.broadcast_to(np.eye(4)[:, :1], (len(normal), 4, 1)))[:, :, 0]
    return np.einsum("nki,ni->nk", weighted, first)
