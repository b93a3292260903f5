"""What stages left is read without ever failing."""

from __future__ import annotations

import json
import shutil

import pytest

from limbcli.errors import CaseError
from limbcli.reporting.outcome import read_outcomes
from limbcli.results import open_stage, read_result


def test_each_stage_is_done_failed_or_missing(tmp_path):
    with open_stage(tmp_path, "segment", subject="S1") as writer:
        writer.warnings.append("w")
    note = {"error": "MeshError", "what": "no skin", "where": "p1", "fix": "move it"}
    (tmp_path / "mesh" / "p1").mkdir(parents=True)
    (tmp_path / "mesh" / "p1" / "error.json").write_text(json.dumps(note))
    outcomes = read_outcomes(tmp_path, ("p1",))
    states = {each.label: each.status for each in outcomes.all}
    assert states == {
        "segment": "done", "mesh p1": "failed", "build-feb p1": "missing", "run p1": "missing",
        "fit p1": "missing",
    }  # fmt: skip
    failure = outcomes.of("mesh", "p1").failure
    assert failure is not None
    assert (failure.error, failure.what, failure.fix) == ("MeshError", "no skin", "move it")
    assert "--site p1" in outcomes.of("run", "p1").command


def test_a_broken_result_is_a_failure_not_a_crash(tmp_path):
    (tmp_path / "segment").mkdir()
    (tmp_path / "segment" / "segment.json").write_text("{")
    outcome = read_outcomes(tmp_path, ()).of("segment")
    assert outcome.status == "failed"
    assert outcome.failure is not None
    assert "cannot be read" in outcome.failure.what


def test_a_broken_error_note_is_still_a_failure(tmp_path):
    (tmp_path / "segment").mkdir()
    for text in ("{", "[]", '{"what": null}'):
        (tmp_path / "segment" / "error.json").write_text(text)
        outcome = read_outcomes(tmp_path, ()).of("segment")
        assert outcome.status == "failed"
        assert outcome.failure is not None
        assert outcome.failure.what


def test_a_warning_that_is_passed_on_is_listed_once(tmp_path):
    for stage, site in (("segment", None), ("mesh", "p1")):
        with open_stage(tmp_path, stage, subject="S1", site=site) as writer:
            writer.warnings.append("the fibula is thin")
    ((outcome, text),) = read_outcomes(tmp_path, ("p1",)).warnings()
    assert (outcome.label, text) == ("segment", "the fibula is thin")


def test_stages_behind_a_failed_one_are_held_up_not_failed(tmp_path):
    """A batch notes for each of them that it was not run; only the first is a failure."""
    for stage in ("mesh", "build-feb", "run", "fit"):
        (tmp_path / stage / "p1").mkdir(parents=True)
        note = {"error": "CaseError", "what": f"{stage}: no", "where": "p1", "fix": "mend"}
        (tmp_path / stage / "p1" / "error.json").write_text(json.dumps(note))
    outcomes = read_outcomes(tmp_path, ("p1", "p2"))
    assert [each.label for each in outcomes.failed] == ["mesh p1"]
    assert outcomes.of("fit", "p1").held_by == "mesh p1"
    assert outcomes.of("fit", "p2").held_by == ""


def test_a_run_that_failed_tells_why_from_its_own_account(tmp_path):
    failure = {"error": "SolveError", "what": "stopped", "where": "model.log", "fix": "more time"}
    with open_stage(tmp_path, "run", subject="S1", site="p1-failed") as writer:
        writer.data.update(failed=True, failure=failure)
    outcome = read_outcomes(tmp_path, ("p1",)).of("run", "p1")
    assert outcome.status == "failed"
    assert outcome.failure is not None
    assert outcome.failure.what == "stopped"
    (tmp_path / "run" / "p1-failed" / "run.json").write_text("[]")
    assert read_outcomes(tmp_path, ("p1",)).of("run", "p1").status == "missing"


def test_a_result_in_the_place_of_another_sites_is_not_taken_for_it(tmp_path):
    with open_stage(tmp_path, "mesh", subject="S1", site="p1"):
        pass
    shutil.copytree(tmp_path / "mesh" / "p1", tmp_path / "mesh" / "p2")
    with pytest.raises(CaseError, match="it is that of `mesh p1`"):
        read_result(tmp_path, "mesh", site="p2")
    outcomes = read_outcomes(tmp_path, ("p1", "p2"))
    assert [outcomes.of("mesh", site).status for site in ("p1", "p2")] == ["done", "failed"]
