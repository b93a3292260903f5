"""Colour overlays: what can be read is right, what cannot is left out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from limbcli.errors import MeasurementError
from limbcli.measurement.swe_image import Overlay, bar_colours, decode_overlay
from limbcli.measurement.ultrasound_image import Region, UltrasoundImage

ROWS, COLUMNS = 300, 400
BOX = (60, 40, 299, 239)
BAR = (370, 40, 389, 239)
MM_PER_PIXEL = 0.1


def overlay(opacity: float = 1.0) -> Overlay:
    return Overlay(BOX, BAR, 0.5, 10.5, opacity)


def render(rng: np.random.Generator, speed: np.ndarray, opacity: float = 1.0, *, turns: int = 1):
    """A screen: speckled B-mode, the bar at the right, and the coloured box; NaN stays uncoloured."""
    colours = matplotlib.colormaps["jet"](np.linspace(0, turns, 200, endpoint=turns == 1) % 1.000001)
    colours = (colours[:, :3] * 255).round()
    grey = np.clip(80 + 30 * rng.standard_normal((ROWS, COLUMNS)), 0, 255)
    rgb = np.repeat(grey[:, :, None], 3, axis=2)
    rgb[BAR[1] : BAR[3] + 1, BAR[0] : BAR[2] + 1] = colours[::-1, None, :]
    index = np.clip((np.nan_to_num(speed) - 0.5) / 10.0 * 199, 0, 199).round().astype(int)
    box = rgb[BOX[1] : BOX[3] + 1, BOX[0] : BOX[2] + 1]
    mixed = opacity * colours[index] + (1 - opacity) * box
    rgb[BOX[1] : BOX[3] + 1, BOX[0] : BOX[2] + 1] = np.where(np.isnan(speed)[:, :, None], box, mixed)
    region = Region(0, 0, COLUMNS - 1, ROWS - 1, MM_PER_PIXEL, MM_PER_PIXEL)
    return UltrasoundImage(rgb.round().astype(np.uint8), (region,), Path("frame.png"))


def ramp() -> np.ndarray:
    """Speeds 2 to 8 m/s growing downwards."""
    return np.repeat(np.linspace(2, 8, 200)[:, None], 240, axis=1)


def expected(depth: np.ndarray) -> np.ndarray:
    return np.interp(depth / MM_PER_PIXEL - BOX[1], np.arange(200), np.linspace(2, 8, 200))


@pytest.mark.parametrize("opacity", [1.0, 0.7, 0.5])
def test_speed_is_read_through_the_bar_at_any_opacity(rng, opacity):
    decoded = decode_overlay(render(rng, ramp(), opacity), overlay(opacity))
    error = decoded.swe.speed_m_per_s - expected(decoded.swe.depth)
    # one of 200 colours is 0.05 m/s; rounding to bytes under a half-transparent colour doubles it
    assert np.abs(error).max() < 0.2
    assert len(decoded.swe) > 0.9 * (len(decoded.swe) + decoded.n_ambiguous)


@pytest.mark.parametrize(("opacity", "speed"), [(0.6, 2.0), (0.8, 9.5)])
def test_the_few_pixels_that_a_wrong_opacity_leaves_are_no_reading(rng, opacity, speed):
    image = render(rng, np.full(ramp().shape, speed), opacity)
    with pytest.raises(MeasurementError, match="few pixels of the box could be read"):
        decode_overlay(image, overlay())  # as if nothing shone through
    faint = decode_overlay(render(rng, np.full(ramp().shape, 5.0), 0.9), overlay())
    assert faint.share_unlike == pytest.approx(0.48, abs=0.05)


def test_a_bar_that_lies_is_low_at_its_left(rng):
    """The screen with its upright bar laid along the lower edge."""
    image, lying = render(rng, ramp()), (60, 270, 259, 289)
    rgb = image.rgb.copy()
    rgb[270:290, 60:260] = rgb[BAR[1] : BAR[3] + 1, BAR[0] : BAR[2] + 1][::-1].swapaxes(0, 1)
    found = bar_colours(replace(image, rgb=rgb), replace(overlay(), bar_pixels=lying))
    for mine, upright in zip(found, bar_colours(image, overlay()), strict=True):
        np.testing.assert_allclose(mine, upright, atol=1e-9)


def test_a_bar_in_kpa_is_even_in_the_speed_s_square(rng):
    image = render(rng, ramp())
    even = decode_overlay(image, overlay()).swe.speed_m_per_s
    squares = decode_overlay(image, replace(overlay(), of_modulus=True)).swe.speed_m_per_s
    share = (even - 0.5) / 10.0  # of the way along the bar
    np.testing.assert_allclose(squares**2, 0.25 + share * (10.5**2 - 0.25))


def test_a_box_that_stands_a_pixel_aside_is_read_at_the_same_places(rng):
    image = render(rng, ramp())
    one = decode_overlay(image, overlay()).swe
    aside = Overlay((BOX[0] + 1, BOX[1] + 2, BOX[2], BOX[3]), BAR, 0.5, 10.5)
    other = decode_overlay(image, aside).swe
    assert set(other.lateral) <= set(one.lateral)
    assert set(other.depth) <= set(one.depth)


def test_uncoloured_pixels_are_left_out_and_counted(rng):
    speed = ramp()
    speed[:, :120] = np.nan
    decoded = decode_overlay(render(rng, speed), overlay())
    assert decoded.swe.lateral.min() > (BOX[0] + 119 - (COLUMNS - 1) / 2) * MM_PER_PIXEL
    assert decoded.n_masked == pytest.approx(len(decoded.swe), rel=0.1)


def test_colour_that_stands_twice_on_the_bar_is_never_guessed(rng):
    with pytest.raises(MeasurementError, match="ambiguous"):
        decode_overlay(render(rng, ramp(), turns=2), overlay())


def test_saturated_pixels_are_marked(rng):
    speed = ramp()
    speed[100:, :] = 99.0
    decoded = decode_overlay(render(rng, speed), overlay())
    assert decoded.saturated.mean() == pytest.approx(0.5, abs=0.05)
    assert decoded.unsaturated.speed_m_per_s.max() < 6.0


def test_places_are_in_the_probe_frame(rng):
    decoded = decode_overlay(render(rng, ramp()), overlay())
    assert decoded.swe.depth.min() == pytest.approx(BOX[1] * MM_PER_PIXEL)
    assert decoded.swe.lateral.min() == pytest.approx((BOX[0] - (COLUMNS - 1) / 2) * MM_PER_PIXEL)


def test_depths_are_those_of_the_region_that_holds_the_box(rng):
    """A dual view: B-mode above, elastography below, and the box a calibrated region of its own."""
    image = render(rng, ramp())
    above = Region(0, 0, COLUMNS - 1, 29, 0.2, 0.2)
    below = Region(20, 30, COLUMNS - 21, ROWS - 1, MM_PER_PIXEL, MM_PER_PIXEL)
    wide = Region(0, 0, COLUMNS - 1, BOX[1] + 40, MM_PER_PIXEL, MM_PER_PIXEL)
    dual = replace(image, regions=(above, Region(*BOX, MM_PER_PIXEL, MM_PER_PIXEL), below))
    depth = decode_overlay(dual, overlay()).swe.depth
    assert (depth.min(), depth.max()) == pytest.approx((1.0, 20.5))
    for regions in ((above,), (above, wide)):
        with pytest.raises(MeasurementError, match="none of the image's calibrated regions"):
            decode_overlay(replace(image, regions=regions), overlay())


def test_bar_runs_from_low_to_high(rng):
    colours, speeds = bar_colours(render(rng, ramp()), overlay())
    assert colours[0, 2] > colours[0, 0], "jet's low end is blue"
    assert colours[-1, 0] > colours[-1, 2], "jet's high end is red"
    assert (speeds[0], speeds[-1]) == (0.5, 10.5)


def test_wrong_places_are_refused(rng):
    image = render(rng, ramp())
    with pytest.raises(MeasurementError, match="mostly grey"):
        decode_overlay(image, Overlay(BOX, (10, 40, 29, 239), 0.5, 10.5))
    with pytest.raises(MeasurementError, match="does not lie in the image"):
        decode_overlay(image, Overlay((0, 0, 999, 10), BAR, 0.5, 10.5))
