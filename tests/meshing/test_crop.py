"""Where the local model ends."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.meshing.crop import crop_planes, within
from limbcli.meshing.domain import CLEARANCE, make_domain
from limbcli.meshing.frame import site_frame
from limbcli.meshing.mending import Limb, mend
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_model import MeshOptions, SiteModel, site_model

PROBE = ProbeShape(40.0, 14.0, 3.0)


def planes_at(limb: Limb, height: float, axis: str = "transverse", margin: float = 40.0):
    frame = site_frame(limb, np.array([0.0, 42.0, height]), axis, PROBE)
    return crop_planes(limb.moved(frame.to_model), PROBE, margin)


def test_cuts_lie_margin_beyond_the_face(leg):
    assert {each.name: each.offset for each in planes_at(leg, 0.0)} == pytest.approx({"y-": 47.0, "y+": 47.0})
    assert {each.name: each.offset for each in planes_at(leg, 0.0, "axial")} == pytest.approx(
        {"x-": 60.0, "x+": 60.0}
    )


def test_a_limb_hardly_wider_than_the_crop_is_kept_whole(leg):
    assert not [each for each in planes_at(leg, 0.0) if each.name.startswith("x")]
    assert {each.name for each in planes_at(leg, 0.0, margin=10.0)} == {"x-", "x+", "y-", "y+"}


def test_near_the_end_of_the_images_the_end_is_the_cut(leg):
    names = [each.name for each in planes_at(leg, 60.0)]
    assert sorted(names) == ["flat", "y-"]


def test_near_the_round_end_of_a_limb_nothing_is_cut(make_tube, make_ball):
    ball = mend(make_ball((0, 0, 0), 45.0), [])
    frame = site_frame(ball, np.array([0.0, 45.0, 0.0]), "axial", PROBE)
    assert crop_planes(ball.moved(frame.to_model), PROBE, 40.0) == ()


@pytest.mark.parametrize("depth", [0.3, -0.4])
def test_bone_touching_or_piercing_the_skin_is_pushed_inside(make_tube, depth):
    """A bone whose crest is `depth` mm below the skin (negative: outside it)."""
    skin = make_tube((0, 0, -60), (0, 0, 60), (40, 40), around=60)
    bone = make_tube((0, 40 - 10 - depth, -70), (0, 40 - 10 - depth, 70), (10, 10))
    limb = mend(skin, [bone])
    frame = site_frame(limb, np.array([0.0, 40.0, 0.0]), "axial", PROBE)
    local = limb.moved(frame.to_model)
    domain = make_domain(local, crop_planes(local, PROBE, 20.0), spacing=1.5)
    (note,) = (each for each in domain.notes if "pushed inside" in each)
    assert float(note.split("up to ")[1].split(" mm")[0]) == pytest.approx(CLEARANCE - depth, abs=0.15)
    on_bone = np.abs(domain.bone.values) < 0.5
    inside = within(domain.bone.grid.points().reshape(-1, 3), domain.planes, slack=-2.0)
    on_bone &= inside.reshape(on_bone.shape)
    assert domain.skin.values[on_bone].max() < -CLEARANCE + 0.8


def round_limb(make_tube, *bones) -> SiteModel:
    """A coarse model of a site on a round skin over these bones."""
    skin = make_tube((0, 0, -60), (0, 0, 60), (40, 40), around=60)
    options = MeshOptions(element="tet4", margin=15.0, sizes=Sizes(3.5, 9.0))
    return site_model(mend(skin, list(bones)), (0.0, 40.0, 0.0), "axial", PROBE, options)


@pytest.fixture(scope="module")
def without_bone_mm3(make_tube) -> float:
    return round_limb(make_tube).quality.volume_mm3


@pytest.mark.slow
@pytest.mark.parametrize("below", [6.0, 20.0])
def test_a_bone_that_no_cut_meets_is_held_in_the_model(make_tube, make_ball, without_bone_mm3, below):
    """A kneecap lies whole in the tissue: its volume is no tissue, and its surface is bone."""
    bone = make_ball((0, 30 - below, 0), 10.0)
    made = round_limb(make_tube, bone)
    taken = without_bone_mm3 - made.quality.volume_mm3
    assert taken == pytest.approx(bone.volume, rel=0.25)  # chords of a ball are within it
    held = made.model.mesh.points[made.model.mesh.node_sets["bone"]]
    centre = [0.0, 0.0, -below - 10.0]
    assert np.linalg.norm(held - centre, axis=1) == pytest.approx(np.full(len(held), 10.0), abs=0.5)
    assert made.checks.skin_bone_mm == pytest.approx(below, abs=0.2)


@pytest.mark.slow
def test_a_site_right_over_such_a_bone_meshes(make_tube):
    skin = make_tube((0, 0, -60), (0, 0, 60), (40, 40), around=60)
    bone = make_tube((0, 29.7, -70), (0, 29.7, 70), (10, 10))
    made = site_model(
        mend(skin, [bone]), (0.0, 40.0, 0.0), "axial", PROBE, MeshOptions(margin=15.0, sizes=Sizes(3.5, 9.0))
    )
    assert made.quality.min_angle_under_probe_deg >= 8
    assert made.quality.min_angle_deg >= 4
    assert made.checks.thinnest_under_probe_mm == pytest.approx(CLEARANCE, abs=0.5)


@pytest.mark.slow
def test_torn_and_overlapping_surfaces_mesh(make_tube, rng):
    skin = make_tube((0, 0, -60), (0, 0, 60), (40, 42), around=60)
    torn = skin.part(rng.random(len(skin.faces)) > 0.01)
    bones = [make_tube((x, 0, -70), (x, 0, 70), (9, 9)) for x in (-6.0, 6.0)]
    made = site_model(
        mend(torn, bones), (0.0, 41.0, 0.0), "transverse", PROBE, MeshOptions(margin=15.0, sizes=Sizes(4, 10))
    )
    assert made.quality.min_angle_deg >= 4
    lens = 81 * 2 * np.arccos(6 / 9) - 12 * np.sqrt(81 - 36)
    exact = (np.pi * 41**2 - 2 * np.pi * 81 + lens) * 2 * (7 + 15)
    assert made.quality.volume_mm3 == pytest.approx(exact, rel=0.03)
