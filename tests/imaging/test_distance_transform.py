"""Distances to masks, against SciPy's transform and the definition."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from limbcli.imaging.distance_transform import distance_to

# Both are sums of the same squares; they differ by rounding where two voxels are equally near.
_ROUNDING = 1e-12


@pytest.mark.parametrize("shape", [(31, 17), (9, 12, 7), (1, 8, 5), (6, 1), (1, 1)])
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.486, 0.7, 3.0), (0.5, 2.0, 1e6)])
def test_distance_is_that_of_scipy(shape: tuple[int, ...], spacing: tuple[float, ...]) -> None:
    rng = np.random.default_rng(7)
    for share in (0.02, 0.3, 0.9):
        mask = rng.random(shape) < share
        mask.flat[rng.integers(mask.size)] = True
        expected = ndimage.distance_transform_edt(~mask, sampling=spacing[: len(shape)])
        found = distance_to(mask, np.array(spacing[: len(shape)]))
        np.testing.assert_allclose(found, expected, rtol=_ROUNDING, atol=0)


def test_a_section_of_a_volume_is_read_as_it_lies() -> None:
    volume = np.zeros((4, 5, 6), bool)
    volume[1, 2, 3] = True
    found = distance_to(volume[:, :, 3], np.array([3.0, 2.0]))
    i, j = np.indices((4, 5))
    np.testing.assert_array_equal(found, np.sqrt((3.0 * (i - 1)) ** 2 + (2.0 * (j - 2)) ** 2))


def test_nothing_is_infinitely_far() -> None:
    assert (distance_to(np.zeros((3, 4, 2), bool), np.ones(3)) == np.inf).all()
