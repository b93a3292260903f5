"""Surfaces from anywhere."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import MeshError
from limbcli.meshing.mending import mend, without_cavities
from limbcli.meshing.surfaces import Triangles, boundary_loops, join


def test_open_proximal_end_is_closed_and_becomes_a_cut(make_tube):
    open_top = make_tube((0, 0, 0), (0, 0, 150), (40, 45))
    open_top = open_top.part(open_top.centroids[:, 2] < 149.9)
    limb = mend(open_top, [make_tube((5, 5, 10), (5, 5, 148), (9, 9))])
    assert boundary_loops(limb.skin) == []
    assert [each.name for each in limb.ends][:1] == ["open"]
    assert limb.ends[0].normal == pytest.approx([0, 0, 1], abs=1e-6)
    assert limb.ends[0].offset == pytest.approx(150 - 1.5)
    assert any("rim closed" in note for note in limb.notes)


def test_a_hole_in_the_side_is_closed_and_cuts_nothing_off(make_tube):
    skin = make_tube((0, 0, -120), (0, 0, 120), (45, 45), around=90, along=60)
    x, y, z = skin.centroids.T
    limb = mend(skin.part(~((np.hypot(x, z + 20) < 25) & (y < 0))), [])
    assert boundary_loops(limb.skin) == []
    assert [each.name for each in limb.ends] == ["flat", "flat"]
    assert limb.skin.volume == pytest.approx(skin.volume, rel=0.02)


def test_a_slanted_open_end_is_an_end_still(make_tube):
    skin = make_tube((0, 0, 0), (0, 0, 200), (40, 45), around=60, along=60)
    limb = mend(skin.part(skin.centroids @ np.array([0.0, 0.5, 0.866]) < 130.0), [])
    assert [each.name for each in limb.ends] == ["open"]
    assert limb.ends[0].normal == pytest.approx([0.0, 0.5, 0.866], abs=0.05)


def test_flat_ends_of_a_scan_become_cuts_and_round_ends_do_not(leg, make_ball):
    assert sorted(round(float(each.normal[2])) for each in leg.ends) == [-1, 1]
    assert mend(make_ball((0, 0, 0), 40.0), []).ends == ()


@pytest.mark.parametrize("with_bone", [True, False])
def test_the_flat_ends_of_a_limb_that_is_wider_than_long_are_not_its_sides(make_tube, with_bone):
    bones = [make_tube((0, -10, -40), (0, -10, 40), (12, 12))] if with_bone else []
    limb = mend(make_tube((0, 0, -40), (0, 0, 40), (80, 80), around=120), bones)
    assert sorted(each.normal[2] for each in limb.ends) == pytest.approx([-1.0, 1.0])
    assert [each.offset for each in limb.ends] == pytest.approx([38.5, 38.5])


def test_bodies_in_one_file_are_told_apart(make_tube):
    skin = make_tube((0, 0, 0), (0, 0, 150), (40, 45))
    bones = [make_tube((x, 0, 10), (x, 0, 140), (8, 8)) for x in (-15, 15)]
    limb = mend(join([skin, *bones]), [])
    assert len(limb.bones) == 2
    assert limb.skin.volume == pytest.approx(skin.volume, rel=1e-6)


def test_stray_triangles_are_dropped_and_told(make_tube):
    skin = make_tube((0, 0, 0), (0, 0, 150), (40, 45))
    stray = Triangles(np.array([[60.0, 0, 0], [61, 0, 0], [60, 1, 0]]), np.array([[0, 1, 2]]))
    limb = mend(join([skin, stray]), [])
    assert len(limb.skin.faces) == len(skin.faces)
    assert any("stray" in note for note in limb.notes)


def test_faces_turned_inward_are_turned_back(make_tube):
    skin = make_tube((0, 0, 0), (0, 0, 150), (40, 45))
    mixed = Triangles(skin.points, skin.faces.copy())
    mixed.faces[::7] = mixed.faces[::7, ::-1]
    for wrong in (skin.flipped(), mixed):
        assert mend(wrong, []).skin.volume == pytest.approx(skin.volume, rel=1e-6)


def test_a_surface_in_metres_is_refused(make_tube):
    with pytest.raises(MeshError, match="check the unit"):
        mend(make_tube((0, 0, 0), (0, 0, 0.15), (0.04, 0.045)), [])


def test_two_sheets_that_meet_in_an_edge_are_left_alone(make_tube):
    skin = make_tube((0, 0, 0), (0, 0, 150), (40, 45))
    a, b = skin.faces[400][:2]
    middle = skin.points[[a, b]].mean(axis=0)
    out = middle * [1, 1, 0] / np.linalg.norm(middle[:2])
    along = skin.points[b] - skin.points[a]
    side = np.cross(along, out) / np.linalg.norm(along)
    tent = np.array([middle + 2 * out - side, middle + 2 * out + side])
    p, q = len(skin.points), len(skin.points) + 1
    faces = np.array([[a, b, p], [b, a, q], [b, q, p], [a, p, q]])
    if Triangles(np.vstack([skin.points, tent]), faces).volume < 0:
        faces = faces[:, ::-1]
    both = Triangles(np.vstack([skin.points, tent]), np.vstack([skin.faces, faces]))
    limb = mend(both, [])
    assert len(limb.skin.faces) == len(both.faces)
    assert not any("non-manifold" in note for note in limb.notes)


def test_a_body_within_another_is_a_cavity_and_one_beside_or_upon_it_is_not(make_tube):
    bone = make_tube((0, 0, 0), (0, 0, 200), (14, 12))
    marrow = make_tube((0, 0, 20), (0, 0, 180), (8, 7)).flipped()
    beside = make_tube((40, 0, 20), (40, 0, 180), (5, 5))
    assert without_cavities([bone, marrow, beside]) == [bone, beside]
    assert without_cavities([bone, bone]) == [bone, bone]
