"""A case folder may come from somebody else: what it names outside itself is not touched unless allowed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from limbcli.case import Case, read_case
from limbcli.errors import CaseError
from limbcli.stages.check import check
from limbcli.stages.measure import measure
from tests.case.test_case_text import HEAD, LEVELS, SITE, two_sites

ALLOWED = "[files]\nallow_outside = true\n"
SECRET = "secret of another 4711"
SITE_TEXT = SITE.format(name="p1", levels="p1.csv")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A case, and beside it a folder with what is not its own."""
    folder = tmp_path / "case"
    (folder / "mri").mkdir(parents=True)
    (folder / "p1.csv").write_text(LEVELS)
    other = tmp_path / "other"
    (other / "mri").mkdir(parents=True)
    (other / "p1.csv").write_text(LEVELS.replace("0,0,1.6", SECRET + ",0,1.6"))
    (other / "good.csv").write_text(LEVELS)
    (folder / "linked.csv").symlink_to(other / "p1.csv")
    (folder / "linked").symlink_to(other)
    (folder / "within.csv").symlink_to("p1.csv")
    (folder / "images").mkdir()
    (folder / "images" / "IM1").symlink_to(other / "p1.csv")
    return folder


def write(folder: Path, text: str) -> None:
    (folder / "case.toml").write_text(text.replace("OTHER", str(folder.parent / "other")))


OUTSIDE = {
    "up": ('levels = "p1.csv"', 'levels = "../other/p1.csv"'),
    "up and down": ('levels = "p1.csv"', 'levels = "mri/../../other/p1.csv"'),
    "absolute": ('levels = "p1.csv"', 'levels = "OTHER/p1.csv"'),
    "link to a file": ('levels = "p1.csv"', 'levels = "linked.csv"'),
    "link to a folder": ('levels = "p1.csv"', 'levels = "linked/p1.csv"'),
    "trace": ('levels = "p1.csv"', 'levels = "p1.csv"\ntrace = "../other/p1.csv"'),
    "maps": ('levels = "p1.csv"', 'levels = "p1.csv"\nswe_maps = "../other"'),
    "series": ('mri = "mri"', 'mri = "../other/mri"'),
    "link in a series": ('mri = "mri"', 'mri = "images"'),
    "labels": ('mri = "mri"', 'mri = "mri"\nlabels = "linked.csv"'),
    "skin": ('mri = "mri"', 'skin = "linked.csv"\nbones = ["linked.csv"]'),
    "bones": ('mri = "mri"', 'skin = "p1.csv"\nbones = ["../other/p1.csv"]'),
    "not there": ('levels = "p1.csv"', 'levels = "../nothing.csv"'),
    "load cell": ('levels = "p1.csv"', 'levels = "p1.csv"\n[site.load_cell]\nfile = "../other/p1.csv"'),
    "pictures": ('levels = "p1.csv"', 'levels = "p1.csv"\n[site.b_mode]\nfolder = "../other"'),
    "no name": ('levels = "p1.csv"', 'levels = "a\\u0000b"'),
}


@pytest.mark.parametrize("name", OUTSIDE)
def test_what_leads_out_of_the_folder_is_refused_and_not_read(folder: Path, name: str):
    old, new = OUTSIDE[name]
    assert old in HEAD + SITE_TEXT
    write(folder, (HEAD + SITE_TEXT).replace(old, new))
    with pytest.raises(CaseError, match="points outside the case folder") as caught:
        Case.open(folder)
    assert "allow_outside = true" in str(caught.value)
    problems = check(folder).problems
    assert any("points outside the case folder" in each.what for each in problems)
    assert SECRET not in str(caught.value) + "".join(map(str, problems))
    assert not any("not found" in each.what for each in problems), "whether it is there is told to nobody"


@pytest.mark.parametrize("name", [name for name in OUTSIDE if name not in ("not there", "no name")])
def test_it_is_used_where_the_case_allows_it(folder: Path, name: str):
    old, new = OUTSIDE[name]
    write(folder, HEAD.replace(old, new) + ALLOWED + SITE_TEXT.replace(old, new))
    assert not read_case(folder)[1]


def test_links_and_detours_within_the_folder_are_its_own(folder: Path):
    for new in ("within.csv", "mri/../p1.csv", str(folder / "p1.csv")):
        write(folder, (HEAD + SITE_TEXT).replace("p1.csv", new))
        assert Case.open(folder).sites[0].levels.read_text() == LEVELS


def test_nothing_is_written_outside(folder: Path, tmp_path: Path):
    text = (HEAD + SITE_TEXT).replace('levels = "p1.csv"', 'levels = "../new.csv"\ntrace = "p1.csv"')
    write(folder, text)
    with pytest.raises(CaseError, match="points outside the case folder"):
        measure(Case.open(folder), out=tmp_path / "out", write=True)
    assert not (tmp_path / "new.csv").exists()


@pytest.mark.parametrize("value", ['"yes"', "1", "false"])
def test_only_true_allows(folder: Path, value: str):
    text = HEAD + ALLOWED.replace("true", value) + SITE_TEXT.replace("p1.csv", "../other/good.csv")
    write(folder, text)
    with pytest.raises(CaseError, match="points outside"):
        Case.open(folder)


LABEL_TABLES = {
    '{ preset = "musclemap-1" }': "lacks `file`",
    '{ file = "there.nii", 8151 = 2 }': "8151 = 2, which is not text",
    '{ file = "gone.nii" }': "imaging.labels names a file or folder that was not found: gone.nii",
    '["there.nii", { file = "gone.nii" }]': "imaging.labels[1] names a file or folder that was not found",
}


@pytest.mark.parametrize("table", LABEL_TABLES)
def test_a_table_of_labels_is_checked(tmp_path, table):
    folder = two_sites(tmp_path)
    (folder / "there.nii").write_bytes(b"")
    text = (folder / "case.toml").read_text().replace('mri = "mri"', f'mri = "mri"\nlabels = {table}')
    (folder / "case.toml").write_text(text)
    with pytest.raises(CaseError, match=re.escape(LABEL_TABLES[table])):
        Case.open(folder)


def test_label_maps_are_a_file_or_tables(tmp_path):
    folder = two_sites(tmp_path)
    (folder / "a.nii").write_bytes(b"")
    (folder / "seg").mkdir()
    labels = '["seg", { file = "a.nii", preset = "total", 9 = "fat" }]'
    text = (folder / "case.toml").read_text().replace('mri = "mri"', f'mri = "mri"\nlabels = {labels}')
    (folder / "case.toml").write_text(text)
    first, second = Case.open(folder).imaging.label_maps
    assert (first.path, first.preset, first.names) == (folder / "seg", None, {})
    assert (second.path, second.preset, second.names) == (folder / "a.nii", "total", {"9": "fat"})
