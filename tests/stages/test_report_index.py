"""The index of a batch lists every subject, also those that failed."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from limbcli.cli.app import app
from limbcli.errors import CaseError
from limbcli.results import open_stage, read_result, sealed
from limbcli.stages.batching.outcome import report_failure
from limbcli.stages.report_pages.index import report_index

pytestmark = pytest.mark.slow


def add_subject(folder: Path, name: str, *, fitted: bool = True, failure: str | None = None) -> None:
    out = folder / name
    if fitted:
        with open_stage(out, "fit", subject=name, site="p1") as writer:
            m = {"value": 4.1, "low": 3.7, "high": 4.5, "flag": "identified"}
            step = {"c_kpa": 10.13, "m": 4.1, "kappa_kpa": 810.0, "r2": 0.9987, "rmse_n": 0.21}
            writer.data["steps"] = {
                "ogden": {**step, "parameters": {"m": m, "f_kappa": {"value": 80.0, "flag": "weak"}}}
            }
            writer.data["agreement"] = {"state": "good", "force": {"state": "good", "words": "it agrees"}}
    with open_stage(out, "report", subject=name) as writer:
        writer.file("page", "report.html").write_text("<!DOCTYPE html>")
        writer.data["sites"] = {"p1": {}}
        writer.data["n_warnings"] = 0
        writer.data["failures"] = [{"stage": "mesh", "site": "p1", "what": failure}] if failure else []


def test_every_subject_has_a_row_and_a_link_that_leads_to_its_page(tmp_path):
    add_subject(tmp_path, "A 1")
    add_subject(tmp_path, "B", fitted=False, failure="no skin <there>")
    add_subject(tmp_path, "C", fitted=False)
    result = report_index(tmp_path)
    html = result.page.read_text(encoding="utf-8")
    assert result.page == tmp_path / "index.html"
    assert [(row.subject, row.mood) for row in result.rows] == [
        ("A 1", "fine"),
        ("B", "failed"),
        ("C", "missing"),
    ]
    assert 'href="A%201/report/report.html"' in html
    assert "mesh failed: no skin &lt;there&gt;" in html
    assert "3.70\u00a0to\u00a04.50" in html
    assert re.search(r'not identifiable <span class="why">κ′: weak</span>', html), "an open end is no number"
    assert html.count("<h2>Side by side</h2>") == 1
    assert (tmp_path / "study.svg").read_text().startswith("<?xml")
    assert "What failed, and why" in html
    assert ",m [–]," in (tmp_path / "study-data.csv").read_text()


def test_study_page_gives_every_failure_its_reasons(tmp_path):
    add_subject(tmp_path, "A", fitted=False, failure="x")
    path = tmp_path / "A" / "report" / "report.json"
    content = json.loads(path.read_text())
    problems = [{"what": f"fault {k}", "where": f"line {k}", "fix": f"mend {k}"} for k in range(3)]
    content["data"]["failures"] = [
        {"stage": "check", "site": None, "error": "CaseError", "what": "3 problems:\n1. fault 0",
         "where": "a", "fix": "all", "problems": problems}
    ]  # fmt: skip
    path.write_text(json.dumps(sealed(content)))
    result = report_index(tmp_path)
    html = result.page.read_text(encoding="utf-8")
    assert result.rows[0].state == "check failed: 3 problems:"
    for k in range(3):
        assert f"<p>{k + 1}. fault {k}</p>" in html
        assert f"<dd>mend {k}</dd>" in html
    assert "Side by side" not in html, "nothing was fitted"


def test_what_failed_beside_a_fit_does_not_take_its_numbers(tmp_path):
    add_subject(tmp_path, "A", failure="of another stage")
    path = tmp_path / "A" / "report" / "report.json"
    content = json.loads(path.read_text())
    content["data"]["failures"] = [{"stage": "fit-joint", "site": None, "what": "it did not converge"}]
    for status, text in (
        ("done", "3.70\u00a0to\u00a04.50"),
        ("failed", "fit-joint failed: it did"),
    ):
        content["data"]["stages"] = {"fit p1": status}
        path.write_text(json.dumps(sealed(content)))
        (row,) = report_index(tmp_path).rows
        assert row.mood == "failed"
        assert any(text in f"{cell.text} {cell.reason}" for cell in row.cells)


def test_a_poor_fit_is_called_so_in_the_table(tmp_path):
    add_subject(tmp_path, "A")
    path = tmp_path / "A" / "fit" / "p1" / "fit.json"
    content = json.loads(path.read_text())
    content["data"]["agreement"] = {"state": "bad", "force": {"state": "bad", "words": "it differs"}}
    path.write_text(json.dumps(sealed(content)))
    html = report_index(tmp_path).page.read_text(encoding="utf-8")
    assert re.search(r'<span class="pill \w+">poor fit</span>', html)


def test_a_fit_that_its_report_does_not_show_is_told(tmp_path):
    """The page says that warnings and figures of the report belong to its numbers."""
    add_subject(tmp_path, "A")
    path = tmp_path / "A" / "report" / "report.json"
    content = json.loads(path.read_text())
    fitted = read_result(tmp_path / "A", "fit", site="p1").provenance["finished_utc"]
    for shown, words in ((fitted, ""), ("2020-01-01T00:00:00Z", "again after its report was made")):
        content["data"]["fitted_utc"] = {"p1": shown}
        path.write_text(json.dumps(sealed(content)))
        result = report_index(tmp_path)
        assert result.rows[0].older.startswith(words)
        assert bool(result.rows[0].older) == bool(words)
        assert words in result.page.read_text(encoding="utf-8")


@pytest.mark.parametrize("why", ["open to both bounds: no value is excluded", ""])
def test_an_interval_without_ends_says_why(tmp_path, why):
    """One that was looked for and excludes nothing was computed."""
    add_subject(tmp_path, "A")
    place = tmp_path / "A/fit/p1/fit.json"
    content = json.loads(place.read_text())
    m = content["data"]["steps"]["ogden"]["parameters"]["m"]
    m.update(low=None, high=None, flag="weak", interval_reason=why)
    place.write_text(json.dumps(sealed(content)))
    (row,) = report_index(tmp_path).rows
    assert (row.cells[2].text, row.cells[2].reason) == ("–", why or "not computed")


def test_folders_with_dollars_in_their_names_are_drawn_as_they_are_named(tmp_path):
    for name in (r"a$\q$", "cost $1$"):
        add_subject(tmp_path, name)
    report_index(tmp_path)
    assert "cost $1$" in (tmp_path / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("damaged", [{"sites": None}, {"failures": [3]}, {"failures": [{"site": None}]}])
def test_a_damaged_report_is_a_row_and_stops_no_other(tmp_path, damaged):
    add_subject(tmp_path, "A")
    add_subject(tmp_path, "B")
    path = tmp_path / "B" / "report" / "report.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps(sealed(content | {"data": content["data"] | damaged})))
    (tmp_path / "B" / "mesh" / "p1").mkdir(parents=True)
    (tmp_path / "B" / "mesh" / "p1" / "error.json").write_text('{"what": 3}')
    rows = report_index(tmp_path).rows
    assert [(row.subject, row.mood) for row in rows] == [("A", "fine"), ("B", "failed")]
    assert "its results cannot be read" in rows[1].state


def test_another_subjects_fit_is_not_in_the_table(tmp_path):
    add_subject(tmp_path, "A")
    path = tmp_path / "A" / "fit" / "p1" / "fit.json"
    path.write_text(json.dumps(sealed(json.loads(path.read_text()) | {"subject": "B"})))
    result = report_index(tmp_path)
    assert [(row.word, row.state, row.view) for row in result.rows] == [
        ("not fitted", "the fit is of B", None)
    ]
    assert "10.1" not in result.page.read_text(encoding="utf-8")


def test_a_subject_without_a_report_shows_its_failure(tmp_path):
    folder = tmp_path / "S9" / "segment"
    folder.mkdir(parents=True)
    (folder / "error.json").write_text(json.dumps({"what": "two series in one folder"}))
    (row,) = report_index(tmp_path).rows
    assert (row.link, row.mood) == ("", "failed")
    assert "two series in one folder" in row.state


def test_a_subject_whose_stages_are_still_to_come_is_not_a_failure(tmp_path):
    with open_stage(tmp_path / "S9", "segment", subject="S9"):
        pass
    (row,) = report_index(tmp_path).rows
    assert (row.mood, row.state) == ("missing", "not finished: it has no report yet")
    (tmp_path / "S9" / "report").mkdir()
    (tmp_path / "S9" / "report" / "report.json").write_text("{")
    (row,) = report_index(tmp_path).rows
    assert row.mood == "failed", "a report that cannot be read is one"


def test_one_subjects_own_folder_can_be_indexed(tmp_path):
    add_subject(tmp_path, "A")
    (row,) = report_index(tmp_path / "A").rows
    assert row.link == "report/report.html"


@pytest.mark.parametrize("name", ["segment", "mesh", "fit", "report"])
def test_a_subject_whose_folder_is_named_as_a_stage_is_one_row(tmp_path, name):
    add_subject(tmp_path, name)
    add_subject(tmp_path, "A")
    folder = tmp_path / name / "segment"
    folder.mkdir(exist_ok=True)
    (folder / "segment.json").write_text("{}")
    assert sorted(row.subject for row in report_index(tmp_path).rows) == sorted(["A", name])


def test_a_folder_without_results_is_refused(tmp_path):
    for folder in (tmp_path, tmp_path / "absent"):
        with pytest.raises(CaseError) as caught:
            report_index(folder)
        assert caught.value.fix


def test_command_makes_the_index_or_asks_for_what_is_missing(tmp_path):
    add_subject(tmp_path, "A")
    result = CliRunner().invoke(app, ["report", "--index", str(tmp_path), "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["n_subjects"] == 1
    assert CliRunner().invoke(app, ["report"]).exit_code == 2
    assert CliRunner().invoke(app, ["report", str(tmp_path), "--index", str(tmp_path)]).exit_code == 2


def test_a_case_that_cannot_be_opened_has_a_page_and_a_row(tmp_path):
    error = CaseError("case.toml is not valid TOML", where="S7/case.toml", fix="mend line 3 <here>")
    result = report_failure(tmp_path / "S7", error, out=tmp_path / "out" / "S7")
    html = result.path("page").read_text(encoding="utf-8")
    assert "case.toml is not valid TOML" in html
    assert "mend line 3 &lt;here&gt;" in html
    (row,) = report_index(tmp_path / "out").rows
    assert (row.subject, row.mood, row.link) == ("S7", "failed", "S7/report/report.html")
    assert "not valid TOML" in row.state
