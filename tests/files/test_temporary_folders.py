"""A killed maker's temporary folder and child process do not stay."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import ToolError
from limbcli.errors.file_system import SCRATCH
from limbcli.files import temporary_folders
from limbcli.files.atomic import atomic_folder
from limbcli.files.temporary_folders import scratch_folder
from limbcli.meshing import mesher_process

MAKER = """
import subprocess, sys, time
from limbcli.files.temporary_folders import scratch_folder
with scratch_folder() as folder:
    (folder / "a.txt").write_text("half")
    child = "import sys, time; from limbcli.files.temporary_folders import end_with_parent as end; "
    child += "end(int(sys.argv[1])); print('ready', flush=True); time.sleep(60)"
    import os
    started = subprocess.Popen([sys.executable, "-c", child, str(os.getpid())], stdout=subprocess.PIPE)
    started.stdout.readline()
    print(started.pid, flush=True)
    time.sleep(60)
"""


@pytest.fixture
def maker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A process that holds a scratch folder and has a child, and the child's id."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    process = subprocess.Popen([sys.executable, "-c", MAKER], env=environment, stdout=subprocess.PIPE)
    assert process.stdout is not None
    yield process, int(process.stdout.readline())
    process.kill()
    process.wait()
    process.stdout.close()


def is_running(number: int) -> bool:
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the child's end is the Linux kernel's work")
def test_what_a_killed_maker_leaves_goes_and_what_a_living_one_holds_stays(maker, tmp_path: Path):
    process, child = maker
    with scratch_folder() as other:
        assert len(list(tmp_path.glob(f"{SCRATCH}*"))) == 2
        assert is_running(child)
    process.kill()
    process.wait()
    end = time.monotonic() + 10
    while is_running(child) and time.monotonic() < end:
        time.sleep(0.02)
    assert not is_running(child)
    assert len(list(tmp_path.glob(f"{SCRATCH}*"))) == 1
    with scratch_folder() as other:
        assert list(tmp_path.glob(f"{SCRATCH}*")) == [other]


@pytest.mark.parametrize(("is_full", "place"), [(True, ""), (False, "out/mesh")])
def test_of_two_disks_the_full_one_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_full: bool, place: str
):
    """What numpy cannot write says nothing of where; the results lie on another disk than temporary files."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(temporary_folders, "_is_full", lambda _: is_full)
    with pytest.raises(ToolError, match="full") as caught, atomic_folder(tmp_path / "out/mesh"):  # noqa: SIM117
        with scratch_folder():
            raise OSError(errno.ENOSPC, "No space left on device")
    assert caught.value.where == str(tmp_path / place)
    assert ("TMPDIR" in caught.value.fix) == is_full


def test_a_mesher_without_room_is_not_taken_for_one_that_refuses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A full disk is no reason for another mesh."""
    nodes, cells = np.zeros((4, 3)), np.zeros((1, 4), np.int64)
    np.savez(tmp_path / "in.npz", points=nodes, faces=cells, options="{}")

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setitem(mesher_process.MESHERS, "any", lambda *_: (nodes, cells))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with monkeypatch.context() as patch:
        patch.setattr(mesher_process.np, "savez", full)
        with pytest.raises(SystemExit) as stop:
            mesher_process.main("any", tmp_path)
    monkeypatch.setattr(mesher_process, "_run", lambda *_: stop.value.code)
    with pytest.raises(OSError, match="No space") as caught:
        mesher_process.in_process("any", nodes, cells, {}, time_limit_s=1.0)
    assert SCRATCH in str(caught.value.filename)
