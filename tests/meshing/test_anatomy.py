"""Skin and bones that cannot belong together are told from those that can."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import MeshError
from limbcli.meshing.anatomy import limb_problems
from limbcli.meshing.domain import manifold_of
from limbcli.meshing.mending import mend
from limbcli.meshing.sites_on_skin import place_problems
from limbcli.meshing.surfaces import Triangles, join

pytestmark = pytest.mark.slow


@pytest.fixture
def surfaces(make_tube) -> dict[str, Triangles]:
    """A right leg: the fibula towards the patient's right (-x); bones a little longer than the skin."""
    return {
        "skin": make_tube((0, 0, -100), (0, 0, 100), (35, 45)),
        "bone_tibia": make_tube((8, -14, -104), (8, -14, 104), (10, 12)),
        "bone_fibula": make_tube((-18, 2, -100), (-18, 2, 100), (5, 6), around=24),
    }


def moved(body: Triangles, by: tuple[float, float, float]) -> Triangles:
    return Triangles(body.points + np.array(by), body.faces)


def found(surfaces: dict[str, Triangles], limb: str = "right") -> list[tuple[str, str]]:
    return [(each.severity, each.what) for each in limb_problems(surfaces, limb=limb, where="case")]


def test_a_limb_with_bones_that_reach_beyond_its_cut_ends_is_fine(surfaces):
    assert found(surfaces) == []
    open_skin = surfaces["skin"].part(np.abs(surfaces["skin"].centroids[:, 2]) < 99.9)
    assert found({**surfaces, "skin": open_skin}) == []


@pytest.mark.parametrize(
    ("by", "text"),
    [((200, 0, 0), "lies outside the skin"), ((0, 0, 230), "beyond the end"), ((25, 0, 0), "lies outside")],
)
def test_a_bone_elsewhere_is_an_error(surfaces, by, text):
    problems = found({**surfaces, "bone_tibia": moved(surfaces["bone_tibia"], by)})
    assert [each for each in problems if each[0] == "error" and "bone_tibia" in each[1] and text in each[1]]


def test_a_bone_that_looks_out_a_little_is_a_warning(surfaces):
    skin = surfaces["skin"]
    dent = np.where(np.abs(skin.points[:, 2]) < 10, 0.45, 1.0)[:, None]
    dented = Triangles(skin.points * np.hstack([dent, dent, np.ones_like(dent)]), skin.faces)
    problems = found({**surfaces, "skin": dented})
    assert {severity for severity, _ in problems} == {"warning"}
    assert all("outside the skin" in what for _, what in problems)


def test_sizes_of_another_unit_and_swapped_files_are_errors(surfaces):
    ten = {name: Triangles(10 * each.points, each.faces) for name, each in surfaces.items()}
    assert ("error", "cm3") in [(s, w.split()[-1]) for s, w in found(ten)]
    swapped = {**surfaces, "skin": surfaces["bone_tibia"], "bone_tibia": surfaces["skin"]}
    assert any(severity == "error" and "bones fill" in what for severity, what in found(swapped))


def test_soft_tissue_with_holes_for_its_bones_is_no_skin(surfaces):
    """The holes are cut through to the ends, as a soft-tissue segment's are; the bones fill them."""
    soft = manifold_of(surfaces["skin"], "skin") - manifold_of(surfaces["bone_tibia"], "tibia")
    mesh = soft.to_mesh64()
    hollow = Triangles(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, np.int64))
    problems = found({**surfaces, "skin": hollow})
    assert [what for severity, what in problems if severity == "error" and "in a hole of the skin" in what]


def test_a_skin_with_two_walls_is_an_error(surfaces, make_tube):
    inner = make_tube((0, 0, -98), (0, 0, 98), (33, 43)).flipped()
    problems = found({**surfaces, "skin": join([surfaces["skin"], inner])})
    assert any(severity == "error" and "second body" in what for severity, what in problems)


def test_one_bone_given_twice_is_an_error(surfaces):
    problems = found({**surfaces, "bone_fibula": surfaces["bone_tibia"]})
    assert any(severity == "error" and "twice" in what for severity, what in problems)


def test_a_mirrored_limb_is_told_by_its_fibula(surfaces):
    ((severity, what),) = found(surfaces, limb="left")
    assert severity == "warning"
    assert "right leg" in what
    behind = moved(surfaces["bone_fibula"], (26, 30, 0))  # straight behind the tibia: it tells no side
    assert not [what for _, what in found({**surfaces, "bone_fibula": behind}, "left") if "leg" in what]


def test_bones_that_bear_each_others_names_are_told(surfaces):
    swapped = {"bone_tibia": surfaces["bone_fibula"], "bone_fibula": surfaces["bone_tibia"]}
    for limb in ("left", "right"):
        ((severity, what),) = found({**surfaces, **swapped}, limb)
        assert severity == "warning"
        assert "is larger than the tibia" in what


def test_meshing_refuses_bones_all_of_which_lie_outside(surfaces):
    with pytest.raises(MeshError, match="outside the skin"):
        mend(surfaces["skin"], [moved(surfaces["bone_tibia"], (200, 0, 0))])


def test_sites_off_the_skin_are_told(surfaces):
    places = {"on": np.array([40.0, 0, 0]), "near": np.array([44.0, 0, 0]), "far": np.array([90.0, 0, 0])}
    problems = place_problems(surfaces["skin"], places, where="case")
    assert [(each.severity, each.what.split()[1]) for each in problems] == [
        ("warning", "near"),
        ("error", "far"),
    ]


def test_a_limb_across_the_patient_frame_is_told(surfaces):
    """As saved by a program whose y points up: no side can be told then, as proximal and distal cannot."""
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    across = {name: Triangles(each.points @ turn.T, each.faces) for name, each in surfaces.items()}
    for limb in ("left", "right"):
        ((severity, what),) = found(across, limb)
        assert severity == "warning"
        assert "lies along y" in what
