"""Temporary folders and child processes that do not outlive a killed limbcli."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from limbcli.errors.file_system import SCRATCH

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
_ROOM_BYTES = 1_000_000  # free space (bytes) below which a disk counts as full
_PR_SET_PDEATHSIG = 1  # prctl(2)
_CAN_HOLD_FOLDERS = hasattr(os, "O_DIRECTORY")  # not on Windows, where nobody else may remove a folder in use
_CAN_TELL_CHILDREN = sys.platform.startswith("linux")


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """An empty temporary folder, removed when the block ends; those of killed processes are removed as well.

    The process holds an operating-system lock on the folder, which is released however it ends. A disk-full
    error that names no file is raised again with the name of the folder, if its disk is full.

    >>> with scratch_folder() as folder:
    ...     _ = (folder / "a.txt").write_text("for now")
    >>> folder.exists()
    False
    """
    _drop_abandoned(Path(tempfile.gettempdir()))
    folder, held = _made()
    try:
        yield folder
    except OSError as error:
        if error.errno in _NO_ROOM and not error.filename and _is_full(folder):
            raise OSError(error.errno, error.strerror, str(folder)) from error
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if held is not None:
            os.close(held)


def _is_full(folder: Path) -> bool:
    return shutil.disk_usage(folder).free < _ROOM_BYTES


def _made() -> tuple[Path, int | None]:
    """A folder, and the handle that holds its lock where folders can be held.

    Retried if another process has removed it as abandoned.
    """
    import portalocker

    while True:
        folder = Path(tempfile.mkdtemp(prefix=SCRATCH))
        if not _CAN_HOLD_FOLDERS:
            return folder, None
        try:
            held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except FileNotFoundError:
            continue
        with contextlib.suppress(portalocker.LockException):  # without locks, nobody gets one
            portalocker.lock(held, portalocker.LockFlags.EXCLUSIVE)
        if folder.exists():
            return folder, held
        os.close(held)


def _drop_abandoned(parent: Path) -> None:
    """Remove our temporary folders whose lock nobody holds."""
    if not _CAN_HOLD_FOLDERS:
        return
    import portalocker

    wish = portalocker.LockFlags.EXCLUSIVE | portalocker.LockFlags.NON_BLOCKING
    for path in parent.glob(f"{SCRATCH}*"):
        # It may be owned by another user, locked, or removed in the meantime.
        with contextlib.suppress(OSError, portalocker.LockException):
            handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                portalocker.lock(handle, wish)
                if os.fstat(handle).st_uid == os.getuid():
                    shutil.rmtree(path, ignore_errors=True)
            finally:
                os.close(handle)


def end_with_parent(parent: int) -> None:
    """Have this process killed when its parent process (id `parent`) ends; on Linux only."""
    _ending_with(parent)()


def ends_with_this_process() -> Callable[[], None] | None:
    """A `preexec_fn` that makes an external program end with the thread that starts it.

    None if the operating system does not support it.
    """
    return _ending_with(os.getpid()) if _CAN_TELL_CHILDREN else None


def _ending_with(parent: int) -> Callable[[], None]:
    """The function that the child calls.

    Everything is looked up beforehand, as little is safe between fork and exec.
    """
    if not _CAN_TELL_CHILDREN:
        return lambda: None
    prctl, getppid, leave = ctypes.CDLL(None).prctl, os.getppid, os._exit

    def die() -> None:
        prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))
        if getppid() != parent:  # the parent ended before the call took effect
            leave(1)

    return die
