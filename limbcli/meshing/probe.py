"""The rigid probe: a flat face with rounded edges, and side walls.

The face is a rectangle swept by a sphere: a flat (length - 2 r) x (width - 2 r)
in the middle, quarter cylinders of radius r along its sides, eighths of a
sphere at its corners, then vertical walls.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from limbcli.errors import CaseError
from limbcli.model import Array, IntArray

# Number of facets per quarter circle, and the radius (mm) up to which it suffices: the chords then deviate
# from the circle by at most 0.03 mm.
_ARC, _ARC_RADIUS = 6, 3.0


@dataclass(frozen=True)
class ProbeShape:
    """Dimensions of the face (mm): long side, short side, edge radius; height of the walls."""

    length: float
    width: float
    edge_radius: float
    wall: float = 20.0

    @property
    def flat(self) -> tuple[float, float]:
        """Half sides of the flat central part."""
        return self.length / 2 - self.edge_radius, self.width / 2 - self.edge_radius

    def rise(self, x: Array, y: Array) -> Array:
        """Height of the probe's underside above its face at plan points; NaN beside the probe.

        >>> ProbeShape(50, 14, 3).rise(np.array([0.0, 25, 30]), np.zeros(3))
        array([ 0.,  3., nan])
        """
        a, b = self.flat
        d = np.hypot(np.maximum(np.abs(x) - a, 0), np.maximum(np.abs(y) - b, 0))
        r = self.edge_radius
        with np.errstate(invalid="ignore"):
            height = r - np.sqrt(np.maximum(r * r - d * d, 0))
        return np.where(d <= r + 1e-9, height, np.nan)

    def plan(self, spacing: float) -> tuple[Array, Array]:
        """Points (n,), (n,) of a raster over the face."""
        x = np.linspace(-self.length / 2, self.length / 2, int(self.length / spacing) + 1)
        y = np.linspace(-self.width / 2, self.width / 2, int(self.width / spacing) + 1)
        gx, gy = np.meshgrid(x, y, indexing="ij")
        return gx.ravel(), gy.ravel()

    def distance_in_plan(self, x: Array, y: Array) -> Array:
        """Distance (mm) to the face's outline in plan; 0 inside."""
        a, b = self.flat
        d = np.hypot(np.maximum(np.abs(x) - a, 0), np.maximum(np.abs(y) - b, 0))
        return np.maximum(d - self.edge_radius, 0)


@dataclass(frozen=True, eq=False)
class PlacedProbe:
    """A probe on a limb; to_site (4, 4) leads from the limb's frame to that of the probe's site."""

    shape: ProbeShape
    to_site: Array = field(default_factory=lambda: np.eye(4))

    def beside_and_height(self, points: Array) -> tuple[Array, Array]:
        """Distance (...) to the face's outline in plan and height (...) above the face of points (..., 3)."""
        x, y, z = np.moveaxis(points @ self.to_site[:3, :3].T + self.to_site[:3, 3], -1, 0)
        return self.shape.distance_in_plan(x, y), z


def distance_to_faces(probes: Sequence[PlacedProbe], points: Array) -> Array:
    """Distance (...) of points (..., 3) to the nearest probe's face, above it in plan; inf without probes."""
    found = np.full(points.shape[:-1], np.inf)
    for each in probes:
        beside, height = each.beside_and_height(points)
        found = np.minimum(found, np.hypot(beside, np.minimum(height, 0.0)))
    return found


def check_shape(shape: ProbeShape, *, where: str = "[probe]") -> ProbeShape:
    """The shape, if it is valid.

    Raises CaseError if a side is not positive or the edge radius leaves no face.
    """
    if min(shape.length, shape.width) <= 0 or shape.edge_radius < 0:
        raise CaseError(
            "the probe's sides must be positive", where=where, fix="give length_mm and width_mm > 0"
        )
    if 2 * shape.edge_radius >= min(shape.length, shape.width):
        raise CaseError(
            f"edge radius {shape.edge_radius:g} mm leaves no flat face on a "
            f"{min(shape.length, shape.width):g} mm wide probe",
            where=where,
            fix="give edge_radius_mm below half of width_mm",
        )
    return shape


