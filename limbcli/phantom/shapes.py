"""Implicit shapes: f < 0 inside, f = 0 on the surface, f approximates the distance (mm) near it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from limbcli.model import Array

Implicit = Callable[[Array], Array]
_NEWTON_STEPS = 6


def rounded_intersection(a: Array, b: Array, *, radius: float) -> Array:
    """Intersection of two shapes, with the edge where they meet rounded to `radius`.

    >>> rounded_intersection(np.array([-5.0, -1.0]), np.array([-5.0, -1.0]), radius=2.0).round(3)
    array([-5.   , -0.586])
    """
    inner = np.minimum(np.maximum(a, b) + radius, 0.0)
    return inner + np.hypot(np.maximum(a + radius, 0.0), np.maximum(b + radius, 0.0)) - radius


def capsule(points: Array, start: Array, end: Array, radius: float) -> Array:
    """Distance to a capsule: a cylinder with round ends around the segment start-end (exact).

    >>> capsule(np.array([[3.0, 0, 0], [0, 0, 9.0]]), np.zeros(3), np.array([0, 0, 5.0]), 2.0)
    array([1., 2.])
    """
    axis = end - start
    along = np.clip((points - start) @ axis / (axis @ axis), 0.0, 1.0)
    return np.linalg.norm(points - start - along[:, None] * axis, axis=1) - radius


def gradient(shape: Implicit, points: Array, *, step: float = 1e-3) -> Array:
    """Central differences of an implicit shape, (n, 3)."""
    columns = []
    for axis in range(3):
        offset = np.zeros(3)
        offset[axis] = step
        columns.append((shape(points + offset) - shape(points - offset)) / (2.0 * step))
    return np.stack(columns, axis=1)


def project(shape: Implicit, points: Array) -> Array:
    """Points moved onto the surface f = 0 along its gradient (Newton's method)."""
    moved = np.array(points, dtype=float)
    for _ in range(_NEWTON_STEPS):
        slope = gradient(shape, moved)
        square = np.maximum(np.einsum("ij,ij->i", slope, slope), 1e-12)
        moved -= (shape(moved) / square)[:, None] * slope
    return moved
