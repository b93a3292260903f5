"""The nearest points of a triangle surface, by its nearest facets."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array, IntArray

_CANDIDATES = 12  # facets whose centroids are nearest


class NearestPoints:
    """Finds the nearest point of a surface among the facets with the nearest centroids."""

    def __init__(self, surface: Triangles):
        self.surface = surface
        self._tree = cKDTree(surface.centroids)
        size = np.linalg.norm(surface.area_vectors, axis=1)
        self._normals = surface.area_vectors / np.maximum(size, 1e-300)[:, None]
        self._corners = surface.corners

    def of(self, points: Array) -> tuple[Array, IntArray]:
        """(nearest points (n, 3), their facets (n,)) of points (n, 3)."""
        k = min(_CANDIDATES, len(self._corners))
        _, found = self._tree.query(points, k=k)
        found = np.asarray(found, dtype=np.int64).reshape(len(points), k)
        nearest = on_triangles(points[:, None], self._corners[found])
        best = np.argmin(((nearest - points[:, None]) ** 2).sum(axis=2), axis=1)
        rows = np.arange(len(points))
        return nearest[rows, best], found[rows, best]

    def clearances(self, points: Array) -> Array:
        """Signed distances (n,), mm: positive on the side to which the facets' normals point."""
        nearest, facets = self.of(points)
        away = points - nearest
        side = np.einsum("ij,ij->i", away, self._normals[facets])
        return np.asarray(np.sign(side) * np.linalg.norm(away, axis=1))


def on_triangles(points: Array, corners: Array) -> Array:
    """The point of each triangle nearest to a point: (..., 3) for points (..., 3) and corners (..., 3, 3).

    The projection if it lies within the triangle, else the nearest point of the three sides.

    >>> on_triangles(np.array([2.0, 0.5, 1.0]), np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])).tolist()
    [1.0, 0.0, 0.0]
    """
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    u, v, w = b - a, c - a, points - a
    uu, uv, vv, uw, vw = ((p * q).sum(-1) for p, q in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    det = np.maximum(uu * vv - uv * uv, 1e-300)
    s, t = (vv * uw - uv * vw) / det, (uu * vw - uv * uw) / det
    inside = (s >= 0) & (t >= 0) & (s + t <= 1)
    best = a + s[..., None] * u + t[..., None] * v
    least = np.where(inside, 0.0, np.inf)
    for begin, end in ((a, b), (b, c), (c, a)):
        d = end - begin
        part = np.clip(((points - begin) * d).sum(-1) / np.maximum((d * d).sum(-1), 1e-300), 0.0, 1.0)
        at = begin + part[..., None] * d
        size = ((points - at) ** 2).sum(-1)
        nearer = size < least
        best, least = np.where(nearer[..., None], at, best), np.where(nearer, size, least)
    return np.asarray(best)
