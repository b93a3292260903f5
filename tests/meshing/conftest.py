"""Limb-like shapes with known sizes."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.meshing.mending import Limb, mend
from limbcli.meshing.surfaces import Triangles


def tube(
    bottom: tuple[float, float, float], top: tuple[float, float, float], radii: tuple[float, float],
    *, around: int = 40, along: int = 30, closed: bool = True
) -> Triangles:  # fmt: skip
    """A tapered cylinder with flat ends, normals outward."""
    a, b = np.array(bottom), np.array(top)
    axis = (b - a) / np.linalg.norm(b - a)
    u = np.cross(axis, [1.0, 0.2, 0.1])
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    t = np.linspace(0, 2 * np.pi, around, endpoint=False)
    ring = np.cos(t)[:, None] * u + np.sin(t)[:, None] * v
    levels = np.linspace(0, 1, along + 1)
    points = [a + s * (b - a) + (radii[0] + s * (radii[1] - radii[0])) * ring for s in levels]
    faces = []
    for k in range(along):
        for i in range(around):
            p, q = k * around + i, k * around + (i + 1) % around
            faces += [(p, q, q + around), (p, q + around, p + around)]
    if closed:
        n = (along + 1) * around
        points += [a[None], b[None]]
        faces += [(n, (i + 1) % around, i) for i in range(around)]
        faces += [(n + 1, along * around + i, along * around + (i + 1) % around) for i in range(around)]
    return Triangles(np.vstack(points), np.array(faces, np.int64))


def cylinder(
    radius: float, low: float, high: float, centre: tuple[float, float] = (0.0, 0.0), *, around: int = 32
) -> Triangles:
    """Along z, closed by lids."""
    return tube((*centre, low), (*centre, high), (radius, radius), around=around, along=24)


def ball(centre: tuple[float, float, float], radius: float, *, n: int = 24) -> Triangles:
    """A sphere of 2 n (2 n - 2) triangles."""
    t = np.linspace(0, np.pi, n + 1)
    p = np.linspace(0, 2 * np.pi, 2 * n, endpoint=False)
    rows = [np.c_[np.sin(a) * np.cos(p), np.sin(a) * np.sin(p), np.full(2 * n, np.cos(a))] for a in t[1:-1]]
    points = np.vstack([*rows, [[0, 0, 1]], [[0, 0, -1]]])
    m, top, bottom = 2 * n, (n - 1) * 2 * n, (n - 1) * 2 * n + 1
    faces = [(top, i, (i + 1) % m) for i in range(m)]
    last = (n - 2) * m
    faces += [(bottom, last + (i + 1) % m, last + i) for i in range(m)]
    for k in range(n - 2):
        for i in range(m):
            a, b = k * m + i, k * m + (i + 1) % m
            faces += [(a, a + m, b + m), (a, b + m, b)]
    return Triangles(radius * points + np.array(centre), np.array(faces, np.int64))


@pytest.fixture(scope="session")
def make_tube():
    return tube


@pytest.fixture(scope="session")
def make_ball():
    return ball


@pytest.fixture(scope="session")
def leg() -> Limb:
    """Tapering limb, 45 mm radius at the top (z = 100), 35 mm at the bottom, with two bones right through."""
    skin = tube((0, 0, -100), (0, 0, 100), (35, 45))
    tibia = tube((8, -14, -120), (8, -14, 120), (10, 12))
    fibula = tube((-18, 2, -120), (-18, 2, 120), (5, 6), around=24)
    return mend(skin, [tibia, fibula])
