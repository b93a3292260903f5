"""Bones of surfaces are named by their files, or by sizes and places where no file says what it holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from limbcli.meshing.surfaces import Triangles
from limbcli.stages.segmenting.bone_names import names_of_bodies, names_of_files
from tests.stages.test_mesh import prism


def rod(radius: float, x: float, y: float, low: float, high: float) -> Triangles:
    body = prism(radius, low, high, x=x)
    return Triangles(body.points + np.array([0.0, y, 0.0]), body.faces)


@pytest.fixture
def knee() -> dict[str, Triangles]:
    return {
        "skin": rod(60.0, 0.0, 0.0, -150.0, 150.0),
        "patella": rod(12.0, 0.0, -45.0, 20.0, 50.0),
        "fibula": rod(6.0, -25.0, 5.0, -140.0, -10.0),
        "femur": rod(25.0, 0.0, 0.0, 10.0, 150.0),
        "tibia": rod(18.0, 5.0, -10.0, -145.0, 5.0),
    }


@pytest.mark.parametrize("upside_down", [False, True])
def test_bones_of_a_knee_are_named_whatever_their_order(knee, upside_down):
    """The skin's own direction says nothing: in the patient frame the head is at +z."""
    skin = knee.pop("skin")
    if upside_down:
        skin = Triangles(skin.points[::-1].copy(), len(skin.points) - 1 - skin.faces)
    assert names_of_bodies(skin, list(knee.values())) == [f"bone_{each}" for each in knee]


def test_bones_that_cannot_be_told_are_numbered(knee):
    twin = rod(18.0, -35.0, -10.0, -145.0, 5.0)
    assert names_of_bodies(knee["skin"], [knee["tibia"], twin]) == ["bone_1", "bone_2"]
    assert names_of_bodies(knee["skin"], [knee["tibia"]]) == ["bone_1"]
    mirrored = Triangles(knee["patella"].points * np.array([1.0, -1.0, 1.0]), knee["patella"].faces)
    bones = [knee["tibia"], knee["fibula"], knee["femur"], mirrored]
    assert names_of_bodies(knee["skin"], bones) == ["bone_1", "bone_2", "bone_3", "bone_4"]


def test_a_files_name_says_which_bone_it_holds():
    paths = [Path("a/Tibia_left.stl"), Path("fib.stl"), Path("tibia-2.stl"), Path("tibia_and_fibula.stl")]
    assert names_of_files(paths) == ["bone_tibia", "bone_2", "bone_3", "bone_4"]
