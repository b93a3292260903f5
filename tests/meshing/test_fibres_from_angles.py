"""A fibre direction out of the angles that images show of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from limbcli.errors import CaseError
from limbcli.meshing.fibres_from_angles import ImageAngle, direction_of_angles, mean_axis

PROXIMAL, ACROSS, BEAM = np.array([0.0, 0, 1]), np.array([1.0, 0, 0]), np.array([0.0, 1, 0])


def seen(axis: np.ndarray, lateral: np.ndarray) -> float:
    """The angle under which an image of this lateral axis shows a fibre, deg in (-90, 90]."""
    angle = np.degrees(np.arctan2(axis @ BEAM, axis @ lateral))
    return float((angle + 90.0) % 180.0 - 90.0)


def test_two_images_give_back_any_direction(rng):
    for axis in Rotation.random(200, random_state=rng).apply([0.0, 0.0, 1.0]):
        if abs(axis @ BEAM) < 0.1:
            continue  # in the skin's plane both images show 0 degrees, and tell nothing
        angles = [ImageAngle(each, seen(axis, each), 2.0) for each in (PROXIMAL, ACROSS)]
        try:
            found = direction_of_angles(angles, BEAM, proximal=PROXIMAL)
        except CaseError:
            continue
        assert abs(found.axis @ axis) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.slow
def test_the_deviation_is_that_of_drawn_angles(rng):
    axis = np.array([0.3, 0.4, 0.85]) / np.linalg.norm([0.3, 0.4, 0.85])
    laterals, sigma = (PROXIMAL, ACROSS), (1.5, 2.5)
    reported = direction_of_angles(
        [ImageAngle(each, seen(axis, each), s) for each, s in zip(laterals, sigma, strict=True)],
        BEAM, proximal=PROXIMAL,
    )  # fmt: skip
    off = []
    for _ in range(2000):
        angles = [
            ImageAngle(each, seen(axis, each) + s * rng.standard_normal(), s)
            for each, s in zip(laterals, sigma, strict=True)
        ]
        drawn = direction_of_angles(angles, BEAM, proximal=PROXIMAL).axis
        off.append(np.degrees(np.arccos(min(1.0, abs(drawn @ axis)))))
    assert reported.deviation_deg == pytest.approx(np.sqrt(np.mean(np.square(off))), rel=0.1)


def test_one_image_along_the_limb_takes_its_plane_and_says_so():
    found = direction_of_angles([ImageAngle(PROXIMAL, -20.0, 3.0)], BEAM, proximal=PROXIMAL)
    a = np.radians(20.0)
    np.testing.assert_allclose(found.axis, [0.0, -np.sin(a), np.cos(a)], atol=1e-12)
    assert "not given" in found.how
    assert found.deviation_deg == 3.0


def test_one_image_across_the_limb_tells_no_direction():
    with pytest.raises(CaseError, match="only in an image across the limb"):
        direction_of_angles([ImageAngle(ACROSS, 10.0, 3.0)], BEAM, proximal=PROXIMAL)


def test_two_images_in_which_fibres_lie_flat_fix_no_direction():
    angles = [ImageAngle(PROXIMAL, 2.0, 2.0), ImageAngle(ACROSS, 1.0, 2.0)]
    with pytest.raises(CaseError, match="do not determine a direction"):
        direction_of_angles(angles, BEAM, proximal=PROXIMAL)


def test_the_mean_of_axes_ignores_their_signs(rng):
    axis = np.array([0.2, -0.3, 0.93]) / np.linalg.norm([0.2, -0.3, 0.93])
    drawn = axis + 0.05 * rng.standard_normal((500, 3))
    drawn = drawn / np.linalg.norm(drawn, axis=1, keepdims=True) * rng.choice([-1, 1], 500)[:, None]
    mean, spread = mean_axis(drawn)
    assert abs(mean @ axis) > 0.9999
    assert spread == pytest.approx(np.degrees(0.05 * np.sqrt(2)), rel=0.1)
