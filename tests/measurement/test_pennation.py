"""The pennation angle on rendered images: lines of known direction, speckle alone, and no muscle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from limbcli.errors import MeasurementError
from limbcli.measurement.pennation import LEAST_DEVIATION_DEG, read_pennation
from limbcli.measurement.ultrasound_image import Region, UltrasoundImage
from tests.measurement.test_bmode import COLUMNS, MM_PER_PIXEL, ROWS, image_of, speckle


def muscle(rng: np.random.Generator, angle_deg: float, *, contrast: float = 0.5) -> np.ndarray:
    """Speckle, modulated by septa of 1 to 3 mm distance that run at the angle (deeper to the right)."""
    a = np.radians(angle_deg)
    row, column = np.mgrid[:ROWS, :COLUMNS] * MM_PER_PIXEL
    across = -np.sin(a) * column + np.cos(a) * row
    along = np.cos(a) * column + np.sin(a) * row
    at = gaussian_filter(rng.standard_normal((1200, 200)), (6, 25), mode="wrap")
    i, j = np.floor(across / 0.05).astype(int) % 1200, np.floor(along / 0.4).astype(int) % 200
    septa = at[i, j] / at.std()
    return np.clip(speckle(rng) * (1 + contrast * np.clip(septa, -1.5, 2.5)), 0, 1)


@pytest.mark.parametrize("angle", [-35.0, -10.0, 0.0, 15.0, 25.0, 60.0])
def test_the_angle_of_rendered_septa_is_read(angle):
    rng = np.random.default_rng(7)
    found = read_pennation(image_of(muscle(rng, angle)), top=5.0, bottom=38.0)
    assert found.angle_deg == pytest.approx(angle, abs=2.5)
    assert found.coherence > 0.25
    assert found.deviation_deg >= LEAST_DEVIATION_DEG


@pytest.mark.slow
def test_its_doubt_covers_what_it_is_off():
    """20 images, faint septa: within two deviations 19 are expected, 17 have a chance of 98 %."""
    hits = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        angle = rng.uniform(5.0, 30.0)
        found = read_pennation(image_of(muscle(rng, angle, contrast=0.25)), top=5.0, bottom=38.0)
        hits += abs(found.angle_deg - angle) < 2 * found.deviation_deg
    assert hits >= 17


def test_pixels_that_are_not_square_are_allowed_for():
    image = image_of(muscle(np.random.default_rng(7), 20.0))
    half = image.rgb[::2]
    region = Region(0, 0, half.shape[1] - 1, half.shape[0] - 1, MM_PER_PIXEL, 2 * MM_PER_PIXEL)
    found = read_pennation(UltrasoundImage(half, (region,), image.path), top=5.0, bottom=38.0)
    assert found.angle_deg == pytest.approx(20.0, abs=2.5)


@pytest.mark.parametrize("seed", range(5))
def test_speckle_alone_has_no_direction(seed):
    with pytest.raises(MeasurementError, match=r"no fibres can be detected|no common direction"):
        read_pennation(image_of(speckle(np.random.default_rng(seed))), top=5.0, bottom=38.0)


def test_fibres_that_cross_have_no_common_direction():
    rng = np.random.default_rng(7)
    left, right = muscle(rng, 44.0), muscle(rng, -46.0)
    both = np.where(np.arange(COLUMNS)[None, :] < COLUMNS / 2, left, right)
    with pytest.raises(MeasurementError, match="no common direction"):
        read_pennation(image_of(both), top=5.0, bottom=38.0)


@pytest.mark.parametrize(("top", "bottom"), [(10.0, 16.0), (30.0, 20.0), (39.0, 80.0)])
def test_too_little_muscle_is_said(top, bottom):
    image = image_of(speckle(np.random.default_rng(7)))
    with pytest.raises(MeasurementError, match="too small to detect fibres in") as caught:
        read_pennation(image, top=top, bottom=bottom)
    assert "manually" in caught.value.fix


def test_an_image_without_a_scale_is_refused():
    image = replace(image_of(speckle(np.random.default_rng(7))), regions=())
    with pytest.raises(MeasurementError, match="no calibrated region"):
        read_pennation(image, top=5.0, bottom=38.0)
