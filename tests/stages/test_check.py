"""check: all that is wrong with a case, in one go."""

from __future__ import annotations

import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.cli.app import main
from limbcli.errors import CaseError
from limbcli.meshing.surfaces import Triangles
from limbcli.site_model.mesh_checks import bone_warnings, measured_skin_bone
from limbcli.stages.check import check
from limbcli.stages.segment import segment
from tests.case.test_case_text import ONE_SITE, SITE

REPOSITORY = Path(__file__).resolve().parents[2]

# The probe's sides are exchanged.
CASE = ONE_SITE.replace("length_mm = 53.0\nwidth_mm = 14.0", "length_mm = 14.0\nwidth_mm = 53.0")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "mri").mkdir()
    (tmp_path / "case.toml").write_text(CASE)
    (tmp_path / "levels.csv").write_text("force_n,depth_mm\n0,0\n2,x\n4,2\n")
    return tmp_path


def test_problems_of_all_files_are_listed_together(folder: Path):
    result = check(folder)
    whats = [each.what for each in result.problems]
    assert any("wider" in each for each in whats)
    assert any("depth_mm is 'x'" in each for each in whats)
    assert any("mri" in each.where for each in result.problems)
    assert result.exit_code == 2
    assert json.loads(json.dumps(result.to_json()))["ok"] is False


def test_files_are_read_even_where_the_case_has_faults(folder: Path):
    (folder / "case.toml").write_text(CASE.replace("format = 1", "format = 9"))
    whats = [each.what for each in check(folder).problems]
    assert any("format" in each for each in whats)
    assert any("depth_mm is 'x'" in each for each in whats)


def test_a_radius_of_edges_that_the_mesh_would_refuse_is_told(folder: Path):
    (folder / "case.toml").write_text(ONE_SITE.replace("edge_radius_mm = 3.0", "edge_radius_mm = 7.0"))
    assert any("leaves no flat face" in each.what for each in check(folder).problems)


def test_levels_that_are_still_to_be_measured_are_told(folder: Path):
    (folder / "levels.csv").unlink()
    (folder / "trace.csv").write_text("time_s,force_n\n0,0\n1,1\n")
    (folder / "case.toml").write_text(ONE_SITE + 'trace = "trace.csv"\n')
    (reported,) = [each for each in check(folder).problems if "no levels.csv yet" in each.what]
    assert reported.severity == "warning"
    assert "limbcli measure" in reported.fix


def test_the_command_that_measures_can_be_pasted(tmp_path: Path):
    folder = tmp_path / "my case"
    (folder / "mri").mkdir(parents=True)
    (folder / "trace.csv").write_text("time_s,force_n\n0,0\n1,1\n")
    (folder / "case.toml").write_text(ONE_SITE + 'trace = "trace.csv"\n')
    (reported,) = [each for each in check(folder).problems if "no levels.csv yet" in each.what]
    command = reported.fix.split("`")[1]
    assert shlex.split(command) == ["limbcli", "measure", str(folder), "--site", "p1", "--write"]
    assert "limbcli new '" in check(tmp_path / "my case" / "mri").problems[0].fix


def test_two_levels_past_first_touch_are_too_few_for_a_fit(folder: Path):
    (folder / "case.toml").write_text(ONE_SITE)
    for rows, reported in (("2,1.9\n4,3.3\n", True), ("2,1.9\n4,3.3\n6,4.6\n", False)):
        (folder / "levels.csv").write_text("force_n,depth_mm\n0,0\n" + rows)
        whats = [each.what for each in check(folder).problems]
        assert ("only 2 levels of loading are deeper than first touch" in whats) is reported


@pytest.mark.parametrize(
    ("table", "files", "given"),
    [
        ('[site.load_cell]\nfile = "cell.csv"\ncolumns = { force_n = "F" }\n', {}, "no column 'F'"),
        ('[site.b_mode]\nfolder = "images"\n', {}, "contains no image"),
        (
            '[site.swe_images]\nfolder = "images"\nhigh_m_per_s = 10\n',
            {"images/a.png": "x"},
            "cannot be read",
        ),
    ],
)
def test_what_the_instruments_left_is_read(folder: Path, table: str, files: dict[str, str], given: str):
    (folder / "images").mkdir()
    (folder / "cell.csv").write_text("time_s,force\n" + "".join(f"{k / 10},{k // 100}\n" for k in range(400)))
    for name, text in files.items():
        (folder / name).write_text(text)
    (folder / "case.toml").write_text(ONE_SITE + table)
    for levels, severity in (("force_n,depth_mm\n0,0\n2,1\n4,2\n6,3\n", "warning"), (None, "error")):
        (folder / "levels.csv").unlink()
        if levels is not None:
            (folder / "levels.csv").write_text(levels)
        (found,) = [each for each in check(folder).problems if given in each.what]
        assert found.severity == severity
        (folder / "levels.csv").touch()


