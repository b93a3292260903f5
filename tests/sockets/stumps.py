"""Limbs and sockets of simple shape: a tapered stump with a rounded tip at the bottom, open at the top."""

from __future__ import annotations

import numpy as np

from limbcli.meshing.surfaces import Triangles

DOWN = np.array([0.0, 0.0, -1.0])
LENGTH, RADIUS = 150.0, 50.0  # mm


def stump(
    *, grow: float = 0.0, top: float = LENGTH, n_around: int = 48, n_along: int = 40, oval: float = 0.15,
    bump: float = 6.0,
) -> Triangles:  # fmt: skip
    """Outward normals; `grow`: mm added to every radius; `bump` makes front and back differ."""
    t = np.linspace(0.0, 1.0, n_along + 1)[1:]
    z = top * t**1.5 - grow * (1 - t)
    radius = (RADIUS + grow + 0.1 * z) * np.sqrt(1 - np.clip(1 - z / 40.0, 0, 1) ** 2 * 0.98)
    angle = np.linspace(0.0, 2 * np.pi, n_around, endpoint=False)
    T, Z = np.meshgrid(angle, z)
    R = radius[:, None] * (1 + oval * np.cos(2 * T)) + bump * np.exp(-((T - np.pi / 2) ** 2) / 0.3)
    points = np.concatenate(
        [[[0.0, 0.0, -grow]], np.stack([R * np.cos(T), R * np.sin(T), Z], axis=-1).reshape(-1, 3)]
    )
    k = np.arange(n_around)
    after = (k + 1) % n_around
    faces = [np.stack([np.zeros_like(k), 1 + after, 1 + k], axis=1)]
    for row in range(n_along - 1):
        a, b = 1 + row * n_around + k, 1 + row * n_around + after
        c, d = a + n_around, b + n_around
        faces += [np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)]
    return Triangles(points, np.concatenate(faces).astype(np.int64))


def wall(*, inner: float = 0.0, thickness: float = 5.0, top: float = 110.0) -> Triangles:
    """A closed socket wall with outward normals; its inner face is the stump grown by `inner`."""
    inside = stump(grow=inner, top=top)
    outside = stump(grow=inner + thickness, top=top)
    n, ring = len(inside.points), 48
    k = np.arange(ring)
    a = n - ring + k
    b = n - ring + (k + 1) % ring
    brim = np.concatenate([np.stack([a, b + n, b], axis=1), np.stack([a, a + n, b + n], axis=1)])
    faces = np.concatenate([inside.faces[:, ::-1], outside.faces + n, brim[:, ::-1]])
    return Triangles(np.concatenate([inside.points, outside.points]), faces.astype(np.int64))
