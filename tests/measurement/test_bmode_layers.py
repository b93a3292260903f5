"""Borders of layers on rendered speckle whose layers are strained each in its own way."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from limbcli.errors import MeasurementError
from limbcli.measurement.bmode import BoneLine, follow_bone
from limbcli.measurement.bmode_layers import follow_borders
from limbcli.measurement.ultrasound_image import read_image
from tests.measurement.test_bmode import COLUMNS, MM_PER_PIXEL, ROWS, image_of, speckle

# Depth of the borders of skin, fat and bone (pixels) at the levels: fat gives way more than muscle.
LEVELS = np.array([[15.0, 85.0, 300.0], [14.5, 76.0, 284.0], [14.0, 68.0, 270.0], [13.5, 62.0, 259.0]])


def frame(rng, borders, tissue):
    """Material rows carried by a map that is linear in every layer; bright borders move with it."""
    rest, rows = np.r_[0.0, LEVELS[0]], np.arange(ROWS)
    bright = tissue.copy()
    for place, width in ((LEVELS[0][0], 2.0), (LEVELS[0][1], 3.0)):
        bright += 0.5 * np.exp(-0.5 * ((rows - place) / width) ** 2)[:, None]
    source = np.interp(rows, np.r_[0.0, borders], rest)
    moved = np.stack([np.interp(source, rows, bright[:, k]) for k in range(COLUMNS)], axis=1)
    bone = borders[-1]
    bone_line = 0.9 * np.exp(-0.5 * ((rows - bone) / 4.0) ** 2)[:, None]
    grey = np.where(rows[:, None] > bone + 4, 0.01, moved) + bone_line
    return image_of(grey + 0.02 * rng.standard_normal((ROWS, COLUMNS)))


@pytest.fixture
def images(rng):
    tissue = speckle(rng)
    return [frame(rng, each, tissue) for each in LEVELS]


def test_borders_are_followed_as_the_bone_line_is(images):
    bone = follow_bone(images)
    found = follow_borders(images, {"skin": 1.5, "fat": 7.0}, bone)
    assert list(found) == ["skin", "fat"]
    for k, name in enumerate(found):
        expected = LEVELS[:, k] * MM_PER_PIXEL
        np.testing.assert_allclose([each.distance for each in found[name]], expected, atol=0.15)
        sd = [each.sd for each in found[name]]
        assert sd == sorted(sd)  # errors add up from level to level


def test_borders_that_are_stated_for_every_level_are_taken_as_they_are(images):
    bone = follow_bone(images)
    found = follow_borders(images, {"skin": [1.5, 1.4, 1.4, 1.3], "fat": 7.0}, bone)
    assert [each.distance for each in found["skin"]] == [1.5, 1.4, 1.4, 1.3]
    with pytest.raises(MeasurementError, match="skin_mm states 2 thicknesses, there are 4 images"):
        follow_borders(images, {"skin": [1.5, 1.4]}, bone)


def test_fat_without_skin_and_crossing_interfaces_are_refused(images):
    bone = follow_bone(images)
    with pytest.raises(MeasurementError, match="fat_mm is stated without skin_mm"):
        follow_borders(images, {"fat": 7.0}, bone)
    with pytest.raises(MeasurementError, match=r"and the bone at 29\.\d mm: interfaces cross"):
        follow_borders(images, {"skin": 1.5, "fat": 29.0}, bone)


def test_a_lost_border_is_said_with_its_name(images, rng):
    noise = image_of(rng.uniform(0, 1, (ROWS, COLUMNS)))
    bone = [BoneLine(30.0, 0.1, 1.0), BoneLine(28.0, 0.1, 1.0)]
    with pytest.raises(MeasurementError, match="the border of the skin is lost") as caught:
        follow_borders([images[0], noise], {"skin": 1.5}, bone)
    assert "skin_mm, a list" in str(caught.value)


def test_the_fascia_of_real_images_is_followed(shared):
    """Gastrocnemius while the ankle turns: the brightest line of each frame, found there by itself."""
    files = sorted((shared / "data" / "b-mode" / "dataset_2_range-of-motion").glob("*.png"))
    images = [read_image(path, mm_per_pixel=0.1, box_pixels=(110, 60, 685, 500)) for path in files]
    assert len(images) == 3
    fascia = []
    for image in images:
        region = image.main_region()
        middle = (region.left + region.right) // 2
        strip = image.grey[region.top : region.bottom + 1, middle - 50 : middle + 50]
        fascia.append(0.1 * float(np.argmax(gaussian_filter1d(strip.mean(axis=1), 4.0))))
    bone = [BoneLine(43.0, 0.1, 1.0)] * 3
    found = follow_borders(images, {"skin": 2.0, "fat": fascia[0] - 2.0}, bone)["fat"]
    np.testing.assert_allclose([each.distance for each in found], fascia, atol=0.6)
    assert all(each.correlation > 0.9 for each in found)
