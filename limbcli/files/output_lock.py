"""Lock an output folder, so that only one process writes to it at a time.

The lock is an operating-system lock on a file in the folder: it is released when the process ends, however it
ends, so a stale lock needs no cleaning up. The content of the file only says who holds it. Processes that
write one site each share the folder's lock, and hold that of the site exclusively.
"""

from __future__ import annotations

import contextlib
import errno
import os
import platform
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from limbcli.errors import CaseError
from limbcli.errors.file_system import file_system_errors, in_words, not_in_utf8
from limbcli.errors.pasted_commands import command_line
from limbcli.progress import SILENT, Progress

LOCK = ".writing"
_LOOK_S = 0.2  # s between two attempts while another process holds the lock
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
_SOMEBODY = "another limbcli"


@contextlib.contextmanager
def one_writer(folder: Path, *, wait: bool = True, progress: Progress = SILENT) -> Iterator[None]:
    """Hold the exclusive lock of this output folder for the duration of the block.

    wait : wait for another process to finish, with a note; otherwise refuse at once

    Raises CaseError if another process writes there and `wait` is False, or the folder cannot be written to
    or named.
    """
    with _held(folder, LOCK, wait=wait, progress=progress):
        yield


@contextlib.contextmanager
def site_writer(folder: Path, site: str, *, wait: bool = True, progress: Progress = SILENT) -> Iterator[None]:
    """Hold the exclusive lock of this site's results; other sites may be written at the same time.

    Raises CaseError as `one_writer`.
    """
    together = _held(folder, LOCK, wait=wait, progress=progress, alone=False)
    with together, _held(folder, f"{LOCK}-{site}", wait=wait, progress=progress):
        yield


@contextlib.contextmanager
def _held(folder: Path, name: str, *, wait: bool, progress: Progress, alone: bool = True) -> Iterator[None]:
    if (refused := not_in_utf8(folder)) is not None:
        raise refused
    is_new = not folder.exists()
    with file_system_errors(folder):
        _made(folder)
        stream = _locked(folder, name, wait=wait, progress=progress, alone=alone)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            if alone or _try(stream, alone=True):  # the last of several holders removes the file
                (folder / name).unlink(missing_ok=True)  # a process waiting for this file checks again
        stream.close()
        if is_new:
            with contextlib.suppress(OSError):
                folder.rmdir()  # succeeds only if it is empty


def _made(folder: Path) -> None:
    """Create the folder if it does not exist; every failure becomes an error with a fix.

    Raises CaseError if it cannot be created, for example in a file system without ordinary folders.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        if in_words(error, folder) is not None:
            raise
        raise CaseError(
            f"the output folder cannot be created ({error.strerror})",
            where=str(folder),
            fix="name another --out",
        ) from error


def _locked(folder: Path, name: str, *, wait: bool, progress: Progress, alone: bool) -> TextIO:
    """The locked file; retried if another process has removed the file in the meantime."""
    is_announced = False
    while True:
        _made(folder)
        stream = (folder / name).open("a+", encoding="utf-8")
        if _try(stream, alone=alone):
            if _is_still(stream, folder / name):
                _sign(stream)
                return stream
            stream.close()
            continue
        holder = _holder(stream)
        stream.close()
        if not wait:
            raise CaseError(
                f"{holder} is writing into this output folder",
                where=str(folder),
                fix="wait for it to finish (omit --no-wait), or give another --out",
            )
        if not is_announced:
            text = f"waiting: {holder} is writing into {folder} (--no-wait refuses)"
            progress.event("note", text=text, waiting=True)
            is_announced = True
        time.sleep(_LOOK_S)


def _holder(stream: TextIO) -> str:
    """Who holds the file, in words; Windows does not let a locked file be read."""
    with contextlib.suppress(OSError):
        stream.seek(0)
        return stream.read().strip() or _SOMEBODY
    return _SOMEBODY


def _try(stream: TextIO, *, alone: bool = True) -> bool:
    import portalocker

    kind = portalocker.LockFlags.EXCLUSIVE if alone else portalocker.LockFlags.SHARED
    try:
        portalocker.lock(stream, kind | portalocker.LockFlags.NON_BLOCKING)
    except portalocker.AlreadyLocked:
        return False
    except portalocker.LockException as error:
        cause = error.__cause__
        if not isinstance(cause, OSError):
            raise
        if cause.errno not in _NO_LOCKS:  # on a file system without locks, continue without a lock
            raise cause from error
    return True


def _is_still(stream: TextIO, path: Path) -> bool:
    with contextlib.suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(stream.fileno()), path.stat())
    return False


def _sign(stream: TextIO) -> None:
    since = time.strftime("%H:%M:%S", time.localtime())
    stream.truncate(0)
    stream.write(f"`{command_line(sys.argv)}` (process {os.getpid()} on {platform.node()}, since {since})\n")
    stream.flush()
