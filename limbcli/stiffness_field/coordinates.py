"""Anatomical coordinates of points in a limb: height along it, angle around it, depth from skin to bone.

    height  mm along the limb's axis from the distal end of its skin, towards proximal
    angle   rad around the limb's centre line: 0 anterior, pi/2 towards the patient's left (LPS)
    depth   skin / (skin + bone): 0 on the skin, 1 on the nearest bone; skin and bone are distances (mm) to
            the nearest point of the skin and of any bone. Without a bone, the distance to the centre line
            takes its place.

The centre line joins the middles of the skin's sections across the axis, smoothed along it. On it the angle
is undefined; so that a field stays continuous there, the angle enters a kernel as the vector
s (cos, sin) with s = r / sqrt(r^2 + r0^2), r the distance from the centre line: of length 1 but near it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from limbcli.errors import MeshError
from limbcli.meshing.sections import middle_of, section
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array

_ANTERIOR = np.array([0.0, -1.0, 0.0])  # LPS
_STEP, _SMOOTHING = 5.0, 10.0  # mm: distance of the sections, and standard deviation of their smoothing
_CORE = 5.0  # mm, r0: within about this distance of the centre line the angle loses its meaning
_SPACING = 2.0  # mm, largest distance of the samples of a surface from which distances are measured
# The flat closure of the limb's proximal end is not skin: faces along the axis within this distance (mm) of
# the top.
_CAP_COSINE, _CAP_MM = 0.95, 4.0


@dataclass(frozen=True, eq=False)
class AnatomicalPlaces:
    """Anatomical coordinates of n points: `height` (mm), `around` (n, 2), `depth` (0 to 1), all by point.

    around : s (cos angle, sin angle)
    """

    height: Array
    around: Array
    depth: Array

    def __len__(self) -> int:
        return len(self.height)

    @property
    def angle(self) -> Array:
        """Angle around the limb (n,), rad, -pi to pi."""
        return np.arctan2(self.around[:, 1], self.around[:, 0])

    def part(self, which: Array | slice) -> AnatomicalPlaces:
        return AnatomicalPlaces(self.height[which], self.around[which], self.depth[which])


def joined(several: Sequence[AnatomicalPlaces]) -> AnatomicalPlaces:
    """Places one after another."""
    return AnatomicalPlaces(
        np.concatenate([each.height for each in several]),
        np.concatenate([each.around for each in several]),
        np.concatenate([each.depth for each in several]),
    )


@dataclass(frozen=True, eq=False)
class LimbCoordinates:
    """Skin, bones and axis of one limb, prepared for the coordinates of any points in it.

    axis : unit vector (3,) towards proximal
    distal : height of the distal end along the axis, mm
    heights, centres : (k,) mm and (k, 2) mm, the centre line in the plane of `across`
    across : (2, 3) unit vectors perpendicular to the axis: anterior, and the patient's left
    """

    axis: Array
    distal: float
    heights: Array
    centres: Array
    across: Array
    skin: cKDTree
    bone: cKDTree | None

    def places(self, points: Array | AnatomicalPlaces) -> AnatomicalPlaces:
        """Anatomical coordinates of points (n, 3), mm, in the frame of the surfaces; places as they are.

        Points are taken as lying in the soft tissue: the depth of those outside the skin or within a bone is
        that of their distances all the same.
        """
        if isinstance(points, AnatomicalPlaces):
            return points
        points = np.asarray(points, float).reshape(-1, 3)
        height = points @ self.axis - self.distal
        centre = np.stack([np.interp(height, self.heights, each) for each in self.centres.T], axis=1)
        offset = points @ self.across.T - centre
        r = np.linalg.norm(offset, axis=1)
        around = offset / np.sqrt(r * r + _CORE**2)[:, None]
        from_skin = self.skin.query(points)[0]
        inner = r if self.bone is None else self.bone.query(points)[0]
        return AnatomicalPlaces(height, around, from_skin / np.maximum(from_skin + inner, 1e-9))


def limb_coordinates(
    skin: Triangles, bones: Sequence[Triangles], axis: Array, *, where: str = "limb"
) -> LimbCoordinates:
    """Prepare the coordinates of one limb.

    skin, bones : open or closed surfaces in one frame, mm; the flat closure of the proximal end is left out
    axis : (3,) along the limb towards proximal

    Raises MeshError if the axis has no direction, or does not run along the skin.
    """
    size = float(np.linalg.norm(axis))
    if not np.isfinite(size) or size < 1e-9:
        raise MeshError(
            "the limb's axis has no direction", where=where, fix="give a vector along the limb, to proximal"
        )
    axis = np.asarray(axis, float) / size
    front = _ANTERIOR - (_ANTERIOR @ axis) * axis
    if np.linalg.norm(front) < 0.1:  # the limb lies along y: its front is then taken towards the head
        front = np.array([0.0, 0.0, 1.0]) - axis[2] * axis
    front = front / np.linalg.norm(front)
    across = np.stack([front, np.cross(axis, front)])
    along = skin.points @ axis
    heights, centres = _centre_line(skin, axis, across, float(along.min()), float(along.max()), where)
    facing = (skin.area_vectors @ axis) / np.maximum(skin.areas, 1e-12)
    height = skin.centroids @ axis
    cap = (np.abs(facing) > _CAP_COSINE) & (height > height.max() - _CAP_MM)  # flat, at the proximal end
    wall = skin.part(~cap)
    inner = cKDTree(np.concatenate([_samples(each) for each in bones])) if len(bones) else None
    return LimbCoordinates(axis, float(along.min()), heights, centres, across, cKDTree(_samples(wall)), inner)


def _centre_line(
    skin: Triangles, axis: Array, across: Array, low: float, high: float, where: str
) -> tuple[Array, Array]:
    """Heights above the distal end (k,), and the smoothed middles (k, 2) of the skin's sections there."""
    found, middles = [], []
    for height in np.arange(low + 0.5 * _STEP, high, _STEP):
        pieces = section(skin, height * axis, axis)
        if len(pieces):
            found.append(height - low)
            middles.append(across @ middle_of(pieces))
    if len(found) < 2:
        raise MeshError(
            f"the skin reaches only {high - low:.3g} mm along the limb's axis",
            where=where,
            fix="give the surfaces in mm, and the axis along the limb",
        )
    smooth = gaussian_filter1d(np.array(middles), _SMOOTHING / _STEP, axis=0, mode="nearest")
    return np.array(found), np.asarray(smooth, float)


def _samples(surface: Triangles) -> Array:
    """Points (n, 3) of a surface, at most about `_SPACING` apart."""
    corners = surface.corners
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    parts = np.clip(np.ceil(longest / _SPACING), 1, 60).astype(int)
    out = [surface.points]
    for n in np.unique(parts):
        i, j = (each.ravel() for each in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
        keep = i + j < n
        u, v = (i[keep] + 1 / 3) / n, (j[keep] + 1 / 3) / n
        a, b, c = np.moveaxis(corners[parts == n], 1, 0)
        inner = a[:, None] + u[:, None] * (b - a)[:, None] + v[:, None] * (c - a)[:, None]
        out.append(inner.reshape(-1, 3))
    return np.concatenate(out)
