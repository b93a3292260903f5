"""A new case folder: asks for what is missing, and changes nothing that is there."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from limbcli.case import Case, read_case
from limbcli.case.schema import FILL_IN
from limbcli.errors import CaseError
from limbcli.measurement.indentation import read_levels
from limbcli.stages import new as module
from limbcli.stages.check import check
from limbcli.stages.new import new

FILLED = {
    'limb = "FILL IN"': 'limb = "left"',
    'name = "FILL IN"': 'name = "GE 9L"',
    'length_mm = "FILL IN"': "length_mm = 53.0",
    'width_mm = "FILL IN"': "width_mm = 14.0",
    'position_mm = "FILL IN"': "position_mm = [12.0, 48.5, -60.0]",
    'long_axis = "FILL IN"': 'long_axis = "transverse"',
}


def filled(folder: Path) -> Path:
    text = (folder / "case.toml").read_text()
    for before, after in FILLED.items():
        text = text.replace(before, after)
    (folder / "case.toml").write_text(text)
    return folder


def test_check_asks_for_every_value_and_file_that_is_to_come(tmp_path: Path):
    folder = new(tmp_path / "S12", sites=["p1", "p2"]).folder
    problems = check(folder).problems
    unfilled = {each.what.split()[0] if "site" not in each.what else each.what for each in problems}
    assert {"subject.limb", "probe.name", "probe.length_mm", "probe.width_mm"} <= unfilled
    texts = " ".join(each.what for each in problems)
    assert texts.count("position_mm is still to be filled in") == 2
    assert "the folder is still empty" in texts
    assert texts.count("a header but no rows") == 2
    n_marks = sum(
        FILL_IN in line.partition("#")[0] for line in (folder / "case.toml").read_text().splitlines()
    )
    assert len(problems) == n_marks + 1 + 2, "a place for every value, the images, both measurements"


def test_filled_in_it_opens_with_what_was_written(tmp_path: Path):
    folder = filled(new(tmp_path / "S12").folder)
    with (folder / "p1" / "levels.csv").open("a") as stream:
        stream.write("0,0,1.6,0.1,800\n2,1.1,1.7,0.1,800\n4,2.1,1.8,0.1,800\n")
    case = Case.open(folder)
    assert (case.subject, case.probe.length, case.sites[0].position) == ("S12", 53.0, (12.0, 48.5, -60.0))
    assert read_levels(case.sites[0].levels).depth.tolist() == [0.0, 1.1, 2.1]


def test_levels_that_are_to_be_measured_need_no_rows_but_the_file_to_be_out_of_the_way(tmp_path: Path):
    folder = filled(new(tmp_path / "S12").folder)
    (problem,) = [each for each in check(folder).problems if "no rows" in each.what]
    assert "remove the file" in problem.fix
    assert "limbcli measure" in problem.fix


def test_every_key_that_the_comments_offer_is_understood(tmp_path: Path):
    """Lines that are commented out become a case without unknown keys."""
    folder = filled(new(tmp_path / "S12").folder)
    lines = (folder / "case.toml").read_text().splitlines()
    offered = [line.removeprefix("# ") if "=" in line or line.startswith("# [") else line for line in lines]
    text = "\n".join(offered).replace("marker = 1 ", "")
    tomllib.loads(text)
    (folder / "case.toml").write_text(text)
    assert not [
        each.what for each in read_case(folder)[1] if "unknown" in each.what or "plausible" in each.what
    ]


def test_segment_can_begin_before_places_and_probe_are_known(tmp_path: Path):
    folder = new(tmp_path / "S12").folder
    with pytest.raises(CaseError, match=r"subject\.limb") as caught:
        Case.open_images(folder)
    assert not [word for word in ("probe", "position_mm", "long_axis") if word in str(caught.value)]
    text = (folder / "case.toml").read_text()
    (folder / "case.toml").write_text(text.replace('limb = "FILL IN"', 'limb = "left"'))
    case = Case.open_images(folder)
    assert (case.limb, case.imaging.mri, case.sites) == ("left", folder / "mri", ())
    assert case.probe.length != case.probe.length, "a probe that is not known has no size"
    with pytest.raises(CaseError):
        Case.open(folder)


def test_nothing_that_is_there_is_changed(tmp_path: Path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    (tmp_path / "file").write_text("mine")
    for name in ("mine", "file"):
        with pytest.raises(CaseError) as caught:
            new(tmp_path / name)
        assert "empty" in caught.value.fix
    assert [each.name for each in (tmp_path / "mine").iterdir()] == ["notes.txt"]
    assert (tmp_path / "file").read_text() == "mine"


def test_an_empty_folder_is_filled_in_its_place_or_left_empty(tmp_path: Path, monkeypatch):
    folder = tmp_path / "empty"
    folder.mkdir()
    inode = folder.stat().st_ino
    new(folder)
    assert folder.stat().st_ino == inode, "a shell may stand in it"
    assert (folder / "case.toml").is_file()

    other = tmp_path / "other"
    other.mkdir()
    texts = module._texts
    broken = {"README.md": "x", "p1/levels.csv": None}
    monkeypatch.setattr(module, "_texts", lambda *_: {**texts("S", ("p1",)), **broken})
    with pytest.raises(TypeError):
        new(other)
    assert list(other.iterdir()) == []


@pytest.mark.parametrize("sites", [["a/b"], [""], ["p1", "p1"], ["mri"], ["../x"], ["README.md"]])
def test_site_names_that_cannot_be_are_refused(tmp_path: Path, sites: list[str]):
    with pytest.raises(CaseError, match="site"):
        new(tmp_path / "S", sites=sites)
    assert not (tmp_path / "S").exists()


def test_name_that_is_no_id_is_asked_for(tmp_path: Path):
    result = new(tmp_path / "left leg")
    folder = result.folder
    assert result.summary[-1] == f"next: limbcli check '{folder}'", "it can be pasted"
    assert "subject.id is still to be filled in" in [each.what for each in check(folder).problems]
