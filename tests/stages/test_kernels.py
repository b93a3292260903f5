"""Kernels are compiled by other processes only where that helps, and nothing waits for ever."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
import time
from pathlib import Path

import pytest

from limbcli import background_processes
from limbcli.config import THREADS
from limbcli.stages.machine.kernels import PARTS, compile_ahead


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The parts that are begun, on a machine of two cores without kernels."""
    found: list[str] = []
    monkeypatch.setattr("limbcli.solvers.reference.kernels_are_there", lambda: False)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    for name in (THREADS, "OMP_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(background_processes, "start", lambda module, *parts: found.extend(parts))
    return found


def test_on_a_fresh_machine_all_parts_are_begun(begun: list[str]):
    compile_ahead()
    assert begun == list(PARTS)


def test_nothing_is_begun_where_kernels_are_there(begun: list[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("limbcli.solvers.reference.kernels_are_there", lambda: True)
    compile_ahead()
    assert not begun


def test_nothing_is_begun_on_one_core_or_thread(begun: list[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(THREADS, "1")
    compile_ahead()
    monkeypatch.delenv(THREADS)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    compile_ahead()
    assert not begun


def test_nothing_is_begun_for_another_solver(begun: list[str], tmp_path: Path):
    compile_ahead(solver="febio", febio=tmp_path / "none")
    assert not begun


@pytest.mark.parametrize("part", PARTS)
def test_every_part_runs_to_its_end(part: str):
    PARTS[part]()


def test_waiting_ends_when_they_do_and_a_failure_is_no_matter():
    background_processes.start("limbcli.stages.machine.kernels", "no such part")
    background_processes.wait()
    assert not background_processes.at_work()


def test_one_that_was_killed_leaves_nobody_at_work():
    """A parent that is killed at once, with its child asleep."""
    code = (
        "import os, signal; from limbcli import background_processes as started; "
        "started.start('timeit', '-n1', '-r1', 'import time; time.sleep(60)'); "
        "print(started.at_work()[0].pid, flush=True); os.kill(os.getpid(), 9)"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False).stdout
    if not sys.platform.startswith("linux"):
        pytest.skip("only Linux tells children")
    child, until = int(output), time.monotonic() + 20
    while time.monotonic() < until and Path(f"/proc/{child}/stat").exists():
        if Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
            return
        time.sleep(0.1)
    assert not Path(f"/proc/{child}").exists()


@pytest.mark.filterwarnings("ignore:.*found in sys.modules:RuntimeWarning")
def test_as_a_program_it_compiles_in_processes_that_find_it(monkeypatch):
    """`python -m` names a module otherwise than an import does."""
    begun: list[tuple[str, ...]] = []
    monkeypatch.setattr(background_processes, "start", lambda *words: begun.append(words))
    monkeypatch.setattr("limbcli.solvers.reference.kernels_are_there", lambda: False)
    monkeypatch.setattr(sys, "argv", ["kernels"])
    runpy.run_module("limbcli.stages.machine.kernels", run_name="__main__")
    assert {each[0] for each in begun} == {"limbcli.stages.machine.kernels"}
    assert [part for each in begun for part in each[1:]] == list(PARTS)
