"""A log is judged by what it says; record files give back whole steps only."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import SolveError
from limbcli.feb.log import LogReader, check_complete, read_log
from limbcli.feb.records import read_records


def test_a_complete_log_tells_version_cost_and_end(data: Path) -> None:
    path = data / "log-normal.txt"
    log = read_log(path)
    assert (log.version, log.ending, log.linear_solver) == ("4.9.1", "normal", "pardiso")
    assert log.times == (0.25, 0.5, 1.0)
    assert (log.n_iterations, log.n_reformations, log.n_retries, log.n_equations) == (12, 3, 0, 150)
    assert log.seconds == 2.125
    assert log.warnings == ('Zero mass for rigid body "probe."',)
    assert log.errors == ()
    check_complete(log, path, end_time=1.0)


@pytest.mark.parametrize(
    ("line", "version"),
    [
        ("  version 4.11.0", "4.11.0"),
        ("  version 4.11.0.65622b536", "4.11.0.65622b536"),
        ("  version 4.9.0.0a1b2c3d4", "4.9.0.0a1b2c3d4"),
        ("FEBio version  = 4.11.0.65622b536 (DEBUG)", "4.11.0.65622b536"),
        ("FEBio version  = 4.8.0", "4.8.0"),
    ],
)
def test_a_release_and_a_build_from_git_tell_their_version(
    data: Path, tmp_path: Path, line: str, version: str
) -> None:
    """febio::getVersionString (FEBioLib/version.cpp) appends the commit outside the master branch."""
    path = tmp_path / "model.log"
    path.write_text((data / "log-normal.txt").read_text().replace("  version 4.9.1", line, 1))
    assert read_log(path).version == version
    check_complete(read_log(path), path, end_time=1.0)


def test_a_normal_end_before_the_load_is_done_is_an_error(data: Path) -> None:
    path = data / "log-normal.txt"
    with pytest.raises(SolveError, match="and not at 2"):
        check_complete(read_log(path), path, end_time=2.0)


def test_a_failed_log_raises_with_febios_words_and_last_lines(data: Path) -> None:
    path = data / "log-failed.txt"
    log = read_log(path)
    assert (log.ending, log.times, log.n_retries) == ("error", (0.25,), 1)
    assert log.errors == ("Negative jacobian detected.", "12 negative jacobians detected.")
    with pytest.raises(SolveError) as caught:
        check_complete(log, path, end_time=1.0)
    assert "12 negative jacobians" in str(caught.value)
    assert "Max nr. of retries reached." in str(caught.value)
    assert "E R R O R   T E R M I N A T I O N" in str(caught.value)
    assert caught.value.facts["time_reached"] == 0.25


def test_a_log_that_breaks_off_is_not_complete(data: Path) -> None:
    path = data / "log-stopped.txt"
    log = read_log(path)
    assert (log.ending, log.times) == ("none", (0.25, 0.5))
    assert log.n_iterations > 7
    with pytest.raises(SolveError, match="ends abruptly"):
        check_complete(log, path, end_time=1.0)


def test_no_log_and_a_strange_log_raise(tmp_path: Path) -> None:
    with pytest.raises(SolveError, match="no log"):
        read_log(tmp_path / "model.log")
    (tmp_path / "model.log").write_text("bash: febio4: cannot execute\nlast words\n")
    with pytest.raises(SolveError, match="last words"):
        read_log(tmp_path / "model.log")


def test_iterations_are_told_as_they_come(data: Path) -> None:
    reader = LogReader()
    lines = (data / "log-normal.txt").read_text().splitlines()
    reported = [each for each in map(reader.feed, lines) if each is not None]
    assert len(reported) == 12
    where = [(each.step, each.time, each.number) for each in reported[2:5]]
    assert where == [
        (1, 0.25, 3),
        (2, 0.5, 1),
        (2, 0.5, 2),
    ]
    assert reported[0].worst() == (0.1, 1e-5)


# ---------------------------------------------------------------- records


def block(step: int, time: float, rows: list[list[float]], comma: str = ",") -> str:
    body = "".join(comma.join(f"{value:.10g}" for value in row) + "\n" for row in rows)
    return f"*Step  = {step}\n*Time  = {time}\n*Data  = z;Fz\n{body}"


def test_records_give_times_ids_and_values(tmp_path: Path) -> None:
    path = tmp_path / "nodes.csv"
    for comma in (",", " "):
        path.write_text(
            block(0, 0, [[3, 0, 0], [8, 0, 1]], comma) + block(4, 0.5, [[3, 1, 2], [8, -3, 4e-3]], comma)
        )
        records = read_records(path)
        assert records.steps.tolist() == [0, 4]
        assert records.times.tolist() == [0, 0.5]
        assert records.ids.tolist() == [3, 8]
        assert records.values[1].tolist() == [[1, 2], [-3, 4e-3]]
        assert not records.truncated


@pytest.mark.parametrize("cut", [1, 3, 9, 14, 20, 40])
def test_a_cut_last_step_is_left_out_and_said(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "nodes.csv"
    rows = [[1, 0.125, 2.5], [2, 0.25, 3.5]]
    whole = block(0, 0, rows) + block(1, 0.5, rows)
    path.write_text(whole + block(2, 1.0, rows)[:-cut])
    records = read_records(path)
    assert records.truncated
    assert records.times.tolist() == [0, 0.5]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no complete step"),
        (block(0, 0, [[1, 2, 3]])[:-2], "no complete step"),
        (block(0, 0, [[1, 2, 3]]) + block(1, 1, [[1, 2]]) + block(2, 2, [[1, 2, 3]]), "at time 1"),
        (block(0, 0, [[1, 2, 3]]) + block(1, 1, [[2, 2, 3]]), "at time 1"),
        (block(0, 0, [[1, 2, 3]]) + block(1, 1, [[1, float("nan"), 3]]), "not a number"),
        (block(0, 0, [[1, 2, 3]]) + "*Step = x\n" + block(2, 2, [[1, 2, 3]]), "in its middle"),
    ],
)
def test_what_is_not_a_record_file_raises(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "nodes.csv"
    path.write_text(text)
    with pytest.raises(SolveError, match=words):
        read_records(path)


def test_a_missing_record_file_raises(tmp_path: Path) -> None:
    with pytest.raises(SolveError, match=r"nodes\.csv is missing"):
        read_records(tmp_path / "nodes.csv")


# ---------------------------------------------------------------- stored logs of FEBio 4.11


def test_the_golden_normal_log(golden: Path) -> None:
    path = golden / "log-normal" / "model.log"
    log = read_log(path)
    check_complete(log, path, end_time=1.0)
    assert (log.version, log.n_iterations, log.n_reformations, log.n_equations) == ("4.11.0", 81, 11, 679)
    assert np.allclose(log.times, np.arange(1, 11) / 10)
    assert log.linear_solver == "pardiso"
    assert log.seconds == 1.07128
    assert len(log.warnings) == 4


def test_the_golden_failed_log(golden: Path) -> None:
    path = golden / "log-failed" / "model.log"
    log = read_log(path)
    assert (log.ending, log.times, log.n_retries) == ("error", (), 8)
    assert log.errors[-1] == "53 negative jacobians detected."
    with pytest.raises(SolveError, match=r"(?s)8 retries.*Max\. nr of retries reached"):
        check_complete(log, path, end_time=1.0)


def test_the_golden_killed_log_and_its_records(golden: Path) -> None:
    path = golden / "log-killed" / "model.log"
    log = read_log(path)
    assert (log.ending, log.times[-1]) == ("none", 0.4)
    with pytest.raises(SolveError, match="ends abruptly"):
        check_complete(log, path, end_time=1.0)
    assert read_records(path.parent / "rigid_body.csv").times[-1] == 0.5


def test_golden_records_are_read(golden: Path) -> None:
    records = read_records(golden / "log-normal" / "rigid_body.csv", n_columns=12)
    assert records.values.shape == (11, 1, 12)
    assert records.values[-1, 0, 8] == pytest.approx(-0.884407, rel=1e-5)  # Fz in effect-base-tet4's README
    elements = read_records(golden / "effect-base" / "elements.csv")
    assert elements.values.shape == (1, 1287, 17)
    with pytest.raises(SolveError, match="not"):
        read_records(golden / "log-normal" / "rigid_body.csv", n_columns=6)
