"""The folder that a simulated case is written as: images of its own, a case.toml that can be read."""

from __future__ import annotations

from pathlib import Path

import pytest

from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.phantom.case_folder import NoiseLaw, toml
from limbcli.stages.simulated_subjects.synth_case import case_table, check_orientations, copy_imaging

CASE = """
format = 1
[files]
allow_outside = true
[subject]
id = "S1"
limb = "left"
[imaging]
skin = "../skin.stl"
bones = ["../tibia/surface.stl", "../fibula/surface.stl"]
[probe]
name = "two\\nlines, a \\"quote\\", \\u007f"
length_mm = 53.0
width_mm = 14.0
[[site]]
name = "p1"
position_mm = [0.0, 0.0, 0.0]
long_axis = "axial"
levels = "p1/levels.csv"
[site.load_cell]
file = "p1/cell.lvm"
[[site.pennation]]
orientation = "p2"
pennation_deg = 12.0
[[site]]
name = "p2"
position_mm = [0.0, 0.0, 0.0]
long_axis = [0.0, 0.1, 1.0]
levels = "p2/levels.csv"
"""


@pytest.fixture
def case(tmp_path: Path) -> Case:
    folder = tmp_path / "case"
    for name, text in (("tibia/surface.stl", "T"), ("fibula/surface.stl", "F"), ("skin.stl", "S")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    for name in ("p1/levels.csv", "p2/levels.csv", "p1/cell.lvm"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("force_n,depth_mm\n")
    (folder / "case.toml").write_text(CASE)
    return Case.open(folder)


def test_the_simulated_case_opens_and_every_bone_is_its_own(case: Case, tmp_path: Path):
    made = tmp_path / "made"
    made.mkdir()
    copy_imaging(case, made)
    for name in ("p1", "p2"):
        (made / name / "swe").mkdir(parents=True)
        for file in ("levels.csv", "trace.csv"):
            (made / name / file).write_text("")
    table = case_table(case, dict.fromkeys(("p1", "p2"), NoiseLaw()))
    (made / "case.toml").write_text(toml(table), encoding="utf-8")
    found = Case.open(made)
    assert [each.read_text() for each in found.imaging.bones] == ["T", "F"]
    assert found.probe.name == case.probe.name
    assert set(found.site("p1").instruments) == {"load_cell"}, "of the trace alone"
    assert found.site("p1").instruments["load_cell"]["path"] == made / "p1" / "trace.csv"


def test_an_image_that_tells_the_fibres_is_simulated_with_them(case: Case):
    check_orientations(case.sites)
    with pytest.raises(CaseError, match="in the image of p2") as caught:
        check_orientations(case.selected(["p1"]))
    assert "--site p2" in caught.value.fix