@dataclass(frozen=True, eq=False)
class ProbeMesh:
    """Facets of the probe with outward normals; z = 0 is the face. quads (n, 4), tips (m, 3)."""

    points: Array
    quads: IntArray
    tips: IntArray


def probe_mesh(shape: ProbeShape, *, size: float = 3.0) -> ProbeMesh:
    """The probe's surface in quadrilaterals, with triangles at the poles of the four corners.

    Facets are chords of the rounded edges; larger radii get more of them, so that the deviation stays the
    same.

    size : side length of the facets on flat parts (mm)
    """
    builder = _Builder()
    a, b = shape.flat
    xs = np.linspace(-a, a, max(2, round(2 * a / size) + 1))
    ys = np.linspace(-b, b, max(2, round(2 * b / size) + 1))
    builder.flat(xs, ys)
    r = shape.edge_radius
    arc = max(_ARC, int(np.ceil(_ARC * np.sqrt(r / _ARC_RADIUS))))
    up = np.linspace(0, np.pi / 2, arc + 1)
    walls = np.linspace(r, shape.wall, max(2, round((shape.wall - r) / 5.0) + 1))
    builder.rings(_rim(xs, ys, up), r, up, walls)
    return builder.mesh()


def _rim(xs: Array, ys: Array, up: Array) -> list[tuple[float, float, float]]:
    """Points on the outline of the flat part with the outward angle, once around counter-clockwise."""
    a, b = xs[-1], ys[-1]
    out: list[tuple[float, float, float]] = []
    sides = [
        ([(a, y) for y in ys], 0.0, (a, b)),
        ([(x, b) for x in xs[::-1]], 0.5 * np.pi, (-a, b)),
        ([(-a, y) for y in ys[::-1]], np.pi, (-a, -b)),
        ([(x, -b) for x in xs], 1.5 * np.pi, (a, -b)),
    ]
    for foot, angle, corner in sides:
        out += [(float(x), float(y), angle) for x, y in foot]
        out += [(float(corner[0]), float(corner[1]), angle + t) for t in up[1:-1]]
    return out


class _Builder:
    """Builds facets between points that are created only once."""

    def __init__(self) -> None:
        self._index: dict[tuple[int, int, int], int] = {}
        self._points: list[tuple[float, float, float]] = []
        self._quads: list[list[int]] = []
        self._tips: list[list[int]] = []

    def _point(self, x: float, y: float, z: float) -> int:
        key = (round(x * 1e6), round(y * 1e6), round(z * 1e6))
        if key not in self._index:
            self._index[key] = len(self._points)
            self._points.append((x, y, z))
        return self._index[key]

    def _facet(self, corners: list[int]) -> None:
        unique = list(dict.fromkeys(corners))
        if len(unique) == 4:
            self._quads.append(unique)
        elif len(unique) == 3:
            self._tips.append(unique)

    def flat(self, xs: Array, ys: Array) -> None:
        """The flat part of the face, seen from below."""
        numbers = [[self._point(float(x), float(y), 0.0) for y in ys] for x in xs]
        for left, right in itertools.pairwise(numbers):
            for j in range(len(ys) - 1):
                self._facet([left[j + 1], right[j + 1], right[j], left[j]])

    def rings(self, rim: list[tuple[float, float, float]], r: float, up: Array, walls: Array) -> None:
        """Rounded edge and walls: rings of points above one another around the rim."""
        heights = [(r * np.sin(t), r - r * np.cos(t)) for t in up] + [(r, float(z)) for z in walls[1:]]
        numbers = [
            [self._point(x + out * np.cos(t), y + out * np.sin(t), z) for x, y, t in rim]
            for out, z in heights
        ]
        for lower, upper in itertools.pairwise(numbers):
            for j in range(len(rim)):
                k = (j + 1) % len(rim)
                self._facet([lower[j], lower[k], upper[k], upper[j]])

    def mesh(self) -> ProbeMesh:
        quads = np.array(self._quads, np.int64).reshape(-1, 4)
        tips = np.array(self._tips, np.int64).reshape(-1, 3)
        return ProbeMesh(np.array(self._points), quads, tips)
