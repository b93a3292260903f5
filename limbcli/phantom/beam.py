"""Depth of the bone below the probe's centre, along the beam."""

from __future__ import annotations

import numpy as np

from limbcli.model import Array, LimbModel, Surface


def skin_bone_distance(model: LimbModel) -> float | None:
    """Distance (mm) from skin to bone along z at x = y = 0; None if the beam meets no bone.

    Needs the surfaces "skin" and "bone" of a site's model.
    """
    surfaces = model.mesh.surfaces
    if "bone" not in surfaces or "skin" not in surfaces:
        return None
    skin = _heights(model.mesh.points, surfaces["skin"])
    bone = _heights(model.mesh.points, surfaces["bone"])
    if not len(skin) or not len(bone):
        return None
    top = float(skin.max())
    below = bone[bone < top]
    return top - float(below.max()) if len(below) else None


def _heights(points: Array, surface: Surface) -> Array:
    """z at which the line x = y = 0 crosses the facets (their corners' triangles), (n_crossings,)."""
    found = []
    for kind, facets in surface.facets.items():
        corners = (0, 1, 2) if kind.startswith("tri") else (0, 1, 2, 3)
        for k in range(1, len(corners) - 1):
            found.append(_crossings(points[facets[:, [0, k, k + 1]]]))
    return np.concatenate(found) if found else np.empty(0)


def _crossings(triangles: Array) -> Array:
    a, b, c = (triangles[:, k, :2] for k in range(3))
    whole = _cross(b - a, c - a)
    safe = np.where(whole == 0, 1.0, whole)
    shares = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1) / safe[:, None]
    hit = (whole != 0) & (shares >= -1e-9).all(axis=1)
    return np.asarray(np.einsum("nk,nk->n", shares[hit], triangles[hit, :, 2]))


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
