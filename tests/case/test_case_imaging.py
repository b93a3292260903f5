"""[imaging] without images: what may stand there, and a message of its own for all that cannot be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from limbcli.case import Case, read_case
from limbcli.errors import CaseError

SHAPE = "shape = { circumference_mm = 320, skin_mm = 1.5, fat_mm = 6.5, muscle_mm = 18 }"
CASE = f"""
format = 1
[subject]
id = "N1"
limb = "left"
[imaging]
{SHAPE}
[probe]
length_mm = 30.0
width_mm = 12.0
edge_radius_mm = 2.0
[[site]]
name = "p1"
long_axis = "transverse"
levels = "levels.csv"
"""
PLACED = CASE.replace('name = "p1"', 'name = "p1"\nposition_mm = [0, -40, 0]')


def write(folder: Path, text: str) -> Path:
    (folder / "case.toml").write_text(text)
    (folder / "levels.csv").write_text("force_n,depth_mm\n0,0\n2,1\n4,2\n")
    (folder / "scan.stl").write_text("solid\nendsolid\n")
    return folder


def test_a_limb_of_numbers_needs_no_place(tmp_path: Path):
    case = Case.open(write(tmp_path, CASE))
    shape = case.imaging.shape
    assert shape is not None
    assert shape.skin_bone == 26.0
    assert shape.bone_radius == 14.0
    np.testing.assert_allclose(case.sites[0].position, [0, -320 / (2 * np.pi), 0])
    assert case.imaging.assumed.startswith("geometry assumed, not imaged: a straight round limb of 320 mm")


def test_a_bone_from_ultrasound_has_a_radius(tmp_path: Path):
    text = PLACED.replace(SHAPE, 'skin = "scan.stl"\nbone = "from-ultrasound"')
    assert Case.open(write(tmp_path, text)).imaging.bone_radius == 14.0
    given = Case.open(write(tmp_path, text.replace("[probe]", "bone_radius_mm = 9\n[probe]")))
    assert given.imaging.bone_radius == 9.0
    assert "not imaged: the bone" in given.imaging.assumed


def test_a_scan_has_a_scale_that_may_be_stated(tmp_path: Path):
    text = PLACED.replace(SHAPE, 'skin = "scan.stl"\nbone = "from-ultrasound"')
    assert Case.open(write(tmp_path, text)).imaging.skin_scale == 0.01
    stated = text.replace("[probe]", "skin_scale_fraction = 0.1\n[probe]")
    assert Case.open(write(tmp_path, stated)).imaging.skin_scale == 0.1
    with pytest.raises(CaseError, match=r"skin_scale_fraction is 10; plausible values are 0 to 0\.3"):
        Case.open(write(tmp_path, stated.replace("= 0.1", "= 10")))
    alone = PLACED.replace("[probe]", "skin_scale_fraction = 0.1\n[probe]")
    with pytest.raises(CaseError, match="applies only with a bone from ultrasound"):
        Case.open(write(tmp_path, alone))


def test_imaged_limbs_assume_nothing(tmp_path: Path):
    text = PLACED.replace(SHAPE, 'skin = "scan.stl"\nbones = ["scan.stl"]')
    assert Case.open(write(tmp_path, text)).imaging.assumed == ""


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("skin_mm = 1.5, ", "", "[imaging.shape] has layers without skin: fat_mm and muscle_mm"),
        ("320", "130", "is 41.4 mm across: less than its layers (26 mm) and the bone (28 mm)"),
        ("muscle_mm = 18", "muscle_mm = -1", "imaging.shape.muscle_mm is -1 mm; plausible values are"),
        ("fat_mm = 6.5, muscle_mm = 18", "fat_mm = 0.5, muscle_mm = 0.5", "leave 2.5 mm from skin to bone"),
        ("circumference_mm = 320, ", "", "[imaging.shape] is missing 'circumference_mm' (mm)"),
        ("muscle_mm", "muscel_mm", "unknown key 'muscel_mm'"),
        (SHAPE, "shape = 3", "is 3, not a table"),
        (SHAPE, f'{SHAPE}\nskin = "scan.stl"', "both `shape` and `skin`"),
        (SHAPE, 'mri = "."\nbone = "from-ultrasound"', "has a bone from ultrasound but no skin"),
        (SHAPE, SHAPE + "\nbone_radius_mm = 12", "has bone_radius_mm but no `bone`"),
        (SHAPE, 'skin = "scan.stl"\nbone = "from-x-ray"', "imaging.bone is 'from-x-ray'"),
        (
            SHAPE,
            'skin = "scan.stl"\nbones = ["scan.stl"]\nbone = "from-ultrasound"',
            "both `bones` and a bone from ultrasound",
        ),
        (SHAPE, 'skin = "scan.stl"\nbone = "from-ultrasound"', "neither position_mm nor marker"),
        (
            'name = "p1"',
            'name = "p1"\nmarker = 1',
            "by marker 1, and there are no images that could show one",
        ),
        ('name = "p1"', 'name = "p1"\nskin_bone_mm = 900', "plausible values are 2 to 120 mm"),
    ],
)
def test_what_cannot_be_has_a_message_of_its_own(tmp_path: Path, old: str, new: str, expected: str):
    assert old in CASE
    with pytest.raises(CaseError, match="fix: ") as caught:
        Case.open(write(tmp_path, CASE.replace(old, new)))
    assert expected in str(caught.value)


def test_each_fault_is_told_once(tmp_path: Path):
    assert len(read_case(write(tmp_path, CASE.replace("skin_mm = 1.5, ", "")))[1]) == 1
