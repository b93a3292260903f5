"""A stage is redone when, and only when, something that matters changed."""

from __future__ import annotations

from pathlib import Path

import pytest

from limbcli.provenance import batch_memory
from limbcli.provenance.batch_memory import Memory, code_hash, key_of
from limbcli.provenance.remaking_command import CommandStep
from limbcli.results import open_stage, read_result, stage_folder


def make(out: Path) -> None:
    with open_stage(out, "mesh", subject="S1", site="p1") as writer:
        writer.file("a", "a.txt").write_text("a")


def test_stage_is_fresh_until_its_key_or_its_files_change(tmp_path: Path):
    make(tmp_path)
    Memory(tmp_path).remember("mesh", "p1", "key")
    assert Memory(tmp_path).is_fresh("mesh", "p1", "key")
    assert not Memory(tmp_path).is_fresh("mesh", "p1", "other")
    assert not Memory(tmp_path).is_fresh("mesh", "p2", "key")
    (stage_folder(tmp_path, "mesh", "p1") / "a.txt").write_text("edited")
    assert not Memory(tmp_path).is_fresh("mesh", "p1", "key")


def test_sites_remember_side_by_side(tmp_path: Path):
    """Each has a file of its own: what two processes remember at once is not lost."""
    make(tmp_path)
    first, second = Memory(tmp_path, site="p1"), Memory(tmp_path, site="p2")
    first.remember("mesh", "p1", "key")
    second.keep_requested("mesh", "p2", {"size": 3.0})
    assert Memory(tmp_path, site="p1").is_fresh("mesh", "p1", "key")
    assert Memory(tmp_path, site="p2").requested("mesh", "p2") == {"size": 3.0}


@pytest.mark.parametrize(
    "damaged",
    ["{", "[]", "null", '{"mesh/p1": 3}', '{"mesh/p1": [1]}', '{"asked": []}', '{"asked": {"mesh/p1": 3}}'],
)
def test_damaged_memory_only_means_more_work(tmp_path: Path, damaged: str):
    make(tmp_path)
    (tmp_path / ".batch.json").write_text(damaged)
    memory = Memory(tmp_path)
    assert not memory.is_fresh("mesh", "p1", "key")
    assert memory.made_since("mesh", "p1")
    assert memory.requested("mesh", "p1") == {}
    memory.remember("mesh", "p1", "key")
    assert Memory(tmp_path).requested("mesh", "p1") == {}


@pytest.mark.parametrize("requested", [None, 3, [], "x"])
def test_damaged_options_of_a_result_are_none(tmp_path: Path, requested: object):
    with open_stage(tmp_path, "mesh", subject="S1", site="p1") as writer:
        writer.data["asked"] = requested
    assert Memory(tmp_path, "S1").requested("mesh", "p1") == {}
    found = read_result(tmp_path, "mesh", site="p1")
    assert CommandStep.of(found).command(Path("c"), Path("o")) == "limbcli mesh c --site p1 --out o"


def test_what_was_asked_for_another_subject_is_forgotten(tmp_path: Path):
    with open_stage(tmp_path, "mesh", subject="S1", site="p1") as writer:
        writer.data["asked"] = {"size": 3.0}
    assert Memory(tmp_path, "S1").requested("mesh", "p1") == {"size": 3.0}
    assert Memory(tmp_path, "S2").requested("mesh", "p1") == {}
    memory = Memory(tmp_path, "S1")
    memory.keep_requested("mesh", "p1", {"size": 3.0})
    memory.remember("mesh", "p1", "key")
    assert Memory(tmp_path, "S1").requested("mesh", "p1") == {"size": 3.0}
    assert Memory(tmp_path, "S2").requested("mesh", "p1") == {}
    assert not Memory(tmp_path, "S2").is_fresh("mesh", "p1", "key")


def test_key_follows_the_content_of_files(tmp_path: Path):
    path = tmp_path / "levels.csv"
    path.write_text("1")
    first = key_of("x", path)
    assert first == key_of("x", path)
    path.write_text("2")
    assert first != key_of("x", path)
    assert key_of("x", None) != key_of("x", "None ")


def test_the_whole_package_counts_as_its_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    assert Path(batch_memory.__file__).parents[1] == batch_memory.PACKAGE
    monkeypatch.setattr(batch_memory, "PACKAGE", tmp_path)
    law = tmp_path / "materials" / "ogden.py"
    law.parent.mkdir()
    law.write_text("x = 1")
    first = code_hash.__wrapped__()
    law.write_text("x = 2")
    assert first != code_hash.__wrapped__()


def test_a_file_that_is_still_to_come_has_a_key_too(tmp_path: Path):
    path = tmp_path / "levels.csv"
    first = key_of(path)
    path.write_text("1")
    assert first not in (key_of(path), key_of(None))
