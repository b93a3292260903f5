"""Signed distance to a surface on a regular grid: the representation in which any surface can be repaired.

Inside and outside are distinguished by counting the oriented faces crossed by rays along x, y and z; two of
the three directions decide. Gaps, overlaps and self-intersections of the input are therefore harmless, and
unions, clearances and offsets are minima and maxima of distance fields.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array
from limbcli.numbers.compiled import njit

_BAND = 3.0  # half width, in voxels, of the band round the surface in which distances are exact
_ROUNDING = 1e-9  # of squared distances, grid units
_FAR = 1e6
# grid of `Heights`: cells along a body's longest side, and margin round the body, mm
_CELLS, _MARGIN_MM = 90, 8.0
_JITTER = 1.2345e-5  # voxels; offset of the rays, which must not run through edges of regular meshes


@dataclass(frozen=True, eq=False)
class Grid:
    """A regular grid: origin (3,) of its first sample and spacing, both mm, and its shape."""

    origin: Array
    spacing: float
    shape: tuple[int, int, int]

    def points(self) -> Array:
        """(nx, ny, nz, 3)"""
        axes = [o + self.spacing * np.arange(n) for o, n in zip(self.origin, self.shape, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    @property
    def box(self) -> tuple[Array, Array]:
        """Low and high corner (3,)."""
        return self.origin, self.origin + self.spacing * (np.array(self.shape) - 1)

    def axis(self, k: int) -> Array:
        return self.origin[k] + self.spacing * np.arange(self.shape[k])

    def near(self, places: Array, reach: float) -> NDArray[np.bool_]:
        """Which samples (nx, ny, nz) are less than `reach` mm from one of some places (n, 3)."""
        found = np.zeros(self.shape, bool)
        for place in np.asarray(places, float):
            at = (place - self.origin) / self.spacing
            low, high = np.floor(at - reach / self.spacing), np.ceil(at + reach / self.spacing) + 1
            box = tuple(slice(max(int(a), 0), max(int(b), 0)) for a, b in zip(low, high, strict=True))
            x, y, z = ((self.axis(k)[box[k]] - place[k]) ** 2 for k in range(3))
            found[box] |= x[:, None, None] + y[:, None] + z < reach**2
        return found


def grid_over(low: Array, high: Array, spacing: float) -> Grid:
    """The grid that covers the box from low to high (3,)."""
    n = np.ceil((np.asarray(high) - low) / spacing).astype(int) + 1
    return Grid(np.asarray(low, float), spacing, (int(n[0]), int(n[1]), int(n[2])))


@dataclass(frozen=True, eq=False)
class Field:
    """A scalar field on a grid, values (nx, ny, nz); a signed distance is negative inside."""

    grid: Grid
    values: Array

    def at(self, points: Array) -> Array:
        """Trilinear interpolation at points (n, 3); outside the grid, the value at its border."""
        at = (np.asarray(points, float) - self.grid.origin).T / self.grid.spacing
        return ndimage.map_coordinates(self.values, at, order=1, mode="nearest", output=np.float64)

    def gradient(self, points: Array) -> Array:
        """Gradient (n, 3) by central differences over one grid spacing."""
        h = 0.5 * self.grid.spacing
        steps = [h * np.eye(3)[k] for k in range(3)]
        return np.stack([(self.at(points + s) - self.at(points - s)) / (2 * h) for s in steps], axis=1)

    def with_values(self, values: Array) -> Field:
        return replace(self, values=values)

    def project(self, points: Array) -> Array:
        """Points moved along the gradient onto the zero level."""
        x = np.array(points, float)
        for _ in range(4):
            g = self.gradient(x)
            step = self.at(x) / np.maximum(np.einsum("ij,ij->i", g, g), 0.05)
            x -= np.clip(step, -2.0, 2.0)[:, None] * g
        return x


def signed_distance(surface: Triangles, grid: Grid) -> Field:
    """Distance (mm) to a closed surface at every sample, negative inside.

    Exact within three grid spacings of the surface, by first-order fast sweeping beyond.
    """
    corners = np.ascontiguousarray((surface.corners - grid.origin) / grid.spacing)
    near = _near_distance(corners, grid.shape, _BAND)
    inside = winding(corners, grid.shape) > 0
    distance = _swept(np.where(near < _BAND, near, _FAR), near < _BAND)
    return Field(grid, np.where(inside, -distance, distance) * grid.spacing)


class Heights:
    """Signed distances of points to a closed surface.

    They are interpolated on a grid in and around the surface; beyond the grid, the nearest points are used.
    """

    def __init__(self, surface: Triangles):
        low, high = surface.points.min(axis=0), surface.points.max(axis=0)
        spacing = float(max((high - low).max() / _CELLS, 0.5))
        self._box = low - _MARGIN_MM, high + _MARGIN_MM
        self._distance = signed_distance(surface, grid_over(*self._box, spacing))
        self._surface = surface

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(np.concatenate([self._surface.points, self._surface.centroids]))

    def of(self, points: Array) -> Array:
        """Signed distances (n,), mm, of points (n, 3); negative inside."""
        low, high = self._box
        near = ((points > low) & (points < high)).all(axis=1)
        found = self._distance.at(points)
        if not near.all():
            found[~near] = self._tree.query(points[~near])[0]
        return found

    def deepest(self, share: float) -> Array:
        """Samples (n, 3) deeper than this fraction of the body's greatest depth; none if it is flat."""
        values = self._distance.values
        inside = (values < 0) & (values < share * values.min())
        return self._distance.grid.points()[inside]


