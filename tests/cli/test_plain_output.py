"""No control character of a user's file reaches the terminal, no cell of ours is a spreadsheet's formula."""

from __future__ import annotations

import ast
import csv
import io
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from limbcli.cli import entry
from limbcli.cli.output import report_error
from limbcli.cli.terminal import emit
from limbcli.drawing import write_data
from limbcli.errors import CaseError
from limbcli.files.plain_text import shown, text_cell
from limbcli.fitting.exports import write_parameters, write_table
from limbcli.results import StageResult
from tests.cohort_rows import people, written

EVIL = "P\x1b]0;owned\x07\x1b[2J\x9b31m\u202egnp\r\x08\x7f\u2028"
CLI = Path(entry.__file__).parent


def controls(text: str) -> list[str]:
    return [each for each in text if each not in "\n\t" and shown(each) != each]


def test_results_and_errors_are_printed_without_control_characters(
    tmp_path, capsys: pytest.CaptureFixture[str]
):
    emit(StageResult("fit", "S1", tmp_path, site=EVIL, summary=(EVIL,), warnings=(EVIL,)), as_json=False)
    report_error(CaseError(EVIL, where=EVIL, fix="line\n\tanother"), as_json=True)
    out, err = capsys.readouterr()
    assert "owned" in out
    assert "owned" in err
    assert "line\n\tanother" in err
    assert controls(out + err) == []


def test_every_command_prints_by_the_one_function():
    """Only output.py and JSON (which escapes) print; the progress line's own codes stay in terminal.py."""
    for path in CLI.glob("*.py"):
        calls = [
            each
            for each in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(each, ast.Call)
        ]
        prints = [each for each in calls if isinstance(each.func, ast.Name) and each.func.id == "print"]
        is_json = ["json.dumps" in ast.unparse(each) for each in prints]
        assert path.name == "output.py" or all(is_json), path.name


@pytest.mark.slow
def test_the_cohort_prints_no_control_character_of_its_table(tmp_path: Path):
    mean, spread = np.log([0.006, 0.010, 4.0]), np.diag([0.35, 0.3, 0.2]) ** 2
    rows = people(3, mean=mean, spread=spread, rng=np.random.default_rng(7))[0]
    table = written(tmp_path / "t.csv", [{**each, "location": "LL\x1b[2J"} for each in rows])
    command = [sys.executable, "-m", "limbcli", "cohort", str(table), "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env={**os.environ})
    assert done.returncode != 0
    assert "LL" in done.stderr
    assert controls(done.stdout + done.stderr) == []


@pytest.mark.parametrize("name", ["=1+1", "+cmd", "-cmd", "@SUM(A1)", "\t=1", "\r=1", "=HYPERLINK(1)"])
def test_no_cell_is_a_formula(tmp_path: Path, name: str):
    path = tmp_path / "a.csv"
    row = {"site": name, "step": "two_step", "parameter": "m", "value": -1.5, "flag": "weak", "words": name}
    write_parameters(path, [row])
    (found,) = csv.DictReader(io.StringIO(path.read_text()))
    assert found["value"] == "-1.5", "numbers stay numbers"
    write_table(tmp_path / "b.csv", {"name": [name], "x": np.array([-2.0])})
    cells = [
        found["site"],
        found["words"],
        next(csv.reader([(tmp_path / "b.csv").read_text().splitlines()[1]]))[0],
    ]
    for cell in cells:
        assert cell.startswith("'")
        assert controls(cell) == []
    assert text_cell("-2.5e3") == "-2.5e3"


def test_the_data_of_a_figure_hold_no_formula(tmp_path: Path):
    from matplotlib.figure import Figure

    figure = Figure()
    axes = figure.add_subplot(title="=1+1")
    axes.plot([0.0, -1.0], [1.0, 2.0], label="@sum")
    write_data(figure, tmp_path / "a.csv")
    cells = [cell for row in csv.reader((tmp_path / "a.csv").read_text().splitlines()) for cell in row]
    assert "-1" in cells
    assert not any(cell[:1] in ("=", "@", "+") for cell in cells)


def test_the_command_shows_no_warnings_of_libraries(monkeypatch: pytest.MonkeyPatch, capsys):
    def run() -> None:
        warnings.warn("Glyph 128 missing from font(s)", UserWarning, stacklevel=1)

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        monkeypatch.setattr(sys, "warnoptions", [])
        monkeypatch.setattr("limbcli.cli.app.main", run)
        entry.main()
    assert "Glyph" not in capsys.readouterr().err
