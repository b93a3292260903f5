"""The centre line of a limb, about which a socket is described."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from limbcli.errors import MeshError
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array

_SLAB_MM = 5.0
_LEAST_SLABS = 3


@dataclass(frozen=True, eq=False)
class CentreLine:
    """Centres of a limb's cross-sections.

    along : unit vector (3,) towards the limb's tip
    heights (n,) : mm along it, ascending; centres (n, 3), radii (n,) : of the skin in slabs there, mm
    """

    along: Array
    heights: Array
    centres: Array
    radii: Array

    def height(self, points: Array) -> Array:
        """Heights (n,), mm, of points (n, 3)."""
        return points @ self.along

    def nearest(self, points: Array) -> Array:
        """The centre (n, 3) that belongs to each point: at its height, but not within the rounded tip."""
        last = self.heights[-1] - min(self.radii.max(), 0.5 * np.ptp(self.heights))
        h = np.clip(self.height(points), self.heights[0], last)
        return np.stack([np.interp(h, self.heights, each) for each in self.centres.T], axis=1)

    def angles(self, points: Array) -> Array:
        """Angles (n,), rad, around the centre line, from an arbitrary direction."""
        first = np.eye(3)[int(np.argmin(np.abs(self.along)))]
        x = first - (first @ self.along) * self.along
        x /= np.linalg.norm(x)
        y = np.cross(self.along, x)
        d = points - np.stack(
            [np.interp(self.height(points), self.heights, each) for each in self.centres.T], axis=1
        )
        return np.asarray(np.arctan2(d @ y, d @ x))


def centre_line(skin: Triangles, toward_tip: Array) -> CentreLine:
    """The centre line of a limb's skin.

    toward_tip (3,) : direction along the limb, towards its tip

    Raises MeshError if the skin is shorter than three slabs of 5 mm: it is not in mm, or no limb.
    """
    along = np.asarray(toward_tip, dtype=float)
    along = along / np.linalg.norm(along)
    h, weight = skin.centroids @ along, skin.areas
    edges = np.arange(h.min(), h.max() + _SLAB_MM, _SLAB_MM)
    if len(edges) <= _LEAST_SLABS:
        raise MeshError(
            f"the limb is {np.ptp(h):.3g} mm long along its axis",
            where="skin of the limb",
            fix="give the skin in mm, and its axis towards the tip",
            length_mm=float(np.ptp(h)),
        )
    heights, centres, radii = [], [], []
    for low, high in itertools.pairwise(edges):
        # flat ends belong to no cross-section
        side = np.abs(skin.area_vectors @ along) < 0.9 * np.maximum(weight, 1e-300)
        inside = (h >= low) & (h < high) & side
        if inside.sum() < 3:
            continue
        centre = np.average(skin.centroids[inside], axis=0, weights=weight[inside])
        away = skin.centroids[inside] - centre
        away = away - np.outer(away @ along, along)
        heights.append(centre @ along)
        centres.append(centre)
        radii.append(float(np.average(np.linalg.norm(away, axis=1), weights=weight[inside])))
    order = np.argsort(heights)
    return CentreLine(along, np.array(heights)[order], np.array(centres)[order], np.array(radii)[order])


def own_line(socket: Triangles, *, where: str = "socket") -> CentreLine:
    """The centre line of a socket in its own frame, for its inner face before it is aligned with a limb.

    Of the principal axes through its centroid, that which meets the surface on one side only: the tip.

    Raises MeshError if it is not longer than three slabs of 5 mm, or if no axis leaves it through an opening:
    it is closed, or open at both ends.
    """
    weight = socket.areas
    middle = np.average(socket.centroids, axis=0, weights=weight)
    centred = socket.centroids - middle
    axes = np.linalg.eigh((centred * weight[:, None]).T @ centred)[1].T[::-1]  # the longest first
    for axis in axes:
        ahead, behind = _meets(socket, middle, axis), _meets(socket, middle, -axis)
        if ahead != behind:
            return centre_line(socket, axis if ahead else -axis)
    raise MeshError(
        "the socket does not show where the limb enters: it is closed, or open at both ends",
        where=where,
        fix="give its wall or inner face with the opening at the brim alone, or align it with at least "
        "three landmarks on limb and socket",
    )


def _meets(surface: Triangles, start: Array, along: Array) -> bool:
    """Whether a ray meets a surface.

    Source: Moeller and Trumbore 1997, J. Graphics Tools 2, 21.
    """
    a, b, c = np.moveaxis(surface.corners, 1, 0)
    u, v, w = b - a, c - a, start - a
    p = np.cross(along, v)
    det = (u * p).sum(axis=1)
    det = np.where(np.abs(det) > 1e-12, det, np.inf)
    s = (w * p).sum(axis=1) / det
    q = np.cross(w, u)
    t, way = (q @ along) / det, (v * q).sum(axis=1) / det
    return bool(((s >= 0) & (t >= 0) & (s + t <= 1) & (way > 0) & np.isfinite(det)).any())
