"""Round limbs and bones as deep as was measured: exact by construction."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.meshing.frame import closest_on_triangles
from limbcli.meshing.mending import mend
from limbcli.meshing.rods import BoneHit, Rod, limb_axis, rods_for, tube
from limbcli.meshing.surfaces import Triangles


def closed(surface) -> bool:
    made = Triangles(surface.points, surface.faces)
    return made.is_closed and made.volume > 0


def test_a_tube_has_the_circumference_and_the_volume_of_its_numbers():
    radius = 320 / (2 * np.pi)
    surface = tube(radius, 300.0).surface(edge=2.0)
    assert closed(surface)
    ring = surface.points[np.abs(surface.points[:, 2] + 150.0) < 1e-9][:-1]
    around = np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1).sum()
    assert around == pytest.approx(320.0, rel=2e-4)  # a chord of 2 mm is short by (2/51)^2/24
    assert surface.volume == pytest.approx(np.pi * radius**2 * 300.0, rel=1e-3)


def test_a_rod_meets_the_beam_at_its_depth():
    rod = Rod(np.array([0.0, -20.0, 0.0]), np.array([0.0, 0, 1]), 8.0, -50.0, 50.0, np.array([0.0, -1, 0]))
    point = np.array([0.0, -50.0, 3.0])
    assert rod.depth_under(point, np.array([0.0, 1, 0])) == pytest.approx(22.0, abs=1e-9)
    assert rod.depth_under(point + np.array([9.0, 0, 0]), np.array([0.0, 1, 0])) is None
    surface = rod.surface(edge=1.5)
    nearest = closest_on_triangles(point, surface.corners)
    assert np.linalg.norm(nearest - point, axis=1).min() == pytest.approx(22.0, abs=1e-9)
    assert closed(surface)


@pytest.fixture(scope="module")
def tapered(make_tube):
    return mend(make_tube((0, 0, -100), (0, 10, 100), (40.0, 48.0)), [])


UP = np.array([0.0, 0.0, 1.0])


def seen_on(limb, angle_deg: float, depth: float, z: float = 0.0) -> BoneHit:
    """On the tube of 44 mm round (0, 5, 0), straight in."""
    normal = np.array([np.sin(np.radians(angle_deg)), -np.cos(np.radians(angle_deg)), 0.0])
    middle = np.array([0.0, 5.0 + z / 20, z])
    return BoneHit(middle + (44.0 + z / 25) * normal, normal, depth)


def test_the_axis_is_the_limbs_own_near_the_site(tapered):
    axis = limb_axis(tapered, np.array([[0.0, -39.0, 0.0]]), UP)
    assert axis == pytest.approx(np.array([0.0, 0.05, 1.0]) / np.hypot(1, 0.05), abs=3e-3)


def test_sites_that_look_at_one_bone_share_it_and_others_have_their_own(tapered):
    seen = {"a": seen_on(tapered, 0, 20.0), "b": seen_on(tapered, 8, 20.4), "c": seen_on(tapered, 180, 12.0)}
    axis = limb_axis(tapered, np.array([each.point for each in seen.values()]), UP)
    found = rods_for(seen, tapered, axis, 10.0)
    assert [names for _, names in found] == [["a", "b"], ["c"]]
    for rod, names in found:
        for name in names:
            depth = rod.depth_under(seen[name].point, -seen[name].normal)
            assert depth == pytest.approx(seen[name].depth, abs=0.5 if len(names) > 1 else 1e-6)


@pytest.mark.slow
def test_bones_are_the_same_in_whatever_order_sites_are_listed(tapered):
    """The first listed had taken in its neighbour, though another lay nearer."""
    seen = {"a": seen_on(tapered, 0, 15.0), "b": seen_on(tapered, 0, 22.0), "c": seen_on(tapered, 0, 27.0)}
    for names in itertools.permutations(seen):
        found = rods_for({name: seen[name] for name in names}, tapered, np.array([0, 0.05, 1.0]), 9.0)
        assert sorted(sorted(group) for _, group in found) == [["a"], ["b", "c"]]


def test_a_bone_that_does_not_fit_is_refused_with_its_numbers(tapered):
    with pytest.raises(CaseError, match=r"a bone of 14 mm radius, 70 mm below the skin, does not lie within"):
        rods_for({"a": seen_on(tapered, 0, 70.0)}, tapered, UP, 14.0)


def test_a_bone_near_the_other_side_is_as_long_as_the_limb(tapered):
    rod, _ = rods_for({"a": seen_on(tapered, 0, 55.0)}, tapered, np.array([0, 0.05, 1.0]), 14.0)[0]
    assert rod.high - rod.low > 150.0


def test_a_rod_stays_inside_and_goes_through_cut_ends(tapered):
    seen = {"a": seen_on(tapered, 0, 20.0)}
    rod, _ = rods_for(seen, tapered, np.array([0.0, 0.0, 1.0]), 10.0)[0]
    points = rod.surface(edge=3.0).points
    radius = np.hypot(points[:, 0], points[:, 1] - 5.0 - points[:, 2] / 20)
    assert (radius < 44.0 + points[:, 2] / 25 - 5.0).all()
    assert rod.low < -95.0
    assert rod.high > 95.0
