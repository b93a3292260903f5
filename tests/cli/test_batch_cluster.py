"""A batch on a real scheduler with two worker processes: each part once, whole, whatever befalls a worker.

The stages are small ones (quick_stages.py); scheduler, workers, locks, files and command are the real ones.
"""

from __future__ import annotations

import collections
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("distributed", reason="needs the extra `cluster`")

import dask
from dask.system import CPU_COUNT
from distributed import Client, LocalCluster

import limbcli
from limbcli.cli.app import main
from limbcli.progress import Progress
from limbcli.stages import batch_cluster
from limbcli.stages.batching import cluster
from tests.benchmarks.left_behind import contents, strays
from tests.case.test_case_text import two_sites

pytestmark = pytest.mark.slow

PRELOAD = str(Path(__file__).parent / "quick_stages.py")
OF_SITES = [f"{stage}/{site}" for stage in ("mesh", "build-feb", "run", "fit") for site in ("p1", "p2")]
ALL = sorted(["segment", "report", *OF_SITES])


@pytest.fixture(scope="module")
def workers() -> Iterator[LocalCluster]:
    """Two processes; a part that two of them do not survive is given up."""
    with (
        dask.config.set(cluster._LOCAL),
        LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None,
            preload=[PRELOAD], silence_logs=50, scheduler_kwargs={"allowed_failures": 1},
        ) as started,
    ):  # fmt: skip
        yield started


def cases(folder: Path, *names: str) -> list[Path]:
    return [two_sites(folder / name) for name in names]


def batch(workers: LocalCluster, *words: str | Path) -> int:
    """Exit code of `limbcli batch` on these workers, after all are there (again)."""
    with Client(workers) as client:
        client.wait_for_workers(2)
    arguments = ["batch", *map(str, words), "--scheduler", workers.scheduler_address]
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", ["limbcli", *arguments])
            main(arguments)
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def left(out: Path) -> list[str]:
    """Stages (and sites) with a whole result: what its files should say is there."""
    found = []
    for path in out.glob("*/**/*.json"):
        result = json.loads(path.read_text())
        if path.stem == result.get("stage"):
            text = path.parent / (result["files"].get("text") or result["files"]["page"])
            assert text.read_text() == f"whole {' '.join(path.parent.relative_to(out).parts)}"
            found.append(str(path.parent.relative_to(out)))
    return sorted(found)


def log(case: Path) -> collections.Counter[str]:
    """How often each stage began and ended."""
    lines = (case / "log.txt").read_text().splitlines()
    return collections.Counter(line.rpartition(" ")[0] for line in lines)


def ended(number: str, *, within_s: float = 30.0) -> bool:
    """Whether the process of that number is gone, or goes soon."""
    end = time.monotonic() + within_s
    while (there := Path(f"/proc/{number}/cmdline").is_file()) and time.monotonic() < end:
        try:
            there = bool(Path(f"/proc/{number}/cmdline").read_bytes())  # empty: it has ended, and waits
        except OSError:
            there = False
        if not there:
            break
        time.sleep(0.1)
    return not there


def test_every_part_is_done_once_by_two_processes_and_then_nothing(workers, tmp_path: Path, capsys):
    several = cases(tmp_path, "a", "b")
    assert batch(workers, *several, "--out", tmp_path / "out") == 0
    reported = capsys.readouterr()
    assert re.search(r"2 worker processes; dashboard: http", reported.err)
    assert re.search(r"a: done", reported.err)
    assert reported.out.splitlines()[-1].endswith("index.html")
    processes = set()
    for case in several:
        assert left(tmp_path / "out" / case.name) == ALL
        assert set(log(case).values()) == {1}
        processes |= {line.split()[-1] for line in (case / "log.txt").read_text().splitlines()}
    assert len(processes) == 2
    assert str(os.getpid()) not in processes
    result = json.loads((tmp_path / "out" / "a" / "fit" / "p1" / "fit.json").read_text())
    assert result["data"]["threads"] == "1"
    out, scheduler = tmp_path / "out" / "a", workers.scheduler_address
    command = f"limbcli batch {several[0]} --out {out} --scheduler {scheduler}"
    assert result["provenance"]["command"] == command
    before = contents(tmp_path / "out")
    assert batch(workers, *several, "--out", tmp_path / "out") == 0
    assert "nothing changed" in capsys.readouterr().err
    after = contents(tmp_path / "out")
    assert {name: each for name, each in after.items() if name != "index.html"} == {
        name: each for name, each in before.items() if name != "index.html"
    }
    assert all(set(log(case).values()) == {1} for case in several)
    assert not strays(tmp_path / "out", tmp_path / "none")


