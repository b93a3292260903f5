"""The scene that a page turns is the model: points, displacements and facets come back from it."""

from __future__ import annotations

import base64

import numpy as np
import pytest

from limbcli.reporting.figures.deformed import DeformedState
from limbcli.reporting.figures.scene import pressure_scene, scene_of


@pytest.fixture
def state(rng) -> DeformedState:
    """Two tetrahedra, a skin facet, and a probe of one quadrilateral above them."""
    points = np.array([[0.0, -1, 0], [2, -1, 0], [0, 1, 0], [0, 0, -2], [2, 2, -1],
                       [-3, -3, 1], [3, -3, 1], [3, 3, 1], [-3, 3, 1]])  # fmt: skip
    u = rng.normal(0, 0.4, points.shape)
    u[5:] = np.nan
    return DeformedState(
        points=points, displacement=u, kind="tet4", cells=np.array([[0, 1, 2, 3], [1, 4, 2, 3]]),
        skin={"tri3": np.array([[0, 1, 2]])}, bone={}, probe={"quad4": np.array([[5, 6, 7, 8]])},
        probe_shift=np.array([0.0, 0.0, -1.5]), depth=1.5,
    )  # fmt: skip


def unpacked(part: dict, name: str, kind: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(part[name]), kind)


def test_points_and_displacements_come_back_to_a_thousandth(state):
    scene = scene_of(state)
    skin = next(each for each in scene["parts"] if each["name"] == "skin")
    points = unpacked(skin, "points", "<i2").reshape(-1, 3) * scene["step_mm"] + scene["origin_mm"]
    moved = unpacked(skin, "displacement", "<i2").reshape(-1, 3) * scene["displacement_step_mm"]
    np.testing.assert_allclose(points, state.points[:3], atol=1e-3)
    np.testing.assert_allclose(moved, state.displacement[:3], atol=1e-3)
    assert unpacked(skin, "triangles", "<u4").tolist() == [0, 1, 2]
    assert len(unpacked(skin, "edges", "<u4")) == 6


def test_skin_is_coloured_by_its_pressure(state):
    pressure = np.array([0.0, np.nan, 20.0])
    scene = pressure_scene(state.points[:3], state.displacement[:3], np.array([[0, 1, 2]]), pressure)
    (skin,) = scene["parts"]
    assert scene["field_kpa"] == 20.0
    np.testing.assert_allclose(unpacked(skin, "values", "<u2") / 65535, [0.0, 0.0, 1.0])


def test_probe_moves_as_a_body_and_elements_keep_their_own_edges(state):
    scene = scene_of(state)
    probe = next(each for each in scene["parts"] if each["name"] == "probe")
    moved = unpacked(probe, "displacement", "<i2").reshape(-1, 3) * scene["displacement_step_mm"]
    np.testing.assert_allclose(moved, np.tile([0, 0, -1.5], (4, 1)), atol=1e-3)
    assert len(unpacked(probe, "triangles", "<u4")) == 6
    assert len(unpacked(probe, "edges", "<u4")) == 8, "four sides, no diagonal"
    assert not probe["coloured"]


def test_field_is_the_largest_displacement_of_what_is_coloured(state):
    most = np.linalg.norm(state.displacement[:5], axis=1).max()
    assert 0 < scene_of(state)["field_mm"] <= most + 1e-9
