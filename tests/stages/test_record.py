"""A stage's own record is protected as its files are: what was changed by hand is a message."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from limbcli.errors import CaseError
from limbcli.reporting.outcome import read_outcomes
from limbcli.results import open_stage, read_result, sealed
from limbcli.stages.report_pages.stale import _altered_pictures


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
