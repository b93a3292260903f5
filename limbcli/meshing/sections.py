"""Plane sections of a triangle surface: the intersection line and its centre."""

from __future__ import annotations

import numpy as np

from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array


def section(surface: Triangles, point: Array, normal: Array) -> Array:
    """Line segments (n, 2, 3), mm, in which the plane through a point (3,) intersects a surface."""
    height = (surface.points - point) @ normal
    height = np.where(np.abs(height) < 1e-9, 1e-9, height)
    of_face = height[surface.faces]
    cut = np.flatnonzero((of_face.min(axis=1) < 0) & (of_face.max(axis=1) > 0))
    corners, sides = surface.points[surface.faces[cut]], of_face[cut]
    found = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        crossed = sides[:, a] * sides[:, b] < 0
        share = sides[:, a] / np.where(crossed, sides[:, a] - sides[:, b], 1.0)
        here = corners[:, a] + share[:, None] * (corners[:, b] - corners[:, a])
        found.append(np.where(crossed[:, None], here, np.nan))
    ends = np.stack(found, axis=1)
    order = np.argsort(np.isnan(ends[:, :, 0]), axis=1, kind="stable")[:, :2]
    return np.take_along_axis(ends, order[:, :, None], axis=1)


def middle_of(pieces: Array) -> Array:
    """Length-weighted mean (3,) of line segments (n, 2, 3)."""
    lengths = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1)
    return np.asarray(np.average(pieces.mean(axis=1), axis=0, weights=lengths))
