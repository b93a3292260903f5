"""Thickness of skin and subcutaneous fat below a point on the skin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.imaging.volume import Volume
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array

_PATCH = 6.0  # mm: radius around a point over which normal and thickness are averaged
_DEEPEST = 60.0  # mm
_STEP = 0.25  # mm
_SKIN = 5.0  # mm: largest depth at which the fat begins
_GAP = 2.0  # mm: a gap in the fat (septum, vein) up to this width does not end it


@dataclass(frozen=True)
class Layers:
    """Median thickness (mm) of skin (dark, outer) and fat along the inward normal."""

    skin: float
    fat: float


def layers_at(position: Array, skin: Triangles, fat: Volume) -> Layers | None:
    """Thickness of skin and subcutaneous fat at the skin point nearest to a position.

    Medians over the skin within 6 mm, along the mean normal there; None if most of the rays meet no fat near
    the skin (thin skin over bone, or a marker's shadow).

    position : patient LPS (3,), mm;  fat : Volume of bool
    """
    nearest = skin.points[np.argmin(np.linalg.norm(skin.points - position, axis=1))]
    near = np.linalg.norm(skin.centroids - nearest, axis=1) < _PATCH
    normal = skin.area_vectors[near].sum(axis=0)
    normal /= np.linalg.norm(normal)
    depth = np.arange(0.0, _DEEPEST, _STEP)
    rays = skin.centroids[near][:, None, :] - depth[:, None] * normal
    index = fat.to_voxel(rays.reshape(-1, 3)).T
    inside = ndimage.map_coordinates(fat.values.astype(np.float32), index, order=1).reshape(rays.shape[:2])
    found = np.array([run for run in map(_first_run, inside > 0.5) if run is not None])
    if len(found) < 0.5 * len(inside):
        return None
    start, end = np.median(found, axis=0)
    return Layers(float(start), float(end - start))


def _first_run(fat: NDArray[np.bool_]) -> tuple[float, float] | None:
    """Start and end (mm) of the first run of fat along a ray; short gaps do not end it.

    >>> ray = np.zeros(100, bool); ray[6:20] = True; ray[22:30] = True; ray[60:70] = True
    >>> _first_run(ray)
    (1.5, 7.5)
    """
    where = np.flatnonzero(fat)
    if not len(where) or where[0] * _STEP > _SKIN:
        return None
    breaks = np.flatnonzero(np.diff(where) * _STEP > _GAP)
    last = where[breaks[0]] if len(breaks) else where[-1]
    return float(where[0] * _STEP), float((last + 1) * _STEP)
