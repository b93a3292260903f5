"""A killed maker's temporary folder and child process do not stay."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from limbcli.scratch import PREFIX, scratch_folder

MAKER = """
import subprocess, sys, time
from limbcli.scratch import scratch_folder
with scratch_folder() as folder:
    (folder / "a.txt").write_text("half")
    child = "import sys, time; from limbcli.scratch import end_with_parent as end; end(int(sys.argv[1])); "
    child += "print('ready', flush=True); time.sleep(60)"
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
        assert len(list(tmp_path.glob(f"{PREFIX}*"))) == 2
        assert is_running(child)
    process.kill()
    process.wait()
    end = time.monotonic() + 10
    while is_running(child) and time.monotonic() < end:
        time.sleep(0.02)
    assert not is_running(child)
    assert len(list(tmp_path.glob(f"{PREFIX}*"))) == 1
    with scratch_folder() as other:
        assert list(tmp_path.glob(f"{PREFIX}*")) == [other]
