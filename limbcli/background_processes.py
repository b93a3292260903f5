"""Child processes that prepare what this one will need, while it does something else.

What they leave (compiled kernels on disk) can be had without them as well: one that fails or is killed
costs time and nothing else.
"""

from __future__ import annotations

import atexit
import subprocess
import sys
from collections.abc import Sequence

from limbcli.temporary_folders import ends_with_this_process

_AT_WORK: list[subprocess.Popen[bytes]] = []


def start(module: str, *words: str) -> None:
    """`python -m module words`, silent, in a process that ends with this one."""
    if not _AT_WORK:
        atexit.register(stop)
    _AT_WORK.append(
        subprocess.Popen(
            [sys.executable, "-m", module, *words], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, start_new_session=True, preexec_fn=ends_with_this_process(),
        )
    )  # fmt: skip


def at_work() -> Sequence[subprocess.Popen[bytes]]:
    """Those that are not done yet."""
    _AT_WORK[:] = [each for each in _AT_WORK if each.poll() is None]
    return _AT_WORK


def wait() -> None:
    """Until all are done; at once where there is none."""
    for each in list(at_work()):
        each.wait()


def stop() -> None:
    """End those that are not done."""
    for each in list(at_work()):
        each.kill()
        each.wait()
