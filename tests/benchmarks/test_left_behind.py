"""What the benchmarks of kills, loads and dependencies count: their own logic, without a run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement

from tests.benchmarks import dependencies, kills, load
from tests.benchmarks.left_behind import contents, differing, halves, strays
from tests.benchmarks.small_case import family


@pytest.fixture
def out(tmp_path: Path) -> Path:
    folder = tmp_path / "out" / "mesh"
    folder.mkdir(parents=True)
    (folder / "model.npz").write_bytes(b"model")
    (folder / "mesh.json").write_text(json.dumps({"data": {"n": 3}, "provenance": {"seconds": 1.0}}))
    (folder / "progress.jsonl").write_text("{}")
    return tmp_path / "out"


def test_a_difference_is_noticed_and_a_time_is_none(out: Path):
    before = contents(out)
    (out / "mesh" / "mesh.json").write_text(json.dumps({"data": {"n": 3}, "provenance": {"seconds": 9.0}}))
    (out / "mesh" / "progress.jsonl").write_text("{} {}")
    assert differing(contents(out), before) == []
    (out / "mesh" / "mesh.json").write_text(json.dumps({"data": {"n": 4}, "provenance": {"seconds": 1.0}}))
    assert differing(contents(out), before) == ["mesh/mesh.json"]
    (out / "mesh" / "model.npz").unlink()
    (out / "mesh" / "more.csv").write_text("1")
    assert differing(contents(out), before) == ["mesh/mesh.json", "mesh/model.npz", "mesh/more.csv"]


def test_a_half_written_file_is_noticed_unless_its_name_says_so(out: Path):
    after = contents(out)
    (out / "mesh" / ".partial-1-a").mkdir()
    (out / "mesh" / ".partial-1-a" / "model.npz").write_bytes(b"mo")
    (out / ".batch.json").write_text('{"mesh": 1}')
    assert halves(out, {}, after, set()) == []
    (out / "mesh" / "model.npz").write_bytes(b"mo")
    (out / ".batch.json").write_text('{"mesh"')
    assert halves(out, {}, after, set()) == [".batch.json", "mesh/model.npz"]


def test_a_stray_file_is_counted(out: Path, tmp_path: Path):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    assert strays(out, scratch) == []
    (out / "mesh" / ".partial-1-a").mkdir()
    (scratch / "limbcli-scratch-1").mkdir()
    assert strays(out, scratch) == ["mesh/.partial-1-a", "scratch/limbcli-scratch-1"]


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc")
def test_an_orphan_belongs_to_the_family():
    mark = f"test-{os.getpid()}"
    waits = "print('runs', flush=True); input()"
    sleeper = f"import subprocess, sys; subprocess.Popen([sys.executable, '-c', {waits!r}], stdin=0)"
    environment = {**os.environ, "LIMBCLI_BENCHMARK": mark}
    pipe = subprocess.PIPE
    parent = subprocess.Popen([sys.executable, "-c", sleeper], env=environment, stdin=pipe, stdout=pipe)
    parent.wait()
    assert parent.stdout is not None
    assert parent.stdout.readline() == b"runs\n"  # by the orphan: while it is being started it has no mark
    living = family(mark)
    assert len(living) == 1
    assert parent.pid not in living
    assert min(living.values()) > 1e6
    assert parent.stdin is not None
    parent.stdin.close()
    parent.stdout.close()


def test_kills_cover_the_whole_duration_and_aim_at_children():
    alone = kills.plan(6, kills.Undisturbed(10.0, None, {}, frozenset()), np.random.default_rng(7))
    assert [int(6 * each.share) for each in alone] == list(range(6))
    beside = kills.plan(6, kills.Undisturbed(10.0, 0.5, {}, frozenset()), np.random.default_rng(7))
    assert [each.target for each in beside] == 2 * [kills.COMMAND, kills.BESIDE, kills.CHILD]


def test_memory_that_grows_has_a_slope():
    flat = [load.Sample(k, k // 4, 300.0 + 50 * (k % 4)) for k in range(80)]
    grows = [load.Sample(each.time, each.done, each.memory + 2.0 * each.done) for each in flat]
    assert load.slope(flat, 20)[0] == pytest.approx(0.0, abs=1e-6)
    assert load.slope(grows, 20)[0] == pytest.approx(200.0)
    assert load.memory_at(grows, 0.5, 20) == pytest.approx(450.0 + 2 * 9)
    left = load.Load(20, [*grows, load.Sample(80, 20, 0.0)], [0, 0], 0, [])
    assert left.is_sound
    assert not load.Load(20, left.samples, [0, 0], 1, []).is_sound
    assert not load.Load(20, left.samples[:-1], [0, 0], 0, []).is_sound


def test_every_dependency_has_a_lower_bound_and_a_licence():
    wanted = dependencies.requirements()
    assert all(dependencies.lower_bound(each) for each in wanted)
    with pytest.raises(ValueError, match="no lower bound"):
        dependencies.lower_bound(Requirement("numpy"))
    rows = {name: licence for name, _, licence in dependencies.licences(wanted)}
    assert {each.name.lower() for each in wanted} <= rows.keys()
    assert "MIT" in rows["typer"]


def test_an_end_that_fails_is_told():
    end = dependencies.End("oldest", Path("python"), moved={"typer"}, versions={"typer": "0.15.4"})
    end.note("limbcli --version", "no")
    assert not end.failed
    end.note("smoke tests", "1 failed", failed=True)
    assert end.failed
    rows = dependencies.table([end], [Requirement("typer>=0.15")])
    assert rows[2:] == [
        "| typer | >=0.15 | 0.15.4* |", "| limbcli --version |  | no |", "| smoke tests |  | 1 failed |"
    ]  # fmt: skip
