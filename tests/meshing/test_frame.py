"""The frame of a site against shapes whose normals and first touch are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.meshing import frame
from limbcli.meshing.frame import SiteFrame, probe_axis, proximal_direction, site_frame, skin_point_at
from limbcli.meshing.mending import Limb, long_axis
from limbcli.meshing.probe import ProbeShape

PROBE = ProbeShape(50.0, 14.0, 3.0)


def test_frame_on_a_tapered_limb(leg):
    frame = site_frame(leg, np.array([0.0, 44.0, 0.0]), "axial", PROBE)
    taper = np.arctan2(45 - 35, 200)
    assert frame.proximal == pytest.approx([0, 0, 1], abs=0.02)
    assert frame.normal == pytest.approx([0, np.cos(taper), -np.sin(taper)], abs=0.02)
    rotation = frame.to_model[:3, :3]
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert frame.long_axis @ frame.proximal > 0.99
    assert frame.to_patient @ frame.to_model == pytest.approx(np.eye(4), abs=1e-9)


def test_transverse_grows_along_proximal_cross_normal(leg):
    frame = site_frame(leg, np.array([0.0, 40.0, 0.0]), "transverse", PROBE)
    assert frame.long_axis == pytest.approx(np.cross([0, 0, 1], frame.normal), abs=0.03)


def test_first_touch_is_where_face_and_skin_meet(leg):
    frame = site_frame(leg, np.array([0.0, 40.0, 0.0]), "transverse", PROBE)
    local = leg.skin.moved(frame.to_model).points
    near = (np.abs(local[:, 0]) < 25) & (np.abs(local[:, 1]) < 7)
    assert local[near, 2].max() == pytest.approx(0.0, abs=0.35)  # between nodes the chord is flat
    assert local[near, 2].max() < 0.03  # the face is sampled every half millimetre


def test_edge_of_the_probe_can_touch_first(make_tube):
    # Across a limb no thicker than the probe, tilted by force of the vector, the face still rests on it.
    skin = make_tube((0, 0, -80), (0, 0, 80), (30, 30), around=120)
    limb = Limb(skin, (), (), ())
    frame = site_frame(limb, np.array([0.0, 30, 0]), "transverse", PROBE)
    top = frame.to_patient @ np.array([0, 0, 0, 1.0])
    assert np.hypot(*top[:2]) == pytest.approx(30.0, abs=0.05)


@pytest.mark.parametrize("slope_deg", [-9.0, 4.0, 9.0])
def test_a_long_axis_that_was_measured_is_kept_and_leans_the_probe(leg, slope_deg):
    upright = site_frame(leg, np.array([0.0, 40.0, 0.0]), "transverse", PROBE)
    slope = np.radians(slope_deg)
    held = np.cos(slope) * upright.long_axis + np.sin(slope) * upright.normal
    frame = site_frame(leg, np.array([0.0, 40.0, 0.0]), tuple(2.5 * held), PROBE)
    assert frame.long_axis == pytest.approx(held, abs=1e-12)
    assert frame.slope_deg == pytest.approx(slope_deg, abs=0.05)  # the footprint's mean normal is sampled
    assert frame.to_model[:3, :3] @ frame.to_model[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
    assert frame.normal @ upright.normal == pytest.approx(np.cos(slope), abs=1e-3)  # leans no other way


def test_a_long_axis_far_out_of_the_skin_tells_a_direction_only(leg):
    upright = site_frame(leg, np.array([0.0, 40.0, 0.0]), "transverse", PROBE)
    slope = np.radians(25.0)
    rough = np.cos(slope) * upright.long_axis + np.sin(slope) * upright.normal
    frame = site_frame(leg, np.array([0.0, 40.0, 0.0]), tuple(rough), PROBE)
    assert frame.long_axis == pytest.approx(upright.long_axis, abs=1e-3)
    assert frame.normal == pytest.approx(upright.normal, abs=1e-3)
    assert frame.slope_deg == pytest.approx(25.0, abs=0.05)


def test_a_vector_is_laid_into_the_skin():
    x = probe_axis((0.0, 1.0, 1.0), np.array([0, 0, 1.0]), np.array([0, 1.0, 0]))
    assert x == pytest.approx([0, 0, 1])


@pytest.mark.parametrize("axis", ["sideways", (0.0, 1.0, 0.0)])
def test_impossible_long_axis_is_refused(axis):
    with pytest.raises(CaseError, match="long"):
        probe_axis(axis, np.array([0, 0, 1.0]), np.array([0, 1.0, 0]))


def test_site_far_from_skin_is_refused(leg):
    with pytest.raises(CaseError, match="mm from the skin"):
        site_frame(leg, np.array([0.0, 150.0, 0.0]), "axial", PROBE)


def test_long_axis_points_to_the_head_whatever_the_surface_order(leg):
    turned = leg.moved(np.diag([1.0, -1, -1, 1]))
    assert proximal_direction(turned)[2] > 0.99


def test_a_thin_bone_that_lies_across_the_limb_does_not_turn_it(leg, make_tube):
    fibula = make_tube((-22, 2, -40), (-5, 2, 40), (1, 1))  # by 12 degrees, and the most elongated body
    axis = proximal_direction(replace(leg, bones=(*leg.bones, fibula)))
    assert axis == pytest.approx(proximal_direction(leg), abs=1e-12)


def test_where_the_skin_is_as_wide_as_long_the_largest_bone_tells_the_direction(make_tube):
    skin, thick = make_tube((0, 0, -45), (0, 0, 45), (50, 50)), make_tube((0, 0, -40), (7, 0, 40), (12, 12))
    thin = make_tube((20, 0, -40), (3, 0, 40), (4, 4))
    axis = long_axis([skin, thin, thick])
    assert abs(axis @ [7, 0, 80]) / np.hypot(7, 80) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(("angle", "direction"), [(0, (0, -1)), (90, (1, 0)), (180, (0, 1)), (270, (-1, 0))])
def test_site_by_angle_and_height(leg, angle, direction):
    point = skin_point_at(leg, angle, 100.0)
    assert point[2] == pytest.approx(0.0, abs=1.5)
    assert point[:2] == pytest.approx(40 * np.array(direction), abs=1.0)


def test_no_skin_at_that_height(leg):
    with pytest.raises(CaseError, match="no skin"):
        skin_point_at(leg, 0.0, 1000.0)


def test_the_frames_axes_point_to_sides_of_the_patient():
    """A probe held across a limb at its back: x to the right, y to the head, outward is posterior."""
    to_model = np.eye(4)
    to_model[:3, :3] = [[-1, 0, 0], [0, 0, 1], [0, 1, 0]]
    rows = to_model[:3, :3]
    assert SiteFrame(to_model, np.zeros(3), rows[2], rows[0], rows[1], 0.0).sides == ("right", "head")


def test_of_a_scan_only_the_triangles_near_a_site_are_searched(leg, monkeypatch):
    skin, counts = leg.skin, []
    places = skin.points[::50] + np.random.default_rng(7).normal(scale=30.0, size=skin.points[::50].shape)
    whole = [frame.closest_on_triangles(each, skin.corners) for each in places]
    search = frame.closest_on_triangles
    monkeypatch.setattr(
        frame, "closest_on_triangles", lambda p, corners: counts.append(len(corners)) or search(p, corners)
    )
    for place, points in zip(places, whole, strict=True):
        nearest, _, far = frame.nearest_skin_point(skin, place)
        k = np.argmin(np.linalg.norm(points - place, axis=1))
        assert (nearest == points[k]).all()
        assert far == pytest.approx(np.linalg.norm(points[k] - place), rel=1e-14)
    assert np.median(counts) < 0.3 * len(skin.faces)
