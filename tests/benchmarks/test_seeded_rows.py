"""The runner that studies share: a row is made once, whatever ends the study."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import FitError
from tests.benchmarks.seeded_rows import counted, held, kept, made, succeeded


def drawn(seed: int) -> dict[str, object]:
    if seed == 2:
        raise FitError("no fit", where="seed 2", fix="none")
    value = float(np.random.default_rng(seed).standard_normal())
    return {"m": np.float64(value), "m_covered": value > 0.0}


SEEDS = {(seed,): seed for seed in range(4)}


@pytest.mark.parametrize("processes", [1, 2])
def test_rows_are_kept_in_order_and_a_failure_is_one(tmp_path: Path, processes: int, capsys) -> None:
    path = tmp_path / "rows.jsonl"
    rows = made(path, SEEDS, drawn, processes=processes)
    assert [row["seed"] for row in rows] == [0, 1, 2, 3]
    assert rows[2] == {"seed": 2, "no_result": "no fit"}
    assert kept(path) == rows
    assert len(capsys.readouterr().out.splitlines()) == 4
    assert counted(rows) == "4 seeds, 1 without a result"
    inside = sum(row["m"] > 0.0 for row in succeeded(rows))
    assert held(rows, "m").startswith(f"m: truth inside {inside} of 3; median ")


def test_a_study_goes_on_and_makes_no_row_again(tmp_path: Path) -> None:
    path, asked = tmp_path / "rows.jsonl", []

    def one(seed: int) -> dict[str, object]:
        if seed == 2 and len(asked) == 2:
            raise KeyboardInterrupt
        asked.append(seed)
        return {"value": seed}

    with pytest.raises(KeyboardInterrupt):
        made(path, SEEDS, one, show=None)
    assert [row["seed"] for row in kept(path)] == [0, 1]
    asked.append(None)
    assert [row["value"] for row in made(path, SEEDS, one, show=None)] == [0, 1, 2, 3]
    assert asked == [0, 1, None, 2, 3]


def test_keys_of_several_values_tell_rows_apart_and_a_job_may_give_several(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    jobs = {("a", 1): 2, ("a", 2): 1}

    def one(n: int) -> list[dict[str, object]]:
        return [{"part": k} for k in range(n)]

    for _ in range(2):
        rows = made(path, jobs, one, key=("arm", "seed"), show=None)
        assert [(row["arm"], row["seed"], row["part"]) for row in rows] == [
            ("a", 1, 0),
            ("a", 1, 1),
            ("a", 2, 0),
        ]


def test_without_a_file_nothing_is_kept_and_after_the_time_none_is_begun() -> None:
    assert kept(None) == []
    assert [row["seed"] for row in made(None, {(1,): 1}, drawn, show=None)] == [1]
    assert made(None, SEEDS, drawn, until=time.monotonic() - 1.0) == []


def test_a_value_called_error_is_no_failure() -> None:
    """A study may note the error of what it found; only a LimbError leaves a row without a result."""
    rows = made(None, SEEDS, lambda seed: {"error": [0.1 * seed]} if seed < 2 else drawn(seed), show=None)
    assert [row["seed"] for row in succeeded(rows)] == [0, 1, 3]