def test_as_many_images_as_holds_are_asked_for(folder: Path):
    from PIL import Image

    (folder / "levels.csv").unlink()
    (folder / "images").mkdir()
    Image.new("L", (40, 40)).save(folder / "images" / "a.png")
    rows = (f"{k / 10},{2 * (k // 100)}\n" for k in range(400))
    (folder / "cell.csv").write_text("time_s,force_n\n" + "".join(rows))
    tables = '[site.load_cell]\nfile = "cell.csv"\n[site.b_mode]\nfolder = "images"\nmm_per_pixel = 0.1\n'
    (folder / "case.toml").write_text(ONE_SITE + tables)
    whats = [each.what for each in check(folder).problems]
    assert "the instruments of site p1 have different numbers of levels: load_cell 4, b_mode 1" in whats


@pytest.mark.parametrize(
    ("seconds", "newtons", "given"),
    [
        (1000, 2, "are its times in ms"),
        (1, 0, "one level"),
    ],
)
def test_a_record_that_measure_would_refuse_is_not_complete(folder: Path, seconds, newtons, given):
    """Milliseconds, and no load at all."""
    (folder / "levels.csv").unlink()
    rows = (f"{k * seconds / 10},{newtons * (k // 100)}\n" for k in range(400))
    (folder / "cell.csv").write_text("time_s,force_n\n" + "".join(rows))
    (folder / "case.toml").write_text(ONE_SITE + '[site.load_cell]\nfile = "cell.csv"\nhold_s = 5\n')
    found = [each for each in check(folder).problems if given in each.what]
    assert found
    assert {each.severity for each in found} == {"error"}


def test_a_distance_to_the_bone_that_the_levels_contradict_is_told(folder: Path):
    (folder / "levels.csv").write_text("force_n,depth_mm,skin_bone_mm\n0,0,48\n2,1,47\n4,2,46\n6,3,45\n")
    for stated, reported in ((20, True), (47, False)):
        (folder / "case.toml").write_text(f"{ONE_SITE}skin_bone_mm = {stated}\n")
        whats = [each.what for each in check(folder).problems]
        assert any("level 0 of its levels gives 48.0" in each for each in whats) is reported


def test_a_distance_that_only_the_site_states_is_held_against_the_mesh(folder: Path):
    (folder / "levels.csv").write_text("force_n,depth_mm\n0,0\n2,1\n4,2\n6,3\n")
    (folder / "case.toml").write_text(f"{ONE_SITE}skin_bone_mm = 20\n")
    measured = measured_skin_bone(Case.open(folder).sites[0])
    assert measured == 20.0
    assert "48.0 mm in the model, 20.0 mm" in bone_warnings(48.0, measured)[0]


def test_readings_that_two_sites_share_are_told(folder: Path):
    (folder / "levels.csv").write_text("force_n,depth_mm\n0,0\n2,1\n4,2\n6,3\n")
    second = SITE.format(name="p2", levels="./levels.csv")
    (folder / "case.toml").write_text(ONE_SITE + second)
    (reported,) = [each for each in check(folder).problems if "use the same" in each.what]
    assert (reported.what, reported.severity) == ("sites p1 and p2 use the same levels.csv", "warning")
    (folder / "second.csv").write_text("force_n,depth_mm\n0,0\n2,1\n4,2\n6,3\n")
    (folder / "case.toml").write_text(ONE_SITE + second.replace("./levels.csv", "second.csv"))
    assert not any("use the same" in each.what for each in check(folder).problems)


def test_exit_code_is_that_of_the_measurement_where_only_that_is_wrong(folder: Path):
    from limbcli.errors.problems import Problem
    from limbcli.stages.check import CaseCheck

    wrong = Problem("a", "b", "c", family="measurement")
    warning = Problem("a", "b", "c", severity="warning")
    assert CaseCheck(folder, (), (wrong,)).exit_code == 3
    assert CaseCheck(folder, (), (warning,)).exit_code == 0


@pytest.mark.slow
def test_a_bone_elsewhere_and_sites_off_the_skin_are_told(tmp_path: Path):
    from limbcli.imaging.surface import read_surface, write_surface

    shutil.copytree(REPOSITORY / "cases" / "paper-parameters", tmp_path / "case")
    folder = tmp_path / "case"
    assert not [each.what for each in check(folder).problems if each.severity == "error"]
    tibia = read_surface(folder / "surfaces" / "tibia.ply")
    moved = Triangles(tibia.points + np.array([200.0, 0, 0]), tibia.faces)
    write_surface(folder / "surfaces" / "tibia.ply", moved)
    text = (folder / "case.toml").read_text()
    (folder / "case.toml").write_text(text.replace("[3.0, 36.0, 0.0]", "[3.0, 136.0, 0.0]", 1))
    errors = [each.what for each in check(folder).problems if each.severity == "error"]
    assert len(errors) == 2
    assert "bone_tibia lies outside the skin" in errors[0]
    assert "mm from the skin" in errors[1]
    with pytest.raises(CaseError, match="outside the skin"):
        segment(Case.open(folder), out=tmp_path / "out")