def test_local_processes_share_the_cores_and_leave_nothing_behind(tmp_path: Path, capsys, monkeypatch):
    (tmp_path / "scratch").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "scratch"))
    several = cases(tmp_path, "a", "b")
    with dask.config.set({"distributed.worker.preload": [PRELOAD]}), pytest.raises(SystemExit) as stop:
        main(["batch", *map(str, several), "--out", str(tmp_path / "out"), "--jobs", "2"])
    assert stop.value.code in (None, 0)
    assert "2 worker processes; dashboard: http://127.0.0.1:" in capsys.readouterr().err
    result = json.loads((tmp_path / "out" / "a" / "fit" / "p1" / "fit.json").read_text())
    assert result["data"]["threads"] == str(max(1, CPU_COUNT // 2))
    assert [left(tmp_path / "out" / each.name) for each in several] == [ALL, ALL]
    assert not strays(tmp_path / "out", tmp_path / "scratch")
    numbers = {line.split()[-1] for case in several for line in (case / "log.txt").read_text().splitlines()}
    assert all(map(ended, numbers))


def test_what_a_killed_process_was_at_is_done_by_another(workers, tmp_path: Path, capsys):
    several = cases(tmp_path, "a", "b")
    (several[0] / "wait-run-p2").touch()
    at = several[0] / "at-run-p2"

    def kill() -> None:
        while not at.exists():
            time.sleep(0.05)
        os.kill(int(at.read_text()), signal.SIGKILL)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    assert batch(workers, *several, "--out", tmp_path / "out") == 0
    assert not killer.is_alive()
    assert "lost during the run: 1" in capsys.readouterr().err
    counted = log(several[0])
    assert counted.pop("begin run p2") == 2
    assert set(counted.values()) == {1}, "what was whole before the kill is not done again"
    assert set(log(several[1]).values()) == {1}
    assert [left(tmp_path / "out" / each.name) for each in several] == [ALL, ALL]
    assert not strays(tmp_path / "out", tmp_path / "none")


def test_every_place_is_diagnosed_once_its_sites_are_fitted(workers, tmp_path: Path, capsys):
    together, apart, fails = several = cases(tmp_path, "together", "apart", "fails")
    (apart / "apart").touch()
    (fails / "fail-run-p1").touch()
    out = tmp_path / "out"
    assert batch(workers, *several, "--diagnose", "--out", out) == 5
    diagnosed = sorted([*ALL, "diagnose/p1", "diagnose/p2"])
    assert [left(out / each.name) for each in (together, apart)] == [diagnosed, diagnosed]
    for case in (together, apart):
        lines = [line.rpartition(" ")[0] for line in (case / "log.txt").read_text().splitlines()]
        for site in ("p1", "p2"):
            assert lines.count(f"begin diagnose {site}") == 1
            assert lines.index(f"end fit {site}") < lines.index(f"begin diagnose {site}")
    assert not [each for each in left(out / "fails") if "diagnose" in each]
    kept = json.loads((out / "fails" / "diagnose" / "p2" / "error.json").read_text())
    assert "because `run p1` failed" in kept["what"]
    capsys.readouterr()
    assert batch(workers, together, apart, "--diagnose", "--out", out) == 0
    assert capsys.readouterr().err.count("nothing changed") == 2


def test_an_interrupted_batch_ends_at_once_and_leaves_no_process(tmp_path: Path):
    """As Ctrl-C on a terminal: all of its processes hear of it."""
    case, out = two_sites(tmp_path / "a"), tmp_path / "out"
    (case / "wait-run-p2").touch()
    (tmp_path / "scratch").mkdir()
    environment = {
        **os.environ,
        "DASK_DISTRIBUTED__WORKER__PRELOAD": PRELOAD,
        "TMPDIR": str(tmp_path / "scratch"),
    }
    words = ["batch", str(case), "--out", str(out), "--jobs", "2"]
    command = [sys.executable, "-m", "limbcli", *words]
    process = subprocess.Popen(
        command, env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # not so in the background
    )  # fmt: skip
    at = case / "at-run-p2"
    while not at.exists():
        assert process.poll() is None
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    reported = process.communicate(timeout=300)[1]  # nobody waits for the part to end
    assert process.returncode == 130
    assert "interrupted; no incomplete file was kept" in reported
    assert "Traceback" not in reported
    assert ended(at.read_text())
    assert "run/p2" not in left(out)
    assert not list((tmp_path / "scratch").iterdir())


def test_who_failed_where_and_why_is_listed_and_stops_nobody(workers, tmp_path: Path, capsys):
    several = cases(tmp_path, "foreseen", "fault", "crash", "fine", "unreadable")
    (several[0] / "fail-mesh-p2").touch()
    (several[1] / "fault-fit-p1").touch()
    (several[2] / "crash-mesh-p1").touch()
    (several[4] / "p1.csv").unlink()
    out = tmp_path / "out"
    assert batch(workers, *several, tmp_path / "nowhere", "--out", out) == 70
    reported = capsys.readouterr().err
    listed = reported[reported.index("cases failed:") :]
    assert reported.count("5 of 6 cases failed") == 1
    assert "mesh p2: no skin under the probe\n      where: mesh p2\n      fix:   move it" in listed
    assert "of all things" in listed
    assert "mesh p1: every process that worked on it was lost (2 in turn)" in listed
    assert "p1.csv" in listed
    assert "there is no case folder" in listed
    assert "Traceback" not in reported
    gone = {"foreseen": 4 * ["p2"], "crash": 4 * ["p1"], "fault": ["fit/p1"], "fine": []}
    for name, missing in gone.items():
        found = left(out / name)
        assert "report" in found
        lacking = sorted(set(ALL) - set(found))
        assert len(lacking) == len(missing)
        assert all(each.endswith(tuple(missing)) for each in lacking)
    for stage in ("mesh", "fit"):  # a lost process leaves nothing: it is said where the report looks
        kept = json.loads((out / "crash" / stage / "p1" / "error.json").read_text())
        assert ("lost" if stage == "mesh" else "was not run") in kept["what"]
    for path in several:
        for each in path.glob("[fc]*-*"):
            each.unlink()
    assert batch(workers, *several[:4], "--out", out) == 0, "mended, the same batch goes on where it was"
    assert log(several[3])["begin fit p1"] == 1


def test_that_no_worker_is_left_is_said_and_the_batch_goes_on_with_new_ones(
    tmp_path: Path, capsys, monkeypatch
):
    monkeypatch.setattr(batch_cluster, "_LOOK_S", 0.2)
    (case,) = cases(tmp_path, "a")
    (case / "wait-mesh-p1").touch()
    (case / "pause-mesh-p1").touch()  # so that the new worker is seen before all is done
    with (
        dask.config.set(cluster._LOCAL),
        LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None,
            preload=[PRELOAD], silence_logs=50,
        ) as started,
    ):  # fmt: skip

        def leaves_and_comes_back() -> None:
            while not (case / "at-mesh-p1").exists():
                time.sleep(0.1)
            started.scale(0)
            time.sleep(2)
            started.scale(1)

        coming = threading.Thread(target=leaves_and_comes_back)
        coming.start()
        with pytest.raises(SystemExit) as stop:
            main(
                ["batch", str(case), "--out", str(tmp_path / "out"), "--scheduler", started.scheduler_address]
            )
        assert not stop.value.code
        coming.join()
    reported = capsys.readouterr().err
    assert "no worker is left: waiting for one" in reported
    assert "workers are available again: 1" in reported
    assert left(tmp_path / "out") == ALL


def test_a_call_from_python_is_told_as_such_by_what_workers_leave(workers, tmp_path: Path):
    (case,) = cases(tmp_path, "a")
    (found,) = limbcli.batch(case, out=tmp_path / "out", scheduler=workers.scheduler_address)
    assert found.ok
    assert left(tmp_path / "out") == ALL
    result = json.loads((tmp_path / "out" / "fit" / "p1" / "fit.json").read_text())
    assert result["provenance"]["command"].startswith(f"limbcli.batch('{case}', out=")


def test_a_worker_with_other_code_is_refused_before_anything_begins(workers, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(cluster, "code_hash", lambda: "0123456789")
    case = two_sites(tmp_path / "a")
    assert batch(workers, case, "--out", tmp_path / "out") == 4
    reported = capsys.readouterr().err
    assert "2 of 2 workers cannot be used" in reported
    assert "with other sources" in reported
    assert not (case / "log.txt").exists()


def _change(code: str) -> str:
    """On a worker: the hash of its sources, until it is put back; returns the one before."""
    from limbcli.stages.batching import cluster

    before = cluster.code_hash()
    cluster.code_hash = lambda: code  # type: ignore[assignment]
    return before


def test_a_worker_that_comes_later_with_other_code_refuses_and_the_others_do_it(
    workers, tmp_path: Path, capsys, monkeypatch
):
    real, changed = cluster.refuse_unlike, {}

    def and_then_one_changes(client) -> None:
        real(client)
        first = min(client.scheduler_info(n_workers=-1)["workers"])
        changed.update(client.run(_change, "0123456789", workers=[first]))

    monkeypatch.setattr(cluster, "refuse_unlike", and_then_one_changes)
    several = cases(tmp_path, "a", "b")
    assert batch(workers, *several, "--out", tmp_path / "out") == 0
    reported = capsys.readouterr().err
    assert reported.count("a worker rejected the work: it has limbcli") == 1
    assert [left(tmp_path / "out" / each.name) for each in several] == [ALL, ALL]
    processes = {line.split()[-1] for case in several for line in (case / "log.txt").read_text().splitlines()}
    assert len(processes) == 1
    with Client(workers) as client:
        for address, own in changed.items():
            client.run(_change, own, workers=[address])


def test_no_scheduler_and_no_dask_are_told(tmp_path: Path, capsys, monkeypatch):
    case = two_sites(tmp_path / "a")
    monkeypatch.setattr(cluster, "_WAIT_S", 1)
    with pytest.raises(SystemExit) as stop:
        main(["batch", str(case), "--out", str(tmp_path / "out"), "--scheduler", "tcp://127.0.0.1:1"])
    assert stop.value.code == 4
    assert "no scheduler answers at tcp://127.0.0.1:1" in capsys.readouterr().err
    monkeypatch.setattr(cluster, "is_installed", lambda: False)
    for words in (["--scheduler", "tcp://127.0.0.1:1"], ["--jobs", "2"]):
        with pytest.raises(SystemExit) as stop:
            main(["batch", str(case), "--out", str(tmp_path / "out"), *words])
        assert stop.value.code == 4
        reported = capsys.readouterr().err
        assert "limbcli[cluster]" in reported
        assert words[0] in reported


def test_two_cases_are_never_given_one_output_folder(tmp_path: Path, capsys):
    several = cases(tmp_path, "x/limb", "y/limb")
    with pytest.raises(SystemExit) as stop:
        main(["batch", *map(str, several), "--out", str(tmp_path / "out")])
    assert stop.value.code == 2
    assert "would have the same output folder" in capsys.readouterr().err


def test_time_left_is_told_once_there_is_something_to_go_by(tmp_path: Path):
    several = batch_cluster._Together(None, None, [(tmp_path / "a", tmp_path)], None)
    assert several._left() == ""
    several.n_parts, several.n_done, several._begun = 10, 4, time.monotonic() - 400
    assert several._left() == "about 10 min left"


def test_a_part_that_is_not_at_a_stage_yet_is_told_by_its_name(tmp_path: Path):
    reported, cases = [], [(tmp_path / "a", tmp_path)]
    several = batch_cluster._Together(None, None, cases, Progress(lambda *e: reported.append(e)))
    for stage in ("", "mesh", ""):
        several._hear((0.0, {"part": "a", "stage": stage, "text": ""}))
    assert [facts["name"] for _, facts in reported] == ["cases, a", "cases, a: mesh", "cases, a"]
    assert several.stages == {"a": "mesh"}
