"""The verdict on a segmentation, and layers under a place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from limb_images import Limb
from scipy import ndimage

from limbcli.imaging.labels import segmentation_from
from limbcli.imaging.layer_thickness import layers_at
from limbcli.imaging.quality import assess
from limbcli.imaging.surface import surface_of
from limbcli.imaging.volume import Volume

pytestmark = pytest.mark.slow

NAMES = ("tibia", "fibula")


@pytest.fixture(scope="module")
def good():
    image, labels = Limb().image(samples=1)
    return segmentation_from(image.with_values(labels.astype(np.uint8)))


def with_bone(found, change):
    values = found.bones[0].values.copy()
    change(values)
    return replace(found, bones=(found.bones[0].with_values(values), *found.bones[1:]))


def test_a_good_segmentation_is_called_good(good):
    quality = assess(good, NAMES)
    assert quality.verdict == "good"
    assert quality.findings == ()
    assert quality.figures["tibia_half_thickness_mm"] == pytest.approx(11.0, abs=1.0)


def test_a_leak_to_the_skin_is_poor(good):
    def leak(values):
        values[:, :, 6:10] |= good.skin.values[:, :, 6:10]

    quality = assess(with_bone(good, leak), NAMES)
    assert quality.verdict == "poor"
    assert any("skin" in finding for finding in quality.findings)


def test_a_round_end_at_the_first_slice_is_no_jump(good):
    """DICOM SEG leaves empty slices out: the stump's tip is the first slice."""
    x, y = np.mgrid[:60, :60] - 29.5
    radius = 25.0 * np.sqrt(np.clip(np.arange(40) / 6.0, 0.02, 1.0))
    values = np.hypot(x, y)[:, :, None] < radius
    stump = Volume(values, np.diag([2.0, 2.0, 3.0, 1.0]))

    def figures(limb):
        return assess(replace(good, skin=limb, bones=()), ()).figures["limb_jump_share"]

    assert figures(stump) < 0.05
    crushed = values.copy()
    crushed[:30, :, 20:] = False
    assert figures(stump.with_values(crushed)) > 0.5


def test_a_hole_and_a_gap_are_seen(good):
    def hole(values):
        inner = np.argwhere(ndimage.binary_erosion(values, iterations=4))
        i, j, _ = inner.mean(axis=0).astype(int)
        values[i - 1 : i + 2, j - 1 : j + 2, 5:8] = False

    def gap(values):
        values[:, :, 8] = False

    assert assess(with_bone(good, hole), NAMES).figures["tibia_holes_mm3"] == pytest.approx(27 * 4)
    assert assess(with_bone(good, gap), NAMES).figures["tibia_gaps"] == 1
    assert assess(with_bone(good, gap), NAMES).verdict != "good"


def test_a_thin_spot_is_seen(good):
    def thin(values):
        values[:, :, 7] = ndimage.binary_erosion(values[:, :, 7], iterations=10)

    assert assess(with_bone(good, thin), NAMES).verdict == "poor"


def test_a_limb_cut_by_the_images_side_is_seen(good):
    cut = replace(good, skin=good.skin.with_values(good.skin.values[20:]))
    cut = replace(cut, bones=tuple(each.with_values(each.values[20:]) for each in good.bones))
    assert assess(cut, NAMES).figures["limb_cut_share"] > 0.03
    assert assess(cut, NAMES).verdict != "good"


def test_fat_under_a_place_has_its_true_thickness(good):
    """Ellipse with skin to 1.6 mm and fat to 6.5 mm (times the half depth), measured at the front."""
    fine = np.indices((104, 92, 16)).reshape(3, -1).T
    x, y, _ = good.skin.to_patient(fine).T
    depth = (1 - np.hypot(x / 42.0, y / 36.0)) * 36.0
    fat = Volume(((depth > 1.6) & (depth < 6.5)).reshape(104, 92, 16), good.skin.affine)
    layers = layers_at(np.array([0.0, -36.0, 0.0]), surface_of(good.skin, edge=2.0), fat)
    assert layers.fat == pytest.approx(4.9, abs=0.4)
    assert layers.skin == pytest.approx(1.6, abs=0.5)


def test_without_fat_no_thickness_is_made_up(good):
    nothing = good.skin.with_values(np.zeros_like(good.skin.values))
    assert layers_at(np.array([0.0, -36.0, 0.0]), surface_of(good.skin, edge=2.0), nothing) is None


def test_a_limb_upside_down_is_seen(good):
    values = good.skin.values.copy()
    values[:, :, -3:] = False
    bones = tuple(each.with_values(each.values & values) for each in good.bones)
    quality = assess(replace(good, skin=good.skin.with_values(values), bones=bones), NAMES)
    assert any("upside down" in finding for finding in quality.findings)


@pytest.mark.parametrize(("between", "share"), [(0.0, 0.0), (76.0, 1.0)])
def test_two_limbs_that_touch_are_no_good_limb(good, between, share):
    """Thighs in view side by side are one body in the image."""
    x, y = np.mgrid[:90, :44] * 2.0 - [[[88.0]], [[43.0]]]
    section = np.hypot((np.abs(x) - between / 2) / 42.0, y / 36.0) < 1.0
    both = Volume(np.repeat(section[:, :, None], 10, axis=2), np.diag([2.0, 2.0, 5.0, 1.0]))
    quality = assess(replace(good, skin=both, bones=()), ())
    assert quality.figures["limb_in_two_share"] == share
    assert any("two limbs" in each for each in quality.findings) == bool(share)


def test_a_single_bone_is_remarked_on(good):
    quality = assess(replace(good, bones=good.bones[:1]), NAMES[:1])
    assert quality.verdict == "check"
    assert any("one bone" in finding for finding in quality.findings)
