"""Colour bar and box in screens that nobody described."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib import colormaps

from limbcli.errors import MeasurementError
from limbcli.measurement.overlay_places import SCREENS, find_bar, find_box
from limbcli.measurement.ultrasound_image import UltrasoundImage, read_image
from tests.measurement.test_swe_image import BAR, BOX, COLUMNS, ROWS, ramp, render


@pytest.mark.parametrize("opacity", [1.0, 0.5])
def test_bar_and_box_are_found_where_they_are(rng, opacity):
    speed = ramp()
    speed[50:90, 60:140] = np.nan  # a hole without colour
    image = render(rng, speed, opacity)
    assert np.abs(np.array(find_bar(image)) - BAR).max() <= 1
    assert np.abs(np.array(find_box(image, BAR)) - BOX).max() <= 1


def test_lying_bar_is_found_too(rng):
    image = render(rng, ramp())
    turned = UltrasoundImage(np.rot90(image.rgb).copy(), (), image.path)
    left, top, right, bottom = find_bar(turned)
    assert (right - left, bottom - top) == (BAR[3] - BAR[1], BAR[2] - BAR[0])


def test_a_bar_whose_sides_are_blurred_is_found(rng):
    """As lossy compression leaves it: two columns at each side fade into the black screen."""
    rgb = render(rng, ramp()).rgb.copy()
    left, top, right, bottom = BAR
    rgb[top : bottom + 1, left : left + 2] //= 2
    rgb[top : bottom + 1, right - 1 : right + 1] //= 2
    assert np.abs(np.array(find_bar(UltrasoundImage(rgb, (), Path("x")))) - BAR).max() <= 2


@pytest.mark.parametrize("scale", [1, 2])
def test_the_bar_of_a_mach_30_screen_is_where_the_preset_has_it(scale):
    rgb = np.zeros((540 * scale, 720 * scale, 3), np.uint8)
    line = colormaps["jet"](np.linspace(1, 0, 110 * scale))[:, None, :3]
    rgb[70 * scale : 180 * scale, 693 * scale : 700 * scale] = 255 * line
    image = UltrasoundImage(rgb, (), Path("x"))
    left, top, right, bottom = SCREENS["mach30"].bar_in(image)
    assert (rgb[top : bottom + 1, left : right + 1].max(axis=2) > 0).all()
    assert (bottom - top + 1) == 110 * scale
    with pytest.raises(MeasurementError, match="not a whole screen"):
        SCREENS["mach30"].bar_in(UltrasoundImage(rgb[:500], (), Path("x")))


@pytest.mark.parametrize("colours", ["turbo", "gist_ncar"])
def test_a_bar_is_found_to_its_ends_though_they_are_dark_or_pale(rng, colours):
    rgb = render(rng, ramp()).rgb.copy()
    left, top, right, bottom = BAR
    line = colormaps[colours](np.linspace(1, 0, bottom - top + 1))[:, None, :3]
    rgb[top : bottom + 1, left : right + 1] = 255 * line
    assert np.abs(np.array(find_bar(UltrasoundImage(rgb, (), Path("x")))) - BAR).max() <= 1


def test_a_bar_that_fades_into_a_black_screen_is_not_cut_where_its_colour_ends(rng):
    rgb = render(rng, ramp()).rgb.copy()
    left, top, right, bottom = BAR
    line = colormaps["CMRmap"](np.linspace(1, 0, bottom - top + 1))[:, None, :3]  # down to black
    rgb[:, BOX[2] + 1 :] = 0
    rgb[top : bottom + 1, left : right + 1] = 255 * line
    with pytest.raises(MeasurementError, match="blends into"):
        find_bar(UltrasoundImage(rgb, (), Path("x")))


def test_nothing_is_guessed_without_a_bar_with_two_or_without_a_box(rng):
    grey = np.full((ROWS, COLUMNS, 3), 90, np.uint8)
    image = render(rng, ramp())
    with pytest.raises(MeasurementError, match="no colour bar"):
        find_bar(UltrasoundImage(grey, (), image.path))
    two = image.rgb.copy()
    two[:, 10:30] = two[:, BAR[0] : BAR[2] + 1]
    with pytest.raises(MeasurementError, match="2 strips"):
        find_bar(UltrasoundImage(two, (), image.path))
    alone = render(rng, np.full(ramp().shape, np.nan))
    with pytest.raises(MeasurementError, match="no coloured box"):
        find_box(alone, find_bar(alone))


def test_real_muscle_images_have_no_elastography_bar(shared):
    for path in sorted((shared / "data" / "b-mode").rglob("*.png"))[:4]:
        with pytest.raises(MeasurementError):
            find_bar(read_image(path, mm_per_pixel=0.1))
