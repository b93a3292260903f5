"""The signed distance grid against closed forms."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from limbcli.meshing.distance import (
    _FAR,
    Field,
    _eikonal,
    _near_distance,
    _squared_distance,
    _swept,
    distance_again,
    grid_over,
    rounded,
    signed_distance,
)
from limbcli.meshing.surfaces import Triangles, join


@pytest.fixture(scope="module")
def grid():
    return grid_over(np.full(3, -20.0), np.full(3, 20.0), 1.0)


def test_distance_to_a_sphere(make_ball, grid):
    field = signed_distance(make_ball((0.2, -0.3, 0.1), 12.0, n=60), grid)
    exact = np.linalg.norm(grid.points() - [0.2, -0.3, 0.1], axis=-1) - 12.0
    near = np.abs(exact) < 2.5
    # Chords of 60 rows lie 12 (1 - cos(pi / 120)) = 0.004 mm inside the sphere.
    assert np.abs(field.values - exact)[near].max() < 0.02
    assert (np.sign(field.values) == np.sign(exact))[np.abs(exact) > 0.05].all()
    assert np.abs(field.values - exact).max() < 1.2


def test_samples_near_places_are_found(grid, rng):
    """Against all distances; places also lie beyond the grid."""
    places = rng.uniform(-26.0, 26.0, (12, 3))
    away = np.linalg.norm(grid.points()[..., None, :] - places, axis=-1).min(axis=-1)
    np.testing.assert_array_equal(grid.near(places, 4.3), away < 4.3)


def test_overlapping_bodies_are_one(make_ball, grid):
    field = signed_distance(join([make_ball((-4, 0, 0), 8.0), make_ball((4, 0, 0), 8.0)]), grid)
    places = np.array([[0.0, 0, 0], [10, 0, 0], [-10, 0, 0], [0, 10, 0]])
    assert (field.at(places) < 0).tolist() == [True, True, True, False]


def test_a_hole_does_not_turn_inside_out(make_ball, grid):
    ball = make_ball((0, 0, 0), 12.0)
    torn = ball.part(np.arange(len(ball.faces)) % 97 != 5)
    field = signed_distance(torn, grid)
    exact = np.linalg.norm(grid.points(), axis=-1) - 12.0
    wrong = np.sign(field.values) != np.sign(exact)
    assert wrong[np.abs(exact) > 2].mean() < 1e-3


def test_redistancing_keeps_the_surface_and_restores_unit_slope(grid):
    exact = np.linalg.norm(grid.points(), axis=-1) - 9.0
    again = distance_again(Field(grid, exact * (2 + np.sin(grid.points()[..., 0] / 5))))
    assert np.abs(again.values - exact)[np.abs(exact) < 6].max() < 0.6


def test_closing_fills_a_cleft_but_keeps_a_wide_gap(make_ball, grid):
    # Two balls 2 mm apart: a cleft narrower than 2 x 1.5 mm is filled, one wider is not.
    for gap, filled in ((2.0, True), (6.0, False)):
        balls = join([make_ball((-9 - gap / 2, 0, 0), 9.0), make_ball((9 + gap / 2, 0, 0), 9.0)])
        closed = rounded(signed_distance(balls, grid), 1.5)
        assert (closed.at(np.zeros((1, 3)))[0] < 0) == filled


def test_projection_lands_on_the_surface(make_ball, grid, rng):
    field = signed_distance(make_ball((0, 0, 0), 12.0, n=60), grid)
    points = rng.normal(size=(50, 3))
    points *= (12 + rng.uniform(-2, 2, 50))[:, None] / np.linalg.norm(points, axis=1)[:, None]
    assert np.linalg.norm(field.project(points), axis=1) == pytest.approx(np.full(50, 12.0), abs=0.05)


def test_a_patch_turned_inside_out_is_outvoted(make_ball, grid):
    ball = make_ball((0, 0, 0), 12.0)
    turned = ball.faces.copy()
    patch = ball.centroids[:, 2] > 11.5
    turned[patch] = turned[patch][:, ::-1]
    field = signed_distance(Triangles(ball.points, turned), grid)
    exact = np.linalg.norm(grid.points(), axis=-1) - 12.0
    assert (np.sign(field.values) == np.sign(exact))[np.abs(exact) > 1].all()


def test_distances_near_a_surface_are_the_least_to_any_triangle(rng):
    """Against all triangles: none that is passed over would have been nearer."""
    corners = 6.0 + rng.normal(0.0, (2.5, 2.0, 3.0), (14, 1, 3)) + rng.normal(0.0, 0.8, (14, 3, 3))
    shape, band = (13, 11, 12), 3.0
    expected = np.full(shape, band * band)
    for at in np.ndindex(shape):
        for a, b, c in corners:
            place = tuple(map(float, at))
            expected[at] = min(expected[at], _squared_distance(place, tuple(a), tuple(b), tuple(c)))
    np.testing.assert_array_equal(_near_distance(corners, shape, band), np.sqrt(expected))


def test_sweeping_by_diagonals_is_sweeping_by_lines(rng):
    """The same samples are updated from the same neighbours, so every bit is the same."""
    anchored = rng.random((7, 9, 6)) < 0.05
    start = np.where(anchored, rng.random(anchored.shape), _FAR)
    padded = np.pad(start, 1, constant_values=_FAR)
    for corner in range(8):
        lines = (
            range(1, n + 1) if corner & bit else range(n, 0, -1)
            for n, bit in zip(start.shape, (1, 2, 4), strict=True)
        )
        for i, j, k in product(*lines):
            if not anchored[i - 1, j - 1, k - 1]:
                near = (
                    min(padded[i - 1, j, k], padded[i + 1, j, k]),
                    min(padded[i, j - 1, k], padded[i, j + 1, k]),
                    min(padded[i, j, k - 1], padded[i, j, k + 1]),
                )
                padded[i, j, k] = min(padded[i, j, k], _eikonal(*near))
    found = _swept(start, anchored)
    np.testing.assert_array_equal(found, padded[1:-1, 1:-1, 1:-1])