@pytest.mark.slow
def test_a_label_map_of_other_geometry_than_its_series_is_told(tmp_path: Path):
    from limbcli.imaging.dicom import read_series
    from limbcli.imaging.labels import write_labels
    from limbcli.imaging.segmentation import segment_limb

    shutil.copytree(REPOSITORY / "cases" / "phantom", tmp_path / "case")
    folder = tmp_path / "case"
    text = (folder / "case.toml").read_text()
    (folder / "case.toml").write_text(text.replace('mri = "mri"', 'mri = "mri"\nlabels = "labels.nii.gz"'))
    series = read_series(folder / "mri").volume
    labels = segment_limb(series, modality="MR").labels
    write_labels(folder / "labels.nii.gz", labels)
    assert not [each.what for each in check(folder).problems if each.severity == "error"]
    half = replace(labels, affine=labels.affine @ np.diag([1.0, 1.0, 0.5, 1.0]))
    write_labels(folder / "labels.nii.gz", half)
    assert any("a different position" in each.what for each in check(folder).problems)
    with pytest.raises(CaseError, match="a different position"):
        segment(Case.open(folder), out=tmp_path / "out")


def test_layers_are_shown_and_judged_by_the_noise_of_the_case(tmp_path):
    from tests.stages import block_case as block

    depths = np.array([0.9, 1.8, 2.7])
    case = block.make_case(tmp_path / "case", tmp_path / "out", depths, depths, c=0.008, build=False)
    path = case.folder / "levels.csv"
    head, *rows = path.read_text().splitlines()
    layers = ["1.5,5", "1.5,4.8", "1.4,6.4", "1.4,4.2"]
    path.write_text("\n".join([head + ",skin_mm,fat_mm", *map(",".join, zip(rows, layers, strict=True))]))
    found = check(case.folder)
    assert any("the fat grows under load" in each.what for each in found.problems)
    assert found.shown[0].startswith("site p1: skin 1.5 to 1.4 mm (0 to ")
    toml = case.file.read_text()
    case.file.write_text(toml.replace("depth_mm = 0.1", "depth_mm = 0.1\nlayer_mm = 0.4"))
    assert not any("grows" in each.what for each in check(case.folder).problems)


def test_the_command_counts_what_is_to_be_mended(tmp_path: Path, capsys):
    for text, count in (("format = 1\n", "4 errors to correct"), (ONE_SITE, "1 error to correct")):
        (tmp_path / "case.toml").write_text(text)
        (tmp_path / "levels.csv").write_text("force_n,depth_mm\n0,0\n2,1\n4,2\n6,3\n")
        with pytest.raises(SystemExit):
            main(["check", str(tmp_path)])
        assert capsys.readouterr().out.splitlines()[-1] == count


def test_what_no_limb_has_is_told_of_a_socket(folder: Path):
    """A patch and a landmark with a slip of the pen, and a file that is no surface."""
    file = folder / "case.toml"
    amounts = "rectifications_mm = { patella_tendon = 2.0, popliteal = 1.0 }"
    file.write_text(f"{file.read_text()}\n[socket]\nloads_n = [100.0]\n{amounts}\n")
    assert "did you mean 'patellar_tendon'?" in [each.fix for each in check(folder).problems]
    names = "tibia_end = [0, 0, 0]\nfibular_head = [9, 0, 0]\ndistal_tip = [0, 9, 0]"
    table = f'[socket]\nloads_n = [100.0]\nsurface = "socket.stl"\n[socket.landmarks]\n{names}\n'
    file.write_text(f"{file.read_text().partition('[socket]')[0]}{table}")
    (folder / "socket.stl").write_text("")
    found = check(folder)
    assert "did you mean 'tibial_end'?" in [each.fix for each in found.problems]
    assert "socket.stl" in found.looked_at
    assert [each.where for each in found.problems if "socket.stl" in each.where]


def test_a_case_of_a_socket_alone_needs_neither_probe_nor_site(tmp_path: Path):
    """But without a socket both are asked for, and the table of the socket is checked."""
    (tmp_path / "mri").mkdir()
    bare = CASE.partition("[probe]")[0]
    for table, missing in (("", "no site"), ("[socket]\n", ""), ("[socket]\nall_m = 1.0\n", "'all_m'")):
        (tmp_path / "case.toml").write_text(bare + table)
        told = [each.what for each in check(tmp_path).problems if "case.toml" in each.where]
        assert any(missing in each for each in told) if missing else not told
