"""A stage's own record is protected as its files are: what was changed by hand is a message."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.provenance.chain_inputs import noted
from limbcli.provenance.staleness import Chain
from limbcli.reporting.outcome import read_outcomes
from limbcli.results import open_stage, read_result, sealed
from limbcli.stages.report_pages.material import _altered_pictures
from tests.case.test_case_text import two_sites


@pytest.fixture
def record(tmp_path: Path) -> Path:
    with open_stage(tmp_path, "fit", subject="S1", site="p1") as writer:
        writer.data.update(c_kpa=8.5, tiny=1e-300, steps=[{"force_n": 0.1 + 0.2}])
        writer.warnings.append("thin: 3 °")
        writer.file("picture", "fit.png").write_bytes(b"as drawn")
    return tmp_path / "fit" / "p1" / "fit.json"


def test_a_record_as_it_was_written_is_read(tmp_path: Path, record: Path):
    found = read_result(tmp_path, "fit", site="p1")
    assert found.data["c_kpa"] == 8.5
    record.write_text(json.dumps(json.loads(record.read_text()), indent=4))
    assert read_result(tmp_path, "fit", site="p1") == found, "another layout is no change"


def _with(content: dict, **changed: object) -> dict:
    return {**content, **changed}


CHANGES = {
    "a parameter": lambda c: _with(c, data={**c["data"], "c_kpa": 18.5}),
    "a key more": lambda c: _with(c, data={**c["data"], "note": None}),
    "steps of another type": lambda c: _with(c, data={**c["data"], "steps": [1, 2]}),
    "a warning taken out": lambda c: _with(c, warnings=[]),
    "warnings of other types": lambda c: sealed(_with(c, warnings=[["a"], 3])),
    "a summary of another type": lambda c: sealed(_with(c, summary=[None])),
    "warnings that are a number": lambda c: sealed(_with(c, warnings=3)),
    "the subject": lambda c: _with(c, subject="S2"),
    "provenance": lambda c: _with(c, provenance={**c["provenance"], "command": "limbcli fit other"}),
    "no digest": lambda c: _with(c, provenance={**c["provenance"], "record_sha256": None}),
    "a digest of another type": lambda c: _with(c, provenance={**c["provenance"], "record_sha256": ["a"]}),
    "a list": lambda c: [c],
    "null": lambda c: None,
}  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_record_is_a_message_and_is_not_shown(tmp_path: Path, record: Path, change: str):
    record.write_text(json.dumps(CHANGES[change](json.loads(record.read_text()))))
    with pytest.raises(CaseError, match="cannot be read") as caught:
        read_result(tmp_path, "fit", site="p1")
    assert "limbcli fit" in caught.value.fix
    outcome = read_outcomes(tmp_path, ("p1",)).of("fit", "p1")
    assert outcome.status == "failed"
    assert outcome.result is None


def test_a_record_of_many_nested_lists_is_a_message(tmp_path: Path, record: Path):
    record.write_text("[" * 100_000)
    with pytest.raises(CaseError, match="cannot be read"):
        read_result(tmp_path, "fit", site="p1")


def test_a_picture_that_was_changed_is_told_on_the_page(tmp_path: Path, record: Path):
    outcomes = read_outcomes(tmp_path, ("p1",))
    assert _altered_pictures(outcomes) == []
    record.with_name("fit.png").write_bytes(b"drawn over")
    (told,) = _altered_pictures(outcomes)
    assert "fit.png, drawn by `fit p1`, was changed since" in told


def test_a_result_that_appears_later_and_would_have_been_used_makes_one_out_of_date(tmp_path: Path) -> None:
    case, out = Case.open(two_sites(tmp_path / "case")), tmp_path / "out"
    with open_stage(out, "limb", subject="S1") as writer:
        writer.without_result("fit", "p1")
    chain = Chain(case, out)
    assert chain.broken(read_result(out, "limb")) is None
    with open_stage(out, "fit", subject="S1", site="p1") as writer:
        writer.data["c_kpa"] = 8.0
    broken = chain.broken(read_result(out, "limb"))
    assert broken is not None
    assert broken.what == "the result of `fit p1` was made after `limb`, which uses it"


@pytest.mark.parametrize("key", ["site/p1", "probe/height", "other", "model/margin/x/y", "site/p1/noise/x"])
@pytest.mark.parametrize("part", ["case", "files"])
def test_a_record_of_names_that_no_case_has_is_out_of_date(tmp_path: Path, part: str, key: str) -> None:
    """As a later limbcli may write them."""
    case, out = Case.open(two_sites(tmp_path / "case")), tmp_path / "out"
    with open_stage(out, "limb", subject="S1") as writer:
        writer.made_from[part][key] = "1"
    broken = Chain(case, out).broken(read_result(out, "limb"))
    assert broken is not None
    assert "limb" in broken.what


def test_a_socket_is_recorded_with_the_file_of_its_surface(tmp_path: Path) -> None:
    folder = two_sites(tmp_path / "case")
    with (folder / "case.toml").open("a") as stream:
        stream.write('[socket]\nsurface = "socket.stl"\n')
    (folder / "socket.stl").write_text("solid\nendsolid\n")
    with open_stage(tmp_path / "out", "socket", subject="S1") as writer:
        case = noted(Case.open(folder), writer)
        assert case.raw["socket"]["surface"] == "socket.stl"
    result = read_result(tmp_path / "out", "socket")
    made = result.provenance["made_from"]
    assert (set(made["case"]), set(made["files"])) == ({"socket"}, {"socket/surface"})
    (folder / "socket.stl").write_text("solid another\nendsolid\n")
    broken = Chain(Case.open(folder), tmp_path / "out").broken(result)
    assert broken is not None
    assert broken.what == "socket.surface changed after `socket` was run"


def test_a_file_that_appears_after_it_was_asked_for_makes_a_result_out_of_date(tmp_path: Path) -> None:
    folder, out = two_sites(tmp_path / "case"), tmp_path / "out"
    with open_stage(out, "fit", subject="S1", site="p1") as writer:
        assert noted(Case.open(folder), writer).site("p1").trace is None
    result = read_result(out, "fit", site="p1")
    assert Chain(Case.open(folder), out).broken(result) is None
    toml = folder / "case.toml"
    toml.write_text(toml.read_text().replace('levels = "p1.csv"', 'levels = "p1.csv"\ntrace = "t.csv"'))
    (folder / "t.csv").write_text("time_s,force_n\n0,0\n1,1\n")
    broken = Chain(Case.open(folder), out).broken(result)
    assert broken is not None
    assert broken.what == "trace of site p1 was added after `fit p1` was run"
