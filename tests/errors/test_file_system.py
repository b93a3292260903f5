"""Faults of the file system are told with a way out, and leave what was there before."""

from __future__ import annotations

import errno
import os
import subprocess
from pathlib import Path

import pytest

from limbcli.case import Case
from limbcli.errors import CaseError, LimbError, ToolError
from limbcli.errors.file_system import not_in_utf8
from limbcli.errors.unexpected import unforeseen
from limbcli.files.atomic import atomic_file, atomic_folder, clear_partial, sha256
from limbcli.files.output_lock import LOCK, one_writer
from limbcli.stages.batch import batch
from tests.stages.chain_case import write_case


@pytest.mark.parametrize(
    ("number", "family", "words"),
    [
        (errno.ENOSPC, ToolError, "the disk is full"),
        (errno.EDQUOT, ToolError, "the disk is full"),
        (errno.EROFS, CaseError, "permission denied"),
        (errno.EACCES, CaseError, "permission denied"),
        (errno.EIO, ToolError, "could not read or write"),
    ],
)
def test_a_fault_while_writing_is_told_and_keeps_what_was_there(
    tmp_path: Path, number: int, family: type[LimbError], words: str
):
    for make in (atomic_file, atomic_folder):
        target = tmp_path / make.__name__
        with make(target) as path:
            (path / "a" if path.is_dir() else path).write_text("before")
        with pytest.raises(family, match=words) as caught, make(target):
            raise OSError(number, os.strerror(number))
        assert str(target) in caught.value.where
        assert caught.value.fix
        assert (target / "a" if target.is_dir() else target).read_text() == "before"
    assert len(list(tmp_path.iterdir())) == 2


def test_the_place_told_is_the_results_not_that_of_its_half(tmp_path: Path):
    with pytest.raises(ToolError) as caught, atomic_folder(tmp_path / "mesh") as work:
        raise OSError(errno.ENOSPC, "full", str(work / "mesh.vtu"))
    assert caught.value.where == str(tmp_path / "mesh")
    with pytest.raises(CaseError) as refused, atomic_folder(tmp_path / "mesh"):
        raise OSError(errno.EACCES, "denied", "/home/levels.csv")
    assert refused.value.where == "/home/levels.csv"


def test_a_file_in_the_way_of_the_output_folder_is_told(tmp_path: Path):
    (tmp_path / "out").write_text("mine")
    for target in (tmp_path / "out" / "mesh", tmp_path / "out" / "mesh" / "p1"):
        with (
            pytest.raises(CaseError, match="a file was found where a folder is needed"),
            atomic_folder(target),
        ):
            pass
    assert (tmp_path / "out").read_text() == "mine"


def test_a_missing_file_is_no_fault_of_the_disk(tmp_path: Path):
    with pytest.raises(FileNotFoundError), atomic_file(tmp_path / "a") as path:
        path.with_name("none").read_text()


def test_a_result_comes_back_where_its_successor_could_not_take_its_place(tmp_path, monkeypatch):
    """Also where the interrupt comes between the two moves."""
    target = tmp_path / "mesh"
    with atomic_folder(target) as work:
        (work / "a").write_text("before")
    move = os.replace

    def only_away(source, to):
        move(source, to)
        if str(source) == str(target):
            raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", only_away)
    with pytest.raises(KeyboardInterrupt), atomic_folder(target):
        pass
    assert (target / "a").read_text() == "before"
    assert os.listdir(tmp_path) == ["mesh"]


def test_a_result_on_its_way_out_comes_back_after_a_kill(tmp_path: Path):
    process = subprocess.Popen(["true"])
    process.wait()
    old = tmp_path / f".partial-{process.pid}-old-mesh"
    old.mkdir()
    (old / "a").write_text("before")
    clear_partial(tmp_path)
    assert (tmp_path / "mesh" / "a").read_text() == "before"
    assert os.listdir(tmp_path) == ["mesh"]


def test_a_folder_that_is_not_named_in_utf8_is_refused_with_a_way_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    named = tmp_path / os.fsdecode(b"caf\xe9")
    try:
        named.mkdir()
    except OSError:
        pytest.skip("this file system has UTF-8 names only")
    write_case(tmp_path / "case")
    (tmp_path / "case").rename(named / "case")
    with pytest.raises(CaseError, match="not UTF-8") as caught:
        Case.open(named / "case")
    assert "rename" in caught.value.fix
    with pytest.raises(CaseError, match="not UTF-8"), one_writer(named / "out"):
        pass
    assert len(sha256(tmp_path)) == 64
    outcome = batch(named / "case", out=tmp_path / "out")
    assert outcome.report is not None
    assert "not UTF-8" in outcome.report.read_text(encoding="utf-8")
    monkeypatch.setattr("sys.argv", ["limbcli", "mesh", str(named)])
    with one_writer(tmp_path / "out"):
        assert "caf\\udce9" in (tmp_path / "out" / LOCK).read_text(encoding="utf-8")
    story = Path(unforeseen(ValueError(str(named)), tmp_path / "out").where)
    assert "caf\\udce9" in story.read_text(encoding="utf-8")
    assert not_in_utf8(tmp_path / "café") is None
