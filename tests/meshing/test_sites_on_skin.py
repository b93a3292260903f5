"""Sites against the skin: how far, where instead, and whether the signs are turned."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.meshing.sites_on_skin import MOST_MOVED_MM, place_fault, place_problems
from limbcli.meshing.surfaces import Triangles


@pytest.fixture
def skin() -> Triangles:
    """A ball of radius 30 mm about (60, 80, 0): turned in x and y it lies elsewhere."""
    n = 40
    theta, phi = np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, 2 * n, endpoint=False)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    points = 30 * np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1) + [60, 80, 0]
    k = np.arange(points[..., 0].size).reshape(t.shape)
    a, b = k[:-1], k[1:]
    c, d = np.roll(k, -1, 1)[:-1], np.roll(k, -1, 1)[1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([c, b, d], -1).reshape(-1, 3)])
    points, faces = points.reshape(-1, 3), faces
    areas = np.linalg.norm(np.cross(points[faces[:, 1]] - points[faces[:, 0]],
                                    points[faces[:, 2]] - points[faces[:, 0]]), axis=1)  # fmt: skip
    return Triangles(points, faces[areas > 1e-9])


def test_a_place_on_the_skin_has_no_fault(skin):
    assert place_fault(skin, np.array([90.0, 80.0, 0.0])) is None
    assert place_fault(skin, np.array([92.0, 80.0, 0.0])) is None


def test_near_is_moved_and_said_far_is_an_error_with_both_points(skin):
    near = place_fault(skin, np.array([94.0, 80.0, 0.0]))
    assert near is not None
    assert near.usable
    far = place_fault(skin, np.array([90.0 + MOST_MOVED_MM + 0.5, 80.0, 0.0]))
    assert far is not None
    assert not far.usable
    assert "[95.5, 80.0, 0.0] is given" in far.what
    np.testing.assert_allclose(far.nearest, [90, 80, 0], atol=0.3)
    assert str(round(far.nearest[0], 1)) in far.fix


def test_places_inside_the_limb_are_off_the_skin_as_well(skin):
    fault = place_fault(skin, np.array([60.0, 80.0, 10.0]))
    assert fault is not None
    assert fault.distance == pytest.approx(20.0, abs=0.3)


def test_turned_signs_are_recognised_and_the_other_point_is_given(skin):
    (problem,) = place_problems(skin, {"p1": np.array([-90.0, -80.0, 0.0])}, where="case.toml")
    assert problem.severity == "error"
    assert "RAS, not LPS" in problem.what
    assert "position_mm = [90.0, 80.0, 0.0]" in problem.fix
    (other,) = place_problems(skin, {"p1": np.array([-90.0, 80.0, 0.0])}, where="case.toml")
    assert "RAS" not in other.what, "only one sign is turned: that is no other frame"