def winding(corners: Array, shape: tuple[int, int, int]) -> Array:
    """Winding number of a surface (corners in grid units) at each sample: the median of three ray directions.

    Where part of the surface is inverted or missing, the rays that cross it are outvoted.
    """
    counts = np.empty((3, *shape), np.int32)
    for k in range(3):
        order = [k, (k + 1) % 3, (k + 2) % 3]
        rays = _crossings(np.ascontiguousarray(corners[:, :, order]), *(shape[i] for i in order), _JITTER)  # type: ignore[call-arg]
        counts[k] = np.moveaxis(np.cumsum(rays, axis=0, dtype=np.int32), [0, 1, 2], order)
    low, high = np.minimum(counts[0], counts[1]), np.maximum(counts[0], counts[1])
    return np.maximum(low, np.minimum(high, counts[2]))


def rounded(field: Field, radius: float) -> Field:
    """The body with clefts narrower than twice `radius` filled (a morphological closing)."""
    if radius <= 0:
        return field
    grown = distance_again(field.with_values(field.values - radius))
    return field.with_values(np.minimum(grown.values + radius, field.values))


def distance_again(field: Field) -> Field:
    """True signed distance to a field's zero level, by fast sweeping from the adjacent samples."""
    values = np.ascontiguousarray(field.values / field.grid.spacing)
    # anchored at the samples adjacent to the zero level
    d = _anchors(values)
    d = _swept(d, d < _FAR)
    return field.with_values(np.where(values <= 0, -d, d) * field.grid.spacing)


def _swept(distance: Array, anchored: Array) -> Array:
    """Distances from the anchored samples to all others, by first-order fast sweeping of |grad d| = 1."""
    padded = np.pad(distance, 1, constant_values=_FAR)
    _sweep(padded, anchored)
    return padded[1:-1, 1:-1, 1:-1]


# ---------------------------------------------------------------- kernels


