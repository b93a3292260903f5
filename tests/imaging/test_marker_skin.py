"""The bump that a marker leaves in the skin's outline."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from limbcli.imaging.marker_skin import without_bumps
from limbcli.imaging.markers import MarkerCapsule
from limbcli.meshing.surfaces import Triangles

RADIUS, LENGTH = 45.0, 80.0


def tube(bump: float, at: float = 0.3) -> tuple[Triangles, MarkerCapsule, np.ndarray]:
    """A limb of radius 45 mm along z, its sides only, with a bump 5 mm wide; and where that is."""
    rng = np.random.default_rng(7)
    grid = np.stack(np.meshgrid(np.arange(0, 2 * np.pi * RADIUS, 2.0), np.arange(0, LENGTH, 2.0)), -1)
    flat = grid.reshape(-1, 2) + 0.3 * rng.standard_normal((grid.size // 2, 2))
    triangles = Delaunay(flat).simplices
    angle, z = flat[:, 0] / RADIUS, flat[:, 1]
    away = np.hypot(RADIUS * (angle - at), z - LENGTH / 2)
    r = RADIUS + bump * np.exp(-((away / 5.0) ** 2))
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    place = (RADIUS + 4.0) * np.array([np.cos(at), np.sin(at), 0.0]) + [0, 0, LENGTH / 2]
    marker = MarkerCapsule(1, tuple(place.tolist()), 250.0)
    return Triangles(points, triangles.astype(np.int64)), marker, away


def radius(surface: Triangles) -> np.ndarray:
    return np.hypot(surface.points[:, 0], surface.points[:, 1])


def test_bump_under_a_marker_is_taken_off_and_the_rest_stays():
    skin, marker, away = tube(0.7)
    mended, moved = without_bumps(skin, [marker])
    assert moved[0] == pytest.approx(0.7, abs=0.12)
    assert np.abs(radius(mended) - RADIUS)[away < 8].max() < 0.12
    assert np.array_equal(mended.points[away > 20], skin.points[away > 20])
    assert mended.faces is skin.faces


def test_smooth_skin_is_left_where_it_is():
    skin, marker, _ = tube(0.0)
    mended, moved = without_bumps(skin, [marker])
    assert abs(moved[0]) < 0.05
    assert np.abs(mended.points - skin.points).max() < 0.1


def test_no_marker_no_change_and_a_mountain_is_no_marker():
    skin, marker, _ = tube(9.0)
    assert np.array_equal(without_bumps(skin, [])[0].points, skin.points)
    kept, moved = without_bumps(skin, [marker])
    assert moved == [0.0]
    assert np.array_equal(kept.points, skin.points)
