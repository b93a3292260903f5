"""Predicted maps: what the scanner's window shows of speeds known at elements."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import MeasurementError
from limbcli.shear_waves.pixels import Window, predict_map


def tissue(rng, n=40_000, floor=-40.0):
    return rng.uniform([-40, -12, floor], [40, 12, -3], (n, 3))


def test_a_speed_linear_in_space_is_reproduced_at_pixel_centres(rng):
    points = tissue(rng)
    speed = 2 + 0.02 * points[:, 0] - 0.03 * points[:, 2] + 0.1 * points[:, 1]
    swe = predict_map(points, speed, face_height=-3.0)
    expected = 2 + 0.02 * swe.lateral - 0.03 * (-3.0 - swe.depth)
    assert swe.speed_m_per_s == pytest.approx(expected, abs=1e-6)
    assert len(swe) == 25 * 24
    assert (swe.lateral.min(), swe.lateral.max()) == (-12, 12)
    assert (swe.depth.min(), swe.depth.max()) == (2, 25)


def test_the_window_moves_with_the_probe(rng):
    points = tissue(rng)
    swe = predict_map(points, -points[:, 2], face_height=-8.0)
    assert swe.speed_m_per_s == pytest.approx(swe.depth + 8.0, abs=1e-6)


def test_pixels_in_bone_are_left_out(rng):
    points = tissue(rng, floor=-18.0)
    swe = predict_map(points, np.full(len(points), 2.0), face_height=-3.0)
    assert 14 <= swe.depth.max() <= 17


def test_a_mesh_that_grows_coarse_downwards_leaves_no_holes(rng):
    points = tissue(rng, n=60_000)
    share = np.clip((points[:, 2] + 40) / 37, 0, 1) ** 2  # sparse below, dense under the probe
    points = points[rng.uniform(size=len(points)) < 0.01 + share]
    swe = predict_map(points, np.full(len(points), 2.0), face_height=-3.0)
    assert len(swe) >= 0.995 * 25 * 24


def test_places_without_a_wave_are_left_out(rng):
    points = tissue(rng)
    speed = np.where(points[:, 0] > 0, np.nan, 2.0)
    swe = predict_map(points, speed, face_height=-3.0)
    assert swe.lateral.max() <= 1
    assert np.isfinite(swe.speed_m_per_s).all()


def test_smoothing_is_that_of_the_window(rng):
    """A step of speed comes out with about the width that was asked for."""
    points = tissue(rng, n=120_000)
    speed = np.where(points[:, 0] > 0, 3.0, 2.0)
    narrow, wide = (
        predict_map(points, speed, face_height=-3.0, window=Window(smoothing=size)) for size in (2.0, 6.0)
    )
    for swe, low, high in ((narrow, 1, 3), (wide, 3, 8)):
        row = swe.speed_m_per_s[swe.depth == 10]
        mixed = np.sum((row > 2.1) & (row < 2.9))
        assert low <= mixed <= high


def test_a_window_off_the_tissue_is_an_error(rng):
    points = tissue(rng) + np.array([200.0, 0, 0])
    with pytest.raises(MeasurementError, match="no tissue"):
        predict_map(points, np.full(len(points), 2.0), face_height=-3.0)