@njit
def _near_distance(corners: Any, shape: Any, band: float) -> Any:
    nx, ny, nz = shape
    best = np.full((nx, ny, nz), band * band)
    for t in range(corners.shape[0]):
        a0, a1, a2 = corners[t, 0]
        b0, b1, b2 = corners[t, 1]
        c0, c1, c2 = corners[t, 2]
        i0, i1 = _reach(a0, b0, c0, band, nx)
        j0, j1 = _reach(a1, b1, c1, band, ny)
        k0, k1 = _reach(a2, b2, c2, band, nz)
        u, v = (b0 - a0, b1 - a1, b2 - a2), (c0 - a0, c1 - a1, c2 - a2)
        n0, n1, n2 = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        size = max(np.sqrt(n0 * n0 + n1 * n1 + n2 * n2), 1e-12)
        a, b, c = (a0, a1, a2), (b0, b1, b2), (c0, c1, c2)
        # The triangle lies in a ball; a sample at distance q from its centre and h from the plane is at
        # least sqrt(q^2 - h^2) - radius away within the plane, whose square exceeds (q^2 - h^2)/2 - radius^2.
        m0, m1, m2 = (a0 + b0 + c0) / 3, (a1 + b1 + c1) / 3, (a2 + b2 + c2) / 3
        m = m0, m1, m2
        radius = max(
            _dot(_less(a, m), _less(a, m)), _dot(_less(b, m), _less(b, m)), _dot(_less(c, m), _less(c, m))
        )
        reach = (band + np.sqrt(radius)) ** 2
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                aside = (i - m0) ** 2 + (j - m1) ** 2
                if aside > reach:
                    continue
                half = np.sqrt(reach - aside)
                for k in range(max(k0, int(np.ceil(m2 - half))), min(k1, int(np.floor(m2 + half))) + 1):
                    height = (n0 * (i - a0) + n1 * (j - a1) + n2 * (k - a2)) / size
                    least = 0.5 * (height * height + aside + (k - m2) ** 2) - radius
                    if max(height * height, least - _ROUNDING) < best[i, j, k]:
                        d = _squared_distance((float(i), float(j), float(k)), a, b, c)
                        if d < best[i, j, k]:
                            best[i, j, k] = d
    return np.sqrt(best)


@njit
def _reach(a: float, b: float, c: float, band: float, n: int) -> Any:
    """First and last sample along an axis within the band around three coordinates."""
    return max(0, int(np.ceil(min(a, b, c) - band))), min(n - 1, int(np.floor(max(a, b, c) + band)))


@njit
def _dot(u: Any, v: Any) -> float:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@njit
def _less(u: Any, v: Any) -> Any:
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


@njit
def _to_segment(p: Any, a: Any, b: Any) -> float:
    e, w = _less(b, a), _less(p, a)
    s = _dot(e, e)
    t = _dot(w, e) / s if s > 0 else 0.0
    t = min(1.0, max(0.0, t))
    return (w[0] - t * e[0]) ** 2 + (w[1] - t * e[1]) ** 2 + (w[2] - t * e[2]) ** 2


@njit
def _squared_distance(p: Any, a: Any, b: Any, c: Any) -> float:
    """Squared distance of a point to a triangle; points are tuples of three numbers, to avoid allocation."""
    u, v, w = _less(b, a), _less(c, a), _less(p, a)
    uu, uv, vv, wu, wv = _dot(u, u), _dot(u, v), _dot(v, v), _dot(w, u), _dot(w, v)
    d = uu * vv - uv * uv
    if d > 1e-14:
        s = (vv * wu - uv * wv) / d
        t = (uu * wv - uv * wu) / d
        if s >= 0 and t >= 0 and s + t <= 1:
            r = w[0] - s * u[0] - t * v[0], w[1] - s * u[1] - t * v[1], w[2] - s * u[2] - t * v[2]
            return _dot(r, r)
    return min(_to_segment(p, a, b), _to_segment(p, b, c), _to_segment(p, c, a))


