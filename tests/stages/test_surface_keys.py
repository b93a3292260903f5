"""`bodies`, `unit`, `scale` and `limb` of [imaging]: what the surfaces' files do not say themselves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from limbcli.case import Case, read_case
from limbcli.errors import CaseError
from limbcli.imaging.surface import read_surface
from limbcli.meshing.surfaces import Triangles
from limbcli.stages.check import check
from limbcli.stages.segment import segment
from limbcli.stages.segmenting.surfaces import read_surfaces
from tests.meshing.conftest import cylinder

CASE = """
format = 1
[subject]
id = "S1"
limb = "left"
[imaging]
{imaging}
[probe]
length_mm = 30.0
width_mm = 12.0
[[site]]
name = "p1"
position_mm = {position}
long_axis = "transverse"
levels = "levels.csv"
"""


def case_folder(folder: Path, imaging: str, position: str = "[0.0, -40.0, 0.0]") -> Path:
    (folder / "case.toml").write_text(CASE.format(imaging=imaging, position=position))
    (folder / "levels.csv").write_text("force_n,depth_mm\n0,0\n2,1\n4,2\n6,3\n")
    return folder


SKIN = cylinder(40, -100, 100, around=24)
TIBIA, FIBULA = cylinder(12, -90, 90, (-8, -10), around=24), cylinder(6, -90, 90, (16, 8), around=24)


def write_bodies(path: Path, *surfaces: Triangles, factor: float = 1.0, header: str = "") -> None:
    """All in one ASCII STL, lengths multiplied by `factor`."""
    lines = [f"solid limb {header}"]
    for each in surfaces:
        for corners in factor * each.points[each.faces]:
            rows = (f"vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners)
            lines += ["facet normal 0 0 0", "outer loop", *rows, "endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid\n"]))


def test_one_file_of_all_bodies_is_split(tmp_path: Path):
    write_bodies(tmp_path / "limb.stl", FIBULA, SKIN, TIBIA)
    case = Case.open(case_folder(tmp_path, 'bodies = "limb.stl"'))
    result = segment(case, out=tmp_path / "out")
    assert "limb.stl contains 3 bodies" in result.summary[0]
    volume = result.data["volume_cm3"]
    assert len(volume) == 3
    assert volume["skin"] == pytest.approx(SKIN.volume / 1e3, rel=1e-4)
    assert min(volume.values()) == pytest.approx(FIBULA.volume / 1e3, rel=1e-4)


def test_bones_in_one_file_are_told_apart(tmp_path: Path):
    """Also that a fragment too small for a bone leaves them as they are."""
    write_bodies(tmp_path / "skin.stl", SKIN)
    write_bodies(tmp_path / "bones.stl", FIBULA, TIBIA)
    case = Case.open(case_folder(tmp_path, 'skin = "skin.stl"\nbones = ["bones.stl"]'))
    surfaces, paths, _ = read_surfaces(case)
    assert {name: each.volume for name, each in surfaces.items()} == pytest.approx(
        {"skin": SKIN.volume, "bone_tibia": TIBIA.volume, "bone_fibula": FIBULA.volume}, rel=1e-4
    )
    assert paths["bone_fibula"] == tmp_path / "bones.stl"
    write_bodies(tmp_path / "bones.stl", FIBULA, TIBIA, cylinder(3, 20, 24, (20, -10), around=24))
    assert list(read_surfaces(case)[0]) == ["skin", "bone_1"]


@pytest.mark.parametrize(
    ("imaging", "expected"),
    [
        ('bodies = "limb.stl"\nskin = "limb.stl"', "[imaging] has both `bodies` and `skin`"),
        ('bodies = "limb.stl"\nbones = ["limb.stl"]', "[imaging] has both `bodies` and `bones`"),
        ('bodies = "limb.stl"\nshape = {}', "[imaging] has both `shape` and `bodies`"),
        ('bodies = "limb.stl"\nunit = "cm"\nscale = 10', "[imaging] has both `unit` and `scale`"),
        ('bodies = "limb.stl"\nunit = "furlong"', "imaging.unit is 'furlong'"),
        ('bodies = "limb.stl"\nscale = 0', "imaging.scale is 0"),
        ('bodies = "limb.stl"\nlimb = "both"', "imaging.limb is 'both'"),
        ('bodies = "other.stl"', "imaging.bodies names a file that was not found"),
        ('mri = "limb.stl"\nunit = "cm"', "[imaging] has `unit`, which applies to surfaces only"),
        ('mri = "limb.stl"\nlimb = "left"', "[imaging] has `limb`, which applies to surfaces only"),
    ],
)
def test_what_contradicts_is_refused(tmp_path: Path, imaging: str, expected: str):
    write_bodies(tmp_path / "limb.stl", SKIN)
    assert any(expected in each.what for each in read_case(case_folder(tmp_path, imaging))[1])


@pytest.mark.parametrize(
    ("key", "factor"), [('unit = "cm"', 0.1), ('unit = "m"', 0.001), ("scale = 380", 1 / 380)]
)
def test_lengths_are_converted_as_the_case_says(tmp_path: Path, key: str, factor: float):
    write_bodies(tmp_path / "limb.stl", SKIN, TIBIA, FIBULA, factor=factor)
    folder = case_folder(tmp_path, f'bodies = "limb.stl"\n{key}')
    result = segment(Case.open(folder), out=tmp_path / "out")
    assert result.data["volume_cm3"]["skin"] == pytest.approx(SKIN.volume / 1e3, rel=1e-4)
    assert any("as case.toml says" in line for line in result.summary)
    assert not [each for each in check(folder).problems if each.severity == "error"]


def test_a_size_that_cannot_be_names_the_keys(tmp_path: Path):
    write_bodies(tmp_path / "limb.stl", SKIN, TIBIA, factor=1 / 380)
    with pytest.raises(CaseError, match=r"0\.5\d* mm across") as caught:
        read_surfaces(Case.open(case_folder(tmp_path, 'bodies = "limb.stl"')))
    assert "`unit` or `scale`" in caught.value.fix


def test_a_file_that_states_another_unit_is_refused(tmp_path: Path):
    write_bodies(tmp_path / "limb.stl", SKIN, TIBIA, factor=0.1, header="units = cm")
    case = Case.open(case_folder(tmp_path, 'bodies = "limb.stl"\nunit = "m"'))
    with pytest.raises(CaseError, match=r'in units of cm, but case.toml says unit = "m"'):
        read_surfaces(case)
    same = Case.open(case_folder(tmp_path, 'bodies = "limb.stl"\nunit = "cm"'))
    assert np.ptp(read_surfaces(same)[0]["skin"].points[:, 2]) == pytest.approx(200.0)  # once, not twice


def test_surfaces_of_the_other_limb_are_mirrored_and_said_so(tmp_path: Path):
    write_bodies(tmp_path / "limb.stl", SKIN, TIBIA, FIBULA)
    given = read_surfaces(Case.open(case_folder(tmp_path, 'bodies = "limb.stl"\nlimb = "left"')))[0]
    case = Case.open(case_folder(tmp_path, 'bodies = "limb.stl"\nlimb = "right"'))
    result = segment(case, out=tmp_path / "out")
    assert any("they were mirrored" in line for line in result.summary)
    for name in given:
        found = read_surface(result.path(name))
        assert found.points[:, 0].mean() == pytest.approx(-given[name].points[:, 0].mean(), abs=1e-3)
        assert found.volume == pytest.approx(given[name].volume, rel=1e-5)  # normals still point outward


def test_a_scanned_skin_with_a_bone_from_ultrasound_is_converted_too(tmp_path: Path):
    write_bodies(tmp_path / "scan.stl", SKIN, factor=0.001)
    imaging = 'skin = "scan.stl"\nunit = "m"\nbone = "from-ultrasound"'
    folder = case_folder(tmp_path, imaging)
    text = (folder / "case.toml").read_text()
    (folder / "case.toml").write_text(text.replace('name = "p1"', 'name = "p1"\nskin_bone_mm = 15.0'))
    result = segment(Case.open(folder), out=tmp_path / "out")
    assert result.data["volume_cm3"]["skin"] == pytest.approx(SKIN.volume / 1e3, rel=1e-3)


@pytest.mark.slow
def test_the_mean_limb_of_openlimb_needs_no_other_program(shared: Path, tmp_path: Path):
    scan = shared / "data" / "openlimb" / "Mean_Limb_Shape.stl"
    if not scan.is_file():
        pytest.skip(f"needs {scan}")
    (tmp_path / "scan.stl").symlink_to(scan)
    imaging = 'bodies = "scan.stl"\nscale = 380\n[files]\nallow_outside = true'
    surfaces, _, _ = read_surfaces(Case.open(case_folder(tmp_path, imaging)))
    assert set(surfaces) == {"skin", "bone_femur", "bone_tibia", "bone_fibula", "bone_patella"}
    assert 150 < np.ptp(surfaces["skin"].points[:, 2]) < 500
