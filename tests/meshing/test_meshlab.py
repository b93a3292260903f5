"""A process in which a thread opened pymeshlab ends as any other."""

from __future__ import annotations

import subprocess
import sys
import threading

import pytest

from limbcli.meshing import meshlab

IN_A_THREAD = """
import threading
def work():
    import scipy.optimize
    from limbcli.meshing.meshlab import open_pymeshlab
    open_pymeshlab().MeshSet(verbose=False)
thread = threading.Thread(target=work)
thread.start()
thread.join()
"""


@pytest.mark.slow
def test_a_process_whose_thread_opened_it_can_end():
    done = subprocess.run(
        [sys.executable, "-c", IN_A_THREAD], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_one_that_is_not_there_is_missing_in_every_thread(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(meshlab, "_NAME", "limbcli.no_such_library")
    met: list[str] = []

    def work() -> None:
        try:
            meshlab.open_pymeshlab()
        except ImportError as error:
            met.append(str(error))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join(timeout=10)
    assert met == ["No module named 'limbcli.no_such_library'"]
