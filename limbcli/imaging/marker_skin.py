"""Reconstruct the skin under a marker from the surrounding skin.

A capsule and the skin it touches are equally bright, so that the outline has a bump of half a voxel or more
where the marker was; and that is exactly where the probe is placed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from limbcli.imaging.markers import BLUR_MM, MarkerCapsule
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array

_BLEND = 4.0  # mm: width of the transition to the unmodified outline
_RING = 8.0  # mm: width of the ring from which the skin is extrapolated
_FEWEST = 12
_LARGEST_MOVE = 4.0  # mm: a larger displacement of the skin is not due to a marker and is not made


def without_bumps(skin: Triangles, markers: Sequence[MarkerCapsule]) -> tuple[Triangles, list[float]]:
    """The skin with each marker's footprint projected onto a quadric fitted to the surrounding skin.

    Returns the surface with the same triangles; mm by which the skin at each marker was lowered (negative:
    raised)
    """
    points = skin.points.copy()
    normals = skin.point_normals
    moved = []
    for marker in markers:
        points, depth = _smoothed(points, normals, marker)
        moved.append(depth)
    return Triangles(points, skin.faces), moved


def _smoothed(points: Array, normals: Array, marker: MarkerCapsule) -> tuple[Array, float]:
    reach = (3.0 * marker.volume / (4.0 * np.pi)) ** (1 / 3) + BLUR_MM
    centre = np.array(marker.position)
    spot = int(np.argmin(np.linalg.norm(points - centre, axis=1)))
    near = np.flatnonzero(np.linalg.norm(points - points[spot], axis=1) < reach + _BLEND + _RING + 4.0)
    axis = normals[near].mean(axis=0)
    near = near[normals[near] @ axis > 0.3 * np.linalg.norm(axis)]
    x, y, z = _local(points[near] - points[spot], axis / np.linalg.norm(axis))
    away = np.hypot(x, y)
    ring = (away > reach + _BLEND / 2) & (away < reach + _BLEND / 2 + _RING)
    if ring.sum() < _FEWEST:
        return points, 0.0
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    quadric = np.linalg.lstsq(terms[ring], z[ring], rcond=None)[0]
    # 1 on the footprint, 0 beyond the transition, smooth in between
    t = np.clip((away - reach) / _BLEND, 0.0, 1.0)
    lowered = (z - terms @ quadric) * (1.0 - t * t * (3.0 - 2.0 * t))
    if np.abs(lowered).max() > _LARGEST_MOVE:
        return points, 0.0
    out = points.copy()
    out[near] -= np.outer(lowered, axis / np.linalg.norm(axis))
    return out, float(lowered[np.argmin(away)])


def _local(offsets: Array, axis: Array) -> tuple[Array, Array, Array]:
    """Coordinates along two directions perpendicular to `axis`, and along it."""
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    return offsets @ first, offsets @ np.cross(axis, first), offsets @ axis
