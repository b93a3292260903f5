"""check: all that is wrong with a case, in one go."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from limbcli.stages.check import check

CASE = """
format = 1
[subject]
id = "S1"
limb = "left"
[imaging]
mri = "mri"
[probe]
name = "GE 9L"
length_mm = 14.0
width_mm = 53.0
edge_radius_mm = 3.0
[[site]]
name = "p1"
position_mm = [12.0, 48.5, -60.0]
long_axis = "transverse"
levels = "levels.csv"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "mri").mkdir()
    (tmp_path / "case.toml").write_text(CASE)
    (tmp_path / "levels.csv").write_text("force_n,depth_mm\n0,0\n2,x\n4,2\n")
    return tmp_path


def test_problems_of_all_files_are_listed_together(folder: Path):
    result = check(folder)
    whats = [each.what for each in result.problems]
    assert any("wider" in each for each in whats)
    assert any("depth_mm is 'x'" in each for each in whats)
    assert any("mri" in each.where for each in result.problems)
    assert result.exit_code == 2
    assert json.loads(json.dumps(result.to_json()))["ok"] is False


def test_files_are_read_even_where_the_case_has_faults(folder: Path):
    (folder / "case.toml").write_text(CASE.replace("format = 1", "format = 9"))
    whats = [each.what for each in check(folder).problems]
    assert any("format" in each for each in whats)
    assert any("depth_mm is 'x'" in each for each in whats)


def test_exit_code_is_that_of_the_measurement_where_only_that_is_wrong(folder: Path):
    from limbcli.problems import Problem
    from limbcli.stages.check import CheckResult

    wrong = Problem("a", "b", "c", family="measurement")
    warning = Problem("a", "b", "c", severity="warning")
    assert CheckResult(folder, (), (wrong,)).exit_code == 3
    assert CheckResult(folder, (), (warning,)).exit_code == 0