@njit
def _crossings(corners: Any, nx: int, ny: int, nz: int, jitter: float) -> Any:
    """Signed number of faces crossed by rays along the first axis, booked at the first sample beyond each."""
    count = np.zeros((nx, ny, nz), np.int16)
    for t in range(corners.shape[0]):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        area = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
        if area == 0:
            continue
        j0 = max(0, int(np.ceil(min(a[1], b[1], c[1]) - jitter)))
        j1 = min(ny - 1, int(np.floor(max(a[1], b[1], c[1]) - jitter)))
        k0 = max(0, int(np.ceil(min(a[2], b[2], c[2]) - 2 * jitter)))
        k1 = min(nz - 1, int(np.floor(max(a[2], b[2], c[2]) - 2 * jitter)))
        for j in range(j0, j1 + 1):
            for k in range(k0, k1 + 1):
                y, z = j + jitter, k + 2 * jitter
                s = ((y - a[1]) * (c[2] - a[2]) - (z - a[2]) * (c[1] - a[1])) / area
                r = ((b[1] - a[1]) * (z - a[2]) - (b[2] - a[2]) * (y - a[1])) / area
                if s < 0 or r < 0 or s + r > 1:
                    continue
                x = a[0] + s * (b[0] - a[0]) + r * (c[0] - a[0])
                i = max(0, int(np.ceil(x)))
                if i < nx:
                    count[i, j, k] += -1 if area > 0 else 1
    return count


@njit
def _anchors(phi: Any) -> Any:
    """Distance of samples adjacent to the zero level, from its crossings with the axes; `_FAR` elsewhere."""
    nx, ny, nz = phi.shape
    d = np.full(phi.shape, _FAR)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                f = phi[i, j, k]
                inverse = 0.0
                for axis in range(3):
                    best = _FAR
                    for step in (-1, 1):
                        a = i + (step if axis == 0 else 0)
                        b = j + (step if axis == 1 else 0)
                        c = k + (step if axis == 2 else 0)
                        if 0 <= a < nx and 0 <= b < ny and 0 <= c < nz:
                            g = phi[a, b, c]
                            if (f <= 0) != (g <= 0):
                                best = min(best, abs(f) / max(abs(f - g), 1e-12))
                    if best < _FAR:
                        inverse += 1.0 / max(best, 1e-9) ** 2
                if inverse > 0:
                    d[i, j, k] = 1.0 / np.sqrt(inverse)
    return d


@njit
def _sweep(w: Any, anchored: Any) -> None:
    """Fast sweeping, in place, of distances with a border of one sample on every side.

    Each layer is swept by its diagonals: of their samples none needs another, so a processor overlaps them.
    """
    nx, ny, nz = anchored.shape
    for corner in range(8):
        i0, di = (1, 1) if corner & 1 else (nx, -1)
        j0, dj = (1, 1) if corner & 2 else (ny, -1)
        k0, dk = (1, 1) if corner & 4 else (nz, -1)
        for layer in range(nx):
            i = i0 + di * layer
            for diagonal in range(ny + nz - 1):
                for n in range(max(0, diagonal - nz + 1), min(ny, diagonal + 1)):
                    j, k = j0 + dj * n, k0 + dk * (diagonal - n)
                    if not anchored[i - 1, j - 1, k - 1]:
                        x = min(w[i - 1, j, k], w[i + 1, j, k])
                        y = min(w[i, j - 1, k], w[i, j + 1, k])
                        z = min(w[i, j, k - 1], w[i, j, k + 1])
                        w[i, j, k] = min(w[i, j, k], _eikonal(x, y, z))


@njit
def _eikonal(x: float, y: float, z: float) -> float:
    """Upwind solution of |grad d| = 1 from the smaller neighbour along each of three axes."""
    a, c = min(x, y, z), max(x, y, z)
    b = x + y + z - a - c
    d = a + 1.0
    if d > b:
        s = 2.0 - (a - b) ** 2
        d = 0.5 * (a + b + np.sqrt(max(s, 0.0)))
        if d > c:
            total = a + b + c
            s = total * total - 3.0 * (a * a + b * b + c * c - 1.0)
            d = (total + np.sqrt(max(s, 0.0))) / 3.0
    return d
