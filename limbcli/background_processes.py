"""Child processes that prepare in the background what this process will need later.

Their output (compiled kernels on disk) can be produced without them as well: one that fails or is killed only
costs time.
"""

from __future__ import annotations

import atexit
import subprocess
import sys
from collections.abc import Sequence

from limbcli.files.temporary_folders import ends_with_this_process

_AT_WORK: list[subprocess.Popen[bytes]] = []


def start(module: str, *words: str) -> None:
    """Run `python -m module words` silently in a process that ends with this one."""
    if not _AT_WORK:
        atexit.register(stop)
    _AT_WORK.append(
        subprocess.Popen(
            [sys.executable, "-m", module, *words], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, start_new_session=True, preexec_fn=ends_with_this_process(),
        )
    )  # fmt: skip


def at_work() -> Sequence[subprocess.Popen[bytes]]:
    """The processes that are still running."""
    _AT_WORK[:] = [each for each in _AT_WORK if each.poll() is None]
    return _AT_WORK


def wait() -> None:
    """Wait until all have ended; return immediately if there are none."""
    for each in list(at_work()):
        each.wait()


def stop() -> None:
    """Terminate those that are still running."""
    for each in list(at_work()):
        each.kill()
        each.wait()
