"""Temporary folders and child processes that a killed limbcli does not leave behind."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from limbcli.errors.file_system import SCRATCH

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
_ROOM_BYTES = 1_000_000  # of which less is left on a disk that is full
_PR_SET_PDEATHSIG = 1  # prctl(2)
_CAN_TELL_CHILDREN = sys.platform.startswith("linux")


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """An empty temporary folder, removed when the block ends; those of makers that were killed go too.

    Its maker holds the system's lock on the folder, which ends with it, however it ends. What finds no room
    and does not say where names the folder, where its disk is full.

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
        os.close(held)


def _is_full(folder: Path) -> bool:
    return shutil.disk_usage(folder).free < _ROOM_BYTES


def _made() -> tuple[Path, int]:
    """A folder and the handle that holds its lock; made again if another took it for abandoned meanwhile."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=SCRATCH))
        try:
            held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except FileNotFoundError:
            continue
        with contextlib.suppress(OSError):  # a file system without locks: nobody else gets one either
            fcntl.flock(held, fcntl.LOCK_EX)
        if folder.exists():
            return folder, held
        os.close(held)


def _drop_abandoned(parent: Path) -> None:
    """Remove our scratch folders whose lock nobody holds."""
    for path in parent.glob(f"{SCRATCH}*"):
        with contextlib.suppress(OSError):  # another user's, held, or gone meanwhile
            handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.fstat(handle).st_uid == os.getuid():
                    shutil.rmtree(path, ignore_errors=True)
            finally:
                os.close(handle)


def end_with_parent(parent: int) -> None:
    """This process is killed when `parent` (its id), which started it, ends; on Linux only."""
    _ending_with(parent)()


def ends_with_this_process() -> Callable[[], None] | None:
    """For `preexec_fn` of a program that is not ours, so that it ends with the thread that starts it.

    None where the system knows no such thing.
    """
    return _ending_with(os.getpid()) if _CAN_TELL_CHILDREN else None


def _ending_with(parent: int) -> Callable[[], None]:
    """What the child calls: all is looked up here, as little may be done between fork and exec."""
    if not _CAN_TELL_CHILDREN:
        return lambda: None
    prctl, getppid, leave = ctypes.CDLL(None).prctl, os.getppid, os._exit

    def die() -> None:
        prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))
        if getppid() != parent:  # it ended before that was said
            leave(1)

    return die
