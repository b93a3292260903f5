"""Files and folders are whole or absent, whatever happens while they are made."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from pathlib import Path

import pytest

from limbcli.errors import CaseError, MeshError
from limbcli.files import atomic as atomic_files
from limbcli.files.atomic import atomic_file, atomic_folder, atomic_set, clear_partial, sha256
from limbcli.results import open_stage, read_result


def test_failure_keeps_the_previous_file(tmp_path: Path):
    target = tmp_path / "a.txt"
    target.write_text("before")
    with pytest.raises(KeyboardInterrupt), atomic_file(target) as path:  # noqa: PT012
        path.write_text("half")
        raise KeyboardInterrupt
    assert target.read_text() == "before"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_failure_keeps_the_previous_folder(tmp_path: Path):
    target = tmp_path / "stage"
    with atomic_folder(target) as work:
        (work / "a").write_text("before")
    with pytest.raises(KeyboardInterrupt), atomic_folder(target) as work:  # noqa: PT012
        (work / "a").write_text("half")
        raise KeyboardInterrupt
    assert (target / "a").read_text() == "before"
    assert os.listdir(tmp_path) == ["stage"]


@pytest.mark.parametrize("atomic", [atomic_file, atomic_folder])
def test_failure_leaves_no_new_folder(tmp_path: Path, atomic):
    with pytest.raises(KeyboardInterrupt), atomic(tmp_path / "out" / "p1" / "mesh"):
        raise KeyboardInterrupt
    assert not os.listdir(tmp_path)


def test_a_link_to_a_folder_elsewhere_stays_one(tmp_path: Path):
    (tmp_path / "large" / "stage").mkdir(parents=True)
    (tmp_path / "out").mkdir()
    target = tmp_path / "out" / "stage"
    target.symlink_to(tmp_path / "large" / "stage")
    for content in ("one", "two"):
        with atomic_folder(target) as work:
            (work / "a").write_text(content)
        assert (tmp_path / "large" / "stage" / "a").read_text() == content
        assert target.is_symlink()
        assert os.listdir(tmp_path / "out") == os.listdir(tmp_path / "large") == ["stage"]


def test_a_folder_that_another_program_made_meanwhile_is_not_replaced(tmp_path: Path):
    target = tmp_path / "subject"
    with (  # noqa: PT012
        pytest.raises(CaseError, match="meanwhile") as caught,
        atomic_folder(target, is_new=True) as work,
    ):
        (work / "case.toml").write_text("ours")
        target.mkdir()
        (target / "case.toml").write_text("theirs")
    assert caught.value.fix
    assert (target / "case.toml").read_text() == "theirs"
    assert os.listdir(tmp_path) == ["subject"]


@pytest.mark.parametrize("is_empty", [False, True])
def test_a_new_folder_is_put_where_nothing_is(tmp_path: Path, is_empty: bool):
    if is_empty:
        (tmp_path / "subject").mkdir()
    with atomic_folder(tmp_path / "subject", is_new=True) as work:
        (work / "case.toml").write_text("ours")
    assert (tmp_path / "subject" / "case.toml").read_text() == "ours"


def test_an_input_changed_while_a_stage_works_is_noticed(tmp_path: Path):
    """Its hash would be of another content than the one that was read."""
    levels = tmp_path / "levels.csv"
    levels.write_text("before")
    with open_stage(tmp_path / "out", "fit", subject="S1", site="p1") as writer:
        writer.used("levels", levels)
    assert read_result(tmp_path / "out", "fit", site="p1").subject == "S1"
    with (  # noqa: PT012
        pytest.raises(CaseError, match=r"levels\.csv was changed while `fit`") as caught,
        open_stage(tmp_path / "out", "fit", subject="S2", site="p1") as writer,
    ):
        writer.used("levels", levels)
        levels.write_text("after!")
    assert caught.value.fix
    assert read_result(tmp_path / "out", "fit", site="p1").subject == "S1"


def test_folder_is_replaced_whole(tmp_path: Path):
    for name in ("a", "b"):
        with atomic_folder(tmp_path / "stage") as work:
            (work / name).write_text(name)
    assert os.listdir(tmp_path / "stage") == ["b"]


@pytest.mark.parametrize(("umask", "file", "folder"), [(0o077, 0o600, 0o700), (0o002, 0o664, 0o775)])
def test_what_is_made_has_the_rights_that_new_files_have(tmp_path: Path, umask: int, file: int, folder: int):
    """A patient's results stay one's own under umask 077, and a group's under 002."""
    before = os.umask(umask)
    try:
        with atomic_file(tmp_path / "rows.csv") as path:
            path.write_text("a")
        with atomic_folder(tmp_path / "stage") as work:
            (work / "a").write_text("a")
    finally:
        os.umask(before)
    found = [(tmp_path / name).stat().st_mode & 0o777 for name in ("rows.csv", "stage", "stage/a")]
    assert found == [file, folder, file]


