"""Numbers of skin markers, and what is no marker."""

from __future__ import annotations

import numpy as np
import pytest
from limb_images import Limb

from limbcli.imaging.markers import number_markers
from limbcli.imaging.segmentation import segment_limb
from limbcli.imaging.volume import Volume

pytestmark = pytest.mark.slow

MIDDLE = np.array([29.5, 29.5, 0.0])


@pytest.fixture
def limb():
    index = np.indices((60, 60, 30))
    inside = np.hypot(index[0] - 29.5, index[1] - 29.5) < 25
    return Volume(inside, np.diag([1.0, 1.0, 4.0, 1.0]))


def numbered(limb, *places):
    """The given places (mm from the limb's middle, height) in the order of their numbers."""
    positions = np.array(places, float) + MIDDLE
    found = number_markers(positions, np.ones(len(places)), limb, limb.values)
    assert [each.number for each in found] == list(range(1, len(places) + 1))
    return [tuple(np.round(np.array(each.position) - MIDDLE, 6)) for each in found]


def test_markers_are_numbered_from_distal_to_proximal(limb):
    low, middle, high = (25.0, 0.0, 10.0), (0.0, 25.0, 50.0), (-25.0, 0.0, 90.0)
    assert numbered(limb, high, low, middle) == [low, middle, high]


def test_markers_at_one_height_are_numbered_by_angle_from_anterior_over_left(limb):
    front, left, back, right = (0.0, -25.0, 51.0), (25.0, 0.0, 53.0), (0.0, 25.0, 50.0), (-25.0, 0.0, 52.0)
    below, above = (1.0, 25.0, 20.0), (2.0, -25.0, 80.0)
    assert numbered(limb, right, above, back, left, below, front) == [below, front, left, back, right, above]


@pytest.mark.parametrize("aside", [-3.0, -0.01, 0.0, 3.0])
def test_a_marker_in_front_is_the_first_wherever_its_middle_was_found(limb, aside):
    front, left, right = (aside, -25.0, 50.0), (25.0, 0.0, 50.0), (-25.0, 0.0, 50.0)
    assert numbered(limb, left, right, front) == [front, left, right]


def test_no_markers_give_no_numbers(limb):
    assert number_markers(np.zeros((0, 3)), np.zeros(0), limb, limb.values) == ()


def test_four_markers_are_found_and_the_skin_under_them_stays_whole():
    places = ((0.0, 38.5, -8.0), (44.5, 0.0, -8.0), (-44.5, 0.0, 12.0), (0.0, -38.5, 12.0))
    image, _ = Limb(markers=places).image(shape=(108, 96, 14))
    found = segment_limb(image)
    expected = [places[n] for n in (1, 0, 3, 2)]
    np.testing.assert_allclose([each.position for each in found.markers], expected, atol=1.5)
    plain, _ = Limb().image(shape=(108, 96, 14))
    without = segment_limb(plain).skin.values
    assert (without & ~found.skin.values).sum() < 0.001 * without.sum()
    assert (found.skin.values & ~without).sum() < 0.002 * without.sum()


def test_a_limb_without_markers_has_none():
    image, _ = Limb().image(shape=(104, 92, 10), samples=1)
    assert segment_limb(image).markers == ()
