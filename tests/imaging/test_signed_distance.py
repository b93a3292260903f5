"""Distances of masks are those over the whole image, although only a box around the mask is looked at."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from limbcli.imaging.signed_distance import REACH, depth_inside, is_near, signed_distance

SPACING = np.array([0.7, 1.3, 4.0])


@pytest.fixture
def mask() -> np.ndarray:
    """Two blobs, one of which touches the image's edge, in the middle slices of an image."""
    i, j, k = np.indices((60, 40, 5))
    blobs = ((i - 40) ** 2 + (j - 18) ** 2 < 90) | ((i - 2) ** 2 + (j - 30) ** 2 < 30)
    return blobs & (k > 0) & (k < 4)


def test_depth_and_nearness_are_those_of_the_whole_image(mask: np.ndarray):
    whole = ndimage.distance_transform_edt(mask, sampling=SPACING)
    outside = ndimage.distance_transform_edt(~mask, sampling=SPACING)
    assert np.array_equal(depth_inside(mask, SPACING), whole)
    for reach in (0.7, 3.0, 9.1):
        assert np.array_equal(is_near(mask, reach, SPACING), outside <= reach)


def test_signed_distance_of_slices_is_that_of_whole_slices(mask: np.ndarray):
    found = signed_distance(mask, SPACING)
    half = 0.5 * SPACING[:2].min()
    for k in range(1, 4):
        inside = ndimage.distance_transform_edt(mask[:, :, k], sampling=SPACING[:2]) - half
        outside = half - ndimage.distance_transform_edt(~mask[:, :, k], sampling=SPACING[:2])
        expected = np.clip(np.where(mask[:, :, k], inside, outside), -REACH, REACH).astype(np.float32)
        assert np.array_equal(found[:, :, k], expected)
    assert (found[:, :, 0] == -REACH).all()


def test_nothing_is_inside_or_near_an_empty_mask():
    empty = np.zeros((4, 5), bool)
    assert not depth_inside(empty, SPACING[:2]).any()
    assert not is_near(empty, 3.0, SPACING[:2]).any()
