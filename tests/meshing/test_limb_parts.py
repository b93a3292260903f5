"""Named parts of a limb: where they lie, and what is said of those that cannot be placed."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.meshing.facets import divided
from limbcli.meshing.limb_parts import LANDMARKS, PATCHES, limb_frame, limb_parts
from limbcli.meshing.mending import mend
from limbcli.meshing.surfaces import Triangles
from tests.meshing.stump import stump

TOP = 158.5


def parts_of(surfaces, *, side="left", top=TOP, bottom=-np.inf):
    bones = {name: each for name, each in surfaces.items() if name != "skin"}
    limb = mend(surfaces["skin"], list(bones.values()))
    frame = limb_frame(limb, side)
    skin = Triangles(*divided(surfaces["skin"].points, surfaces["skin"].faces, 5.0))
    return limb_parts(frame, skin, bones, top=top, bottom=bottom), skin, frame


@pytest.fixture(scope="module")
def whole():
    return parts_of(stump())


def test_all_patches_are_there_and_disjoint(whole):
    found, skin, _ = whole
    assert tuple(found.patches) == PATCHES
    assert not found.missing
    assert np.sum(list(found.patches.values()), axis=0).max() == 1
    assert all(len(each) == len(skin.faces) for each in found.patches.values())


def test_patches_lie_on_their_side_of_the_limb(whole):
    """A left limb: its lateral side is +x, its front -y."""
    found, skin, _ = whole
    middle = {name: skin.centroids[mask].mean(axis=0) for name, mask in found.patches.items()}
    assert middle["fibular_head"][0] > 25
    assert middle["patellar_tendon"][1] < -30
    assert middle["tibial_crest"][1] < -30
    assert middle["popliteal"][1] > 25
    assert middle["distal_end"][2] < 20
    assert 78 < middle["patellar_tendon"][2] < 112
    assert abs(middle["tibial_end"][2] - 25) < 20


def test_the_head_of_the_fibula_is_on_the_other_side_of_a_right_limb():
    surfaces = {
        name: Triangles(each.points * [-1, 1, 1], each.faces[:, ::-1]) for name, each in stump().items()
    }
    found, skin, frame = parts_of(surfaces, side="right")
    assert frame.lateral[0] < -0.99
    assert skin.centroids[found.patches["fibular_head"]].mean(axis=0)[0] < -25


def test_landmarks_are_on_their_bones(whole):
    marks = whole[0].landmarks
    assert set(marks) == set(LANDMARKS)
    assert marks["tibial_end"][2] == pytest.approx(25, abs=1)
    assert marks["fibular_head"][2] == pytest.approx(98, abs=1)
    assert marks["patella_lower_pole"][2] == pytest.approx(112, abs=1)
    assert marks["tibial_tuberosity"][2] == pytest.approx(78, abs=1)


def test_a_thigh_has_an_end_and_says_what_it_lacks():
    surfaces = {name: each for name, each in stump().items() if name in ("skin", "bone_femur")}
    found, _, _ = parts_of(surfaces)
    assert set(found.patches) == {"distal_end"}
    assert found.missing["patellar_tendon"] == "no bone is named tibia"
    assert found.missing["fibular_head"] == "no bone is named fibula"


def test_a_knee_beyond_the_cut_is_not_invented():
    found, _, _ = parts_of(stump(), top=90.0)
    assert {"patellar_tendon", "popliteal", "fibular_head"} <= set(found.missing)
    assert "beyond the proximal cut" in found.missing["popliteal"]
    assert "tibial_crest" in found.patches


def test_a_cut_distal_end_has_no_end():
    found, _, _ = parts_of(stump(), bottom=30.0)
    assert "cut at its distal end" in found.missing["distal_end"]
    assert "tibial_end" in found.missing


def test_an_ankle_is_no_tibial_end():
    foot = Triangles(
        stump()["bone_patella"].points * [1, 1, 0.1] - [0, -28, 8], stump()["bone_patella"].faces
    )
    found, _, _ = parts_of({**stump(), "bone_5": foot})
    assert "ankle" in found.missing["tibial_end"]