def written_set(folder: Path, text: str) -> None:
    with atomic_set(folder, last="b.json") as work:
        (work / "b.json").write_text(text)
        (work / "c.csv").write_text(text)
        (work / "pictures").mkdir()
        (work / "pictures" / text).write_text(text)


def test_a_set_is_replaced_once_all_of_it_is_written(tmp_path: Path):
    (tmp_path / "mine.txt").write_text("a user's own")
    written_set(tmp_path, "first")
    with pytest.raises(KeyboardInterrupt), atomic_set(tmp_path, last="b.json") as work:  # noqa: PT012
        (work / "b.json").write_text("half")
        raise KeyboardInterrupt
    assert (tmp_path / "b.json").read_text() == "first"
    written_set(tmp_path, "second")
    assert (tmp_path / "c.csv").read_text() == (tmp_path / "b.json").read_text() == "second"
    assert os.listdir(tmp_path / "pictures") == ["second"]
    assert sorted(os.listdir(tmp_path)) == ["b.json", "c.csv", "mine.txt", "pictures"]


def test_what_tells_of_a_set_is_replaced_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    order = []
    monkeypatch.setattr(atomic_files, "_put_in_place", lambda _, target: order.append(target.name))
    written_set(tmp_path, "first")
    assert order == ["c.csv", "pictures", "b.json"]


@pytest.mark.parametrize(
    ("where", "given"),
    [("layers", "site p1, layers"), ("out/mesh/p1", "site p1, out/mesh/p1"), ("p1, layers", "p1, layers")],
)
def test_what_goes_wrong_at_a_site_names_it(tmp_path: Path, where: str, given: str):
    with pytest.raises(MeshError) as caught, open_stage(tmp_path, "mesh", subject="S1", site="p1"):
        raise MeshError("286 cells are inverted", where=where, fix="give thinner layers")
    assert (caught.value.site, caught.value.where) == ("p1", given)
    assert f"where: {given}\n" in str(caught.value)


def test_leftovers_of_a_killed_run_are_cleared_and_a_living_one_is_not(tmp_path: Path):
    process = subprocess.Popen(["true"])
    process.wait()
    (tmp_path / f".partial-{process.pid}-x").mkdir()
    (tmp_path / f".partial-{os.getpid()}-x").mkdir()
    clear_partial(tmp_path)
    assert os.listdir(tmp_path) == [f".partial-{os.getpid()}-x"]


def test_a_folder_that_could_not_be_cleared_away_stops_no_later_one(tmp_path: Path, monkeypatch):
    """Ctrl-C in that moment in a notebook, whose process goes on; or a file of it that is open (NFS)."""
    target, cleared = tmp_path / "fit", shutil.rmtree
    for text in "abc":
        with atomic_folder(target) as work:
            (work / "fit.json").write_text(text)
            monkeypatch.setattr(atomic_files.shutil, "rmtree", lambda *_, **__: None)
        assert (target / "fit.json").read_text() == text
        monkeypatch.setattr(atomic_files.shutil, "rmtree", cleared)


def test_what_another_computer_has_in_work_is_left_alone_for_a_day(tmp_path: Path):
    process = subprocess.Popen(["true"])
    process.wait()
    names = {each: f".partial-{process.pid}@{each}-x" for each in ("elsewhere", atomic_files._computer())}
    for name in names.values():
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.txt").write_text("half")
    clear_partial(tmp_path)
    assert os.listdir(tmp_path) == [names["elsewhere"]]
    old = time.time() - 25 * 3600
    os.utime(tmp_path / names["elsewhere"], (old, old))
    clear_partial(tmp_path)
    assert os.listdir(tmp_path) == [names["elsewhere"]], "a file in it is still written"
    os.utime(tmp_path / names["elsewhere"] / "a.txt", (old, old))
    os.utime(tmp_path / names["elsewhere"], (old, old))
    clear_partial(tmp_path)
    assert not os.listdir(tmp_path)


def test_hash_of_a_folder_sees_names_and_contents(tmp_path: Path):
    (tmp_path / "a").write_text("1")
    first = sha256(tmp_path)
    (tmp_path / "a").rename(tmp_path / "b")
    second = sha256(tmp_path)
    (tmp_path / "b").write_text("2")
    assert len({first, second, sha256(tmp_path)}) == 3


def test_stage_result_reads_back_what_was_written(tmp_path: Path):
    with open_stage(tmp_path, "mesh", subject="S1", site="p1") as writer:
        writer.file("picture", "mesh.png").write_bytes(b"x")
        writer.data["depth_mm"] = 1.5
        writer.warnings.append("thin")
    result = read_result(tmp_path, "mesh", site="p1")
    assert result.path("picture").read_bytes() == b"x"
    assert (result.data["depth_mm"], result.warnings) == (1.5, ("thin",))
    assert result.provenance["units"] == "mm-N-s (MPa)"
