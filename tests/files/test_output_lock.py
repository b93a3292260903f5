"""One writer at a time in an output folder: others wait and say so, or refuse; the dead hold nothing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from limbcli.cli.app import main
from limbcli.errors import CaseError
from limbcli.files import output_lock
from limbcli.files.output_lock import LOCK, one_writer, site_writer
from limbcli.progress import Progress
from tests.stages.chain_case import write_case

HOLD = """
import sys, time
from pathlib import Path
from limbcli.files.output_lock import one_writer
sys.argv = ["limbcli", "mesh", "limb"]
with one_writer(Path({folder!r})):
    print("held", flush=True)
    time.sleep({seconds})
"""


def holder(folder: Path, seconds: float = 60.0) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD.format(folder=str(folder), seconds=seconds)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


@pytest.mark.slow
def test_a_second_writer_waits_and_says_for_whom(tmp_path: Path):
    process = holder(tmp_path, seconds=1.5)
    reported: list[str] = []
    progress = Progress(lambda kind, facts: reported.append(facts["text"]))
    start = time.monotonic()
    with one_writer(tmp_path, progress=progress):
        waited = time.monotonic() - start
    process.wait(timeout=30)
    assert waited > 0.5
    (words,) = reported
    assert f"`limbcli mesh limb` (process {process.pid} on " in words
    assert str(tmp_path) in words


def test_without_waiting_it_is_refused(tmp_path: Path):
    process = holder(tmp_path)
    try:
        with pytest.raises(CaseError, match=str(process.pid)) as caught, one_writer(tmp_path, wait=False):
            pass
        assert "--no-wait" in caught.value.fix
    finally:
        process.kill()
        process.wait(timeout=30)


def test_the_lock_of_a_dead_holder_is_taken_over(tmp_path: Path):
    process = holder(tmp_path)
    process.send_signal(signal.SIGKILL)
    process.wait(timeout=30)
    assert (tmp_path / LOCK).is_file(), "what the dead one left"
    with one_writer(tmp_path, wait=False):
        assert str(os.getpid()) in (tmp_path / LOCK).read_text()
    assert not (tmp_path / LOCK).exists()


def test_two_are_never_in_at_once(tmp_path: Path):
    """Many writers in turn, each of which removes the lock's file when it leaves."""
    inside, most = [0], [0]

    def work() -> None:
        for _ in range(4):
            with one_writer(tmp_path):
                inside[0] += 1
                most[0] = max(most[0], inside[0])
                time.sleep(0.01)
                inside[0] -= 1

    threads = [threading.Thread(target=work) for _ in range(4)]
    for each in threads:
        each.start()
    for each in threads:
        each.join(timeout=60)
    assert most == [1]


def test_a_lock_on_a_file_that_was_removed_meanwhile_does_not_count(tmp_path: Path, monkeypatch):
    """Its holder left between our opening the file and our locking it."""
    lock, calls = output_lock._try, []

    def late(stream, **how):
        if not calls:
            (tmp_path / LOCK).unlink()
        calls.append(stream)
        return lock(stream, **how)

    monkeypatch.setattr(output_lock, "_try", late)
    with one_writer(tmp_path):
        assert (tmp_path / LOCK).is_file()
    assert len(calls) == 2


def test_a_folder_that_got_nothing_is_not_left(tmp_path: Path):
    with one_writer(tmp_path / "out"):
        pass
    assert not (tmp_path / "out").exists()
    with one_writer(tmp_path / "out"):
        (tmp_path / "out" / "mine").write_text("kept")
    assert os.listdir(tmp_path / "out") == ["mine"]


def test_a_folder_that_cannot_be_is_told_with_a_way_out():
    with pytest.raises(CaseError) as caught, one_writer(Path("/proc/limb")):
        pass
    assert "cannot be created (No such file" in caught.value.what
    assert (caught.value.where, caught.value.fix) == ("/proc/limb", "name another --out")


def test_sites_are_written_side_by_side_and_the_whole_case_by_none_beside_them(tmp_path: Path):
    with site_writer(tmp_path, "p1", wait=False), site_writer(tmp_path, "p2", wait=False):
        for beside in (one_writer(tmp_path, wait=False), site_writer(tmp_path, "p1", wait=False)):
            with pytest.raises(CaseError, match="is writing"), beside:
                pass
        assert (tmp_path / LOCK).is_file(), "whoever left did not take the others' lock away"
    assert not list(tmp_path.iterdir())
    with one_writer(tmp_path, wait=False):
        with pytest.raises(CaseError, match="is writing"), site_writer(tmp_path, "p1", wait=False):
            pass
        assert (tmp_path / LOCK).is_file()


@pytest.mark.parametrize(
    "command",
    ["segment", "mesh", "build-feb", "run", "fit", "diagnose", "report", "batch", "measure", "synth"],
)
def test_every_command_that_writes_takes_its_turn(tmp_path: Path, capsys, command: str):
    write_case(tmp_path / "case")
    out = tmp_path / "out"
    more = ["--out-case", str(tmp_path / "new")] if command == "synth" else []
    with one_writer(out), pytest.raises(SystemExit) as stop:
        main([command, str(tmp_path / "case"), "--out", str(out), "--no-wait", *more])
    assert stop.value.code == 2
    assert "is writing into this output folder" in capsys.readouterr().err
    assert not out.exists()
