"""Numbers of skin markers, and what is no marker."""

from __future__ import annotations

import numpy as np
import pytest
from limb_images import Limb
from scipy import ndimage

from limbcli.imaging.markers import _BALL, _body, number_markers
from limbcli.imaging.segmentation import segment_limb
from limbcli.imaging.signed_distance import distance_to
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


@pytest.mark.parametrize("spacing", [(0.7, 0.486, 3.0), (1.0, 1.0, 1.0)])
def test_the_limb_without_markers_is_interpolated_wherever_it_matters(rng, spacing):
    """Against interpolation at every voxel of the limb's box."""
    h, shape = np.array(spacing), np.ceil(np.array((92.0, 90.0, 36.0)) / spacing).astype(int)
    x, y, z = ((np.indices(shape).T - (shape - 1) / 2) * h).T
    limb = (np.hypot(x, 1.2 * y) < 32.0) | (np.hypot(x - 32.0, y) + np.abs(z) < 7.0)
    limb |= ndimage.gaussian_filter(rng.standard_normal(shape), 3.0 / h) > 0.09
    limb[[0, -1]], limb[:, [0, -1]] = False, False
    step = np.maximum(1, np.floor(1.5 / h)).astype(int)
    i, j, k = (np.flatnonzero(limb.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1)))
    margin = 1 + np.ceil(4.0 / h).astype(int)
    box = tuple(
        slice(max(0, each[0] - m), min(n, each[-1] + 1 + m))
        for each, m, n in zip((i, j, k), margin, shape, strict=True)
    )
    fine = limb[box]
    beyond = int(np.ceil(_BALL / (h * step)[2])) + 1
    wide = np.pad(fine[:: step[0], :: step[1], :: step[2]], ((0, 0), (0, 0), (beyond, beyond)), mode="edge")
    core = distance_to(~wide, h * step) > _BALL
    near = (distance_to(core, h * step) - _BALL)[:, :, beyond : wide.shape[2] - beyond]
    at = [np.clip(np.arange(n) / s, 0, m - 1) for n, s, m in zip(fine.shape, step, near.shape, strict=True)]
    expected = np.zeros_like(limb)
    expected[box] = (ndimage.map_coordinates(near, np.meshgrid(*at, indexing="ij"), order=1) <= 0) & fine
    assert 0 < expected.sum() < limb.sum()
    np.testing.assert_array_equal(_body(limb, h), expected)
