"""The bone line on rendered speckle with known motion; images without bone name none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from limbcli.errors import MeasurementError
from limbcli.measurement.bmode import find_bone, follow_bone
from limbcli.measurement.ultrasound_image import Region, UltrasoundImage, read_image

MM_PER_PIXEL = 0.1
ROWS, COLUMNS = 400, 300


def image_of(grey: np.ndarray) -> UltrasoundImage:
    rgb = np.repeat((np.clip(grey, 0, 1) * 255).astype(np.uint8)[:, :, None], 3, axis=2)
    region = Region(0, 0, grey.shape[1] - 1, grey.shape[0] - 1, MM_PER_PIXEL, MM_PER_PIXEL)
    return UltrasoundImage(rgb, (region,), Path("frame.png"))


def speckle(rng: np.random.Generator, rows: int = ROWS) -> np.ndarray:
    """Rayleigh speckle, log-compressed."""
    field = gaussian_filter(rng.standard_normal((rows, COLUMNS)), (1, 3)) + 1j * gaussian_filter(
        rng.standard_normal((rows, COLUMNS)), (1, 3)
    )
    level = 20 * np.log10(np.abs(field) / np.abs(field).max() + 1e-4)
    return np.clip(0.35 * (level + 50) / 50 + 0.08, 0, 1)


def frame(rng: np.random.Generator, bone_row: float, tissue: np.ndarray, *, slope: float = 0.02):
    """Tissue pressed so that the bone lies at `bone_row`; fresh electronic noise every time."""
    rows = np.arange(ROWS)[:, None]
    line = bone_row + slope * (np.arange(COLUMNS)[None, :] - COLUMNS / 2)
    moved = shift(tissue, (bone_row - 300.0, 0), order=1, mode="nearest")[:ROWS]
    bone = 0.9 * np.exp(-0.5 * ((rows - line) / 4.0) ** 2)
    grey = np.where(rows > line + 4, 0.01, moved) + bone
    return image_of(grey + 0.02 * rng.standard_normal((ROWS, COLUMNS)))


def test_known_motion_is_followed_to_a_tenth_of_a_millimetre(rng):
    tissue = speckle(rng)
    rows = [300.0, 293.3, 281.7, 268.4, 262.1]
    lines = follow_bone([frame(rng, row, tissue) for row in rows])
    found = np.array([each.distance for each in lines])
    np.testing.assert_allclose(found, np.array(rows) * MM_PER_PIXEL, atol=0.1)
    np.testing.assert_allclose(np.diff(found), np.diff(rows) * MM_PER_PIXEL, atol=0.05)
    assert all(0 < each.sd < 0.3 for each in lines)


def test_stated_bone_is_followed_like_a_found_one(rng):
    tissue = speckle(rng)
    lines = follow_bone([frame(rng, row, tissue) for row in (300.0, 290.0)], bone=30.0)
    assert lines[1].distance == pytest.approx(29.0, abs=0.05)


def test_the_bone_is_followed_into_a_picture_that_is_a_column_wider(rng):
    tissue = speckle(rng)
    first, second = (frame(rng, row, tissue).grey for row in (300.0, 290.0))
    narrow, wide = image_of(first[:, 110:190]), image_of(second[:, 110:191])
    assert follow_bone([narrow, wide], bone=30.0)[1].distance == pytest.approx(29.0, abs=0.05)


def test_image_without_bone_names_none(rng):
    with pytest.raises(MeasurementError, match="no bone line is visible"):
        find_bone(image_of(speckle(rng)))


def test_aponeurosis_without_shadow_is_not_bone(rng):
    grey = speckle(rng)
    grey[200:208] = 0.95
    with pytest.raises(MeasurementError, match="no bone line is visible"):
        find_bone(image_of(grey))


def test_lost_line_is_said_with_its_image(rng):
    tissue = speckle(rng)
    noise = image_of(rng.uniform(0, 1, (ROWS, COLUMNS)))
    with pytest.raises(MeasurementError, match="is lost"):
        follow_bone([frame(rng, 300.0, tissue), noise])


def test_a_bone_that_moved_beyond_the_search_is_not_put_at_its_end(rng):
    tissue = speckle(rng)
    with pytest.raises(MeasurementError, match=r"moved by 8\.0 mm or more"):
        follow_bone([frame(rng, row, tissue) for row in (300.0, 216.0)], bone=30.0)


def test_change_of_scale_is_refused(rng):
    tissue = speckle(rng)
    first, second = frame(rng, 300.0, tissue), frame(rng, 290.0, tissue)
    coarser = UltrasoundImage(second.rgb, (Region(0, 0, COLUMNS - 1, ROWS - 1, 0.12, 0.12),), second.path)
    with pytest.raises(MeasurementError, match="scale changes"):
        follow_bone([first, coarser])


BOXES = {"gastroc": (110, 60, 685, 500), "GM_T": (240, 45, 995, 675), "GM_P": (120, 70, 640, 500)}


def test_real_muscle_images_hold_no_bone(shared):
    files = [p for p in sorted((shared / "data" / "b-mode").rglob("*")) if p.suffix in (".png", ".bmp")]
    assert files
    for path in files:
        box = next((box for name, box in BOXES.items() if path.name.startswith(name)), None)
        with pytest.raises(MeasurementError, match="no bone line is visible"):
            find_bone(read_image(path, mm_per_pixel=0.1, box_pixels=box))


@pytest.mark.parametrize("mm_per_pixel", [0.05, 0.0885, 0.13])
def test_the_black_of_a_screen_below_a_real_muscle_is_no_shadow_of_a_bone(shared, mm_per_pixel):
    files = [p for p in sorted((shared / "data" / "b-mode").rglob("*")) if p.suffix in (".bmp", ".jpg")]
    assert len(files) == 6
    for path in files:
        with pytest.raises(MeasurementError, match="no bone line is visible"):
            find_bone(read_image(path, mm_per_pixel=mm_per_pixel))


def test_a_bone_is_found_however_far_the_screen_goes_on_below_it(rng):
    seen = frame(rng, 300.0, speckle(rng))
    rows = np.vstack([seen.rgb, np.zeros((200, COLUMNS, 3), np.uint8)])
    longer = UltrasoundImage(rows, (Region(0, 0, COLUMNS - 1, ROWS + 199, 0.1, 0.1),), seen.path)
    assert find_bone(longer).distance == pytest.approx(find_bone(seen).distance, abs=0.01)


def test_real_dicom_regions_are_read_and_uncalibrated_ones_are_not(shared):
    folder = shared / "data" / "us-dicom"
    assert read_image(folder / "gdcm-US-ALOKA-16.dcm").regions[0].mm_per_pixel_y == pytest.approx(
        0.3827, abs=1e-4
    )
    with pytest.raises(MeasurementError, match="no calibrated region"):
        read_image(folder / "US1_UNCR.dcm").main_region()


def test_file_that_is_no_image_is_refused(tmp_path):
    (tmp_path / "a.png").write_text("no image")
    with pytest.raises(MeasurementError, match="cannot be read"):
        read_image(tmp_path / "a.png", mm_per_pixel=0.1)
    with pytest.raises(MeasurementError, match="was not found"):
        read_image(tmp_path / "b.png", mm_per_pixel=0.1)


def test_a_bone_stated_outside_the_image_is_refused(rng):
    image = frame(rng, 300.0, speckle(rng))
    with pytest.raises(MeasurementError, match="the image ends at"):
        follow_bone([image, image], bone=500.0)
