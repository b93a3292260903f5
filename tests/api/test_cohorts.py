"""batch and cohort from Python: what they return, and that one case's failure is told and stops nobody."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import limbcli
from tests.case.test_case_text import two_sites
from tests.cli import quick_stages
from tests.cohort_rows import people, written


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every stage leaves a small result at once."""
    for name in ("segment", "mesh", "build_feb", "run", "fit", "report", "diagnose"):
        module = f"limbcli.stages.{name}"
        __import__(module)
        monkeypatch.setitem(sys.modules, module, sys.modules[module])
    quick_stages.dask_setup(None)


def test_one_case_that_fails_is_told_and_stops_nobody(quick: None, tmp_path: Path):
    good, bad = two_sites(tmp_path / "good"), two_sites(tmp_path / "bad")
    (bad / "fail-mesh-p2").touch()
    heard: list[str] = []
    found = limbcli.batch(
        [good, bad, tmp_path / "absent"], out=tmp_path / "out", jobs=1,
        progress=lambda kind, facts: heard.append(kind),
    )  # fmt: skip
    assert [each.ok for each in found] == [True, False, False]
    assert not found.ok
    whole, broken, absent = found
    assert whole.report == tmp_path / "out" / "good" / "report" / "report.html"
    assert "fit p2" in whole.ran
    (failure,) = broken.failures
    assert (failure.stage, failure.site, failure.error.message) == ("mesh", "p2", "no skin under the probe")
    assert "fit p1" in broken.ran
    assert absent.failures[0].error.fix
    assert found.index == tmp_path / "out" / "index.html"
    assert found.index.is_file()
    assert list(found.table()["ok"]) == [True, False, False]
    assert "mesh p2 no skin under the probe" in found.rows()[1]["failures"]
    assert {"stage"} < set(heard)
    fit = json.loads((tmp_path / "out" / "good" / "fit" / "p1" / "fit.json").read_text())
    assert fit["provenance"]["command"].startswith("limbcli.batch([")
    (again,) = limbcli.batch(limbcli.Case.open(good), out=tmp_path / "out" / "good", jobs=1)
    assert not again.ran
    assert "fit p2" in again.fresh


def test_paths_of_a_batch_are_whole_and_a_notebook_shows_why_a_case_failed(
    quick: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    two_sites(tmp_path / "good")
    (two_sites(tmp_path / "a<b") / "fail-mesh-p2").touch()
    good, bad = found = limbcli.batch(["good", "a<b"], out="out", jobs=1)
    monkeypatch.chdir("/")
    assert good.report is not None
    assert found.index is not None
    assert all(
        each.is_absolute() and each.exists() for each in (good.case, good.out, good.report, found.index)
    )
    assert str(found).splitlines()[0] == f"{tmp_path}/good: done, {good.report}"
    assert "mesh p2: no skin under the probe" in str(bad)
    assert "a&lt;b: failed" in found._repr_html_()
    shown: list[str] = []
    found._repr_pretty_(SimpleNamespace(text=shown.append), cycle=False)
    assert shown == [str(found)], "IPython shows what print shows"
    checked = limbcli.check(tmp_path / "a<b")
    assert checked.folder.is_absolute()
    assert "fix: " in str(checked)


def test_what_is_expected_and_does_not_hold_is_a_failure(quick: None, tmp_path: Path):
    case = two_sites(tmp_path / "a")
    (case / "expected.toml").write_text('[site.p1]\nthreads = { is = "many" }\n')
    (found,) = limbcli.batch(case, out=tmp_path / "out", expect=True)
    assert found.expected[0].startswith("FAIL site.p1.threads")
    assert "expected 'many'" in found.failures[-1].error.message


@pytest.mark.slow
def test_failures_in_other_processes_come_back(tmp_path: Path):
    pytest.importorskip("distributed", reason="needs the extra `cluster`")
    case = tmp_path / "a"
    case.mkdir()
    (case / "case.toml").write_text("no toml [")
    found = limbcli.batch([case, tmp_path / "b"], out=tmp_path / "out", jobs=2)
    assert [each.ok for each in found] == [False, False]
    assert "case.toml" in str(found.cases[0].failures[0].error)


@pytest.mark.slow
def test_a_script_whose_call_every_process_would_repeat_is_told_so(tmp_path: Path):
    script = tmp_path / "script.py"
    script.write_text("import limbcli\nlimbcli.batch(['a', 'b'], out='out', jobs=2)\n")
    command = [sys.executable, str(script)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 1
    *_, what, _where, fix = done.stderr.splitlines()
    assert what.startswith("limbcli.errors.ToolError: the worker processes did not start (")
    assert 'below `if __name__ == "__main__":`' in fix


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([],), "no case is given"),
        ((3,), "cases is 3, not a path"),
    ],
)
def test_what_is_no_case_is_refused(arguments: tuple[object, ...], words: str):
    with pytest.raises(limbcli.CaseError, match=words):
        limbcli.batch(*arguments)  # type: ignore[arg-type]


def test_numbers_and_words_are_bounded(tmp_path: Path):
    with pytest.raises(limbcli.CaseError, match="jobs is 0, outside"):
        limbcli.batch(tmp_path, jobs=0)
    with pytest.raises(limbcli.CaseError, match="element is 'hex8'"):
        limbcli.batch(tmp_path, element="hex8")  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_cohort_comes_back_as_a_table(tmp_path: Path):
    mean, spread = np.log([0.006, 0.010, 4.0]), np.diag([0.35, 0.3, 0.2]) ** 2
    rows, _ = people(12, mean=mean, spread=spread, rng=np.random.default_rng(7))
    names = [f"{k:03d}" for k in range(12)]  # no numbers, though they look like some
    table = written(
        tmp_path / "people.csv", [{**row, "subject": name} for row, name in zip(rows, names, strict=True)]
    )
    found = limbcli.cohort(table, out=tmp_path / "out")
    assert found.page == tmp_path / "out" / "cohort.html"
    assert list(found.table()["subject"]) == names
    assert found.table()["outside_family"].dtype == bool
    assert found.compliance_left_out["mean_absolute_difference_percent"] > 0
    assert found.stage_result.provenance["command"].startswith("limbcli.cohort(")
    back = limbcli.CohortResult.read(tmp_path / "out")
    assert back.rows() == found.rows()
    assert back.sites == found.sites
    with pytest.raises(limbcli.CaseError, match="not a result of one site"):
        limbcli.CohortResult.read(tmp_path / "out", "p1")
    with pytest.raises(limbcli.CaseError, match="no result of `cohort`"):
        limbcli.CohortResult.read(tmp_path)
    (tmp_path / "out" / "cohort.json").write_text('{"table": 3}')
    with pytest.raises(limbcli.CaseError, match="cannot be read"):
        limbcli.CohortResult.read(tmp_path / "out")
    with pytest.raises(limbcli.MeasurementError):
        limbcli.cohort(tmp_path / "none.csv", out=tmp_path / "out2")
