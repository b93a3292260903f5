"""Atomic writing of files and folders: they are either complete or absent.

Every result is written to a temporary name in the same folder and then renamed, so an interrupted run leaves
the previous result or nothing, and never a partial one.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import secrets
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

from limbcli.errors import CaseError
from limbcli.errors.file_system import PARTIAL, file_system_errors
from limbcli.files.detached_data import detached_data

_OLD = "-old-"
_TOKEN_BYTES = 6  # bytes of the random part of a temporary name, which makes it unique
_NAME_LENGTH = 60  # largest number of characters of the host name in a temporary name
_ABANDONED_S = 24 * 3600.0


@contextlib.contextmanager
def atomic_file(target: Path) -> Iterator[Path]:
    """A path to write to; it replaces `target` when the block ends without an error.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> with atomic_file(folder / "a.txt") as path:
    ...     _ = path.write_text("whole")
    >>> (folder / "a.txt").read_text(), len(list(folder.iterdir()))
    ('whole', 1)
    """
    with file_system_errors(target), _folder_of(target):
        partial = _beside(target)
        partial.touch(exist_ok=False)
        try:
            yield partial
            os.replace(partial, target)
        finally:
            partial.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_folder(target: Path, *, is_new: bool = False) -> Iterator[Path]:
    """An empty folder to fill; it replaces `target` when the block ends without an error.

    Remains of interrupted earlier runs are removed first. If `target` is a symbolic link to a folder, that
    folder is replaced and the link is kept.

    is_new : `target` is not to be replaced, even if another program makes it while the block runs

    Raises CaseError if it was made meanwhile, or for a full disk and the like.
    """
    with file_system_errors(target):
        target = Path(os.path.realpath(target)) if target.is_symlink() else target
        with _empty_beside(target) as partial:
            yield partial
            if is_new:
                _put_where_nothing_is(partial, target)
            else:
                _put_in_place(partial, target)


@contextlib.contextmanager
def atomic_set(folder: Path, *, last: str) -> Iterator[Path]:
    """An empty folder to fill; its files replace those of the same names in `folder` when the block ends.

    Nothing is replaced if the block raises an error. All files are written before the first is replaced. File
    systems replace one name at a time: a kill during the replacement leaves part of the old set, so the file
    named `last`, which is replaced last, should hold the hashes of the others.
    """
    with file_system_errors(folder), _empty_beside(folder / "set") as partial:
        yield partial
        for each in sorted(partial.iterdir(), key=lambda path: (path.name == last, path.name)):
            _put_in_place(each, folder / each.name)


@contextlib.contextmanager
def _empty_beside(target: Path) -> Iterator[Path]:
    """An empty folder beside the target, without remains of interrupted runs; removed in the end."""
    with _folder_of(target):
        clear_partial(target.parent)
        partial = _beside(target)
        partial.mkdir()
        try:
            yield partial
        finally:
            shutil.rmtree(partial, ignore_errors=True)


@contextlib.contextmanager
def _folder_of(target: Path) -> Iterator[None]:
    """The target's folder exists in the block; folders made for it are removed if nothing was put there."""
    made = [each for each in target.parents if not each.exists()]
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):  # not empty
            for each in made:
                each.rmdir()


def _beside(target: Path) -> Path:
    """A new name in the target's folder with its suffix; files created there get the permissions of umask."""
    return target.parent / f"{_new()}{target.suffix}"


def _new() -> str:
    """Prefix of a name that has never been used, not even in this process."""
    return f"{PARTIAL}{_maker()}-{secrets.token_hex(_TOKEN_BYTES)}"


def _put_in_place(partial: Path, target: Path) -> None:
    """Move a file or folder to the target; a folder that was there is restored if that fails."""
    retired = target.parent / f"{_new()}{_OLD}{target.name}"
    try:
        if target.is_dir() and partial.is_dir():
            os.replace(target, retired)
        os.replace(partial, target)
    except BaseException:
        if retired.exists() and not target.exists():
            os.replace(retired, target)
        raise
    shutil.rmtree(retired, ignore_errors=True)


def _put_where_nothing_is(partial: Path, target: Path) -> None:
    try:
        os.rename(partial, target)  # fails where a folder with anything in it, or a file, is
    except OSError as error:
        if not target.exists():
            raise
        raise CaseError(
            f"{target.name} was made by another program meanwhile, and is not replaced",
            where=str(target),
            fix="give another folder, or look at what was made there",
        ) from error


def clear_partial(folder: Path) -> None:
    """Remove partial files and folders whose process is no longer running.

    Processes on other hosts cannot be checked; their files are removed if not modified for a day. A folder
    that was being replaced when the process was killed is restored if nothing has taken its place.
    """
    for path in folder.glob(f"{PARTIAL}*"):
        if _is_in_work(path):
            continue
        before = path.name.partition(_OLD)[2]
        if before and not (folder / before).exists():
            os.replace(path, folder / before)
        elif path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _maker() -> str:
    """Identifier of this process in the names of its partial files: process id and host name."""
    return f"{os.getpid()}@{_computer()}"


def _computer() -> str:
    return platform.node().replace("-", "_")[:_NAME_LENGTH]


def _is_in_work(partial: Path) -> bool:
    number, _, computer = partial.name.removeprefix(PARTIAL).split("-")[0].partition("@")
    if computer in ("", _computer()) and os.name == "posix":  # elsewhere, asking would end the process
        return number.isdigit() and _is_alive(int(number))
    try:
        return time.time() - _last_touched(partial) < _ABANDONED_S
    except FileNotFoundError:  # it was finished or removed in the meantime
        return True


def _last_touched(path: Path) -> float:
    """Latest modification time of the file, or of anything in the folder (s since the epoch)."""
    return max(each.lstat().st_mtime for each in (path, *path.rglob("*")))


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


# files that file managers create in a folder; not part of its hash
_NOT_CONTENT = (".DS_Store", "Thumbs.db", "desktop.ini")
_SETTLED_S = 3.0  # s; a little more than the coarsest time stamp resolution of common file systems
_MOST_KNOWN = 50_000
_known: dict[tuple[str, int, int, int, int], str] = {}


def sha256(path: Path) -> str:
    """SHA-256 hash of a file, or of the names and contents of all files of a folder in name order (hex).

    A header whose data lie in files beside it (`.nhdr`, `.mhd`) is hashed together with them.

    Raises OSError if there is no such file or folder, or a file cannot be read.
    """
    if not path.is_dir():
        data = detached_data(path)
        if not data:
            return _file_hash(path)
        return hashlib.sha256("\0".join(map(_file_hash, (path, *data))).encode()).hexdigest()
    digest = hashlib.sha256()
    for each in sorted(each for each in path.rglob("*") if each.is_file() and each.name not in _NOT_CONTENT):
        digest.update(os.fsencode(f"{each.relative_to(path).as_posix()}\0{_file_hash(each)}\0"))
    return digest.hexdigest()


def _file_hash(path: Path) -> str:
    """Hash of a file, cached while size, inode and both time stamps are unchanged.

    A file modified a moment ago is not cached, since another change right after might not alter its time
    stamps.
    """
    stamp = _stamp(path)
    if stamp in _known:
        return _known[stamp]
    with path.open("rb") as stream:
        found = hashlib.file_digest(stream, "sha256").hexdigest()
    settled = time.time() - max(stamp[3:]) / 1e9 > _SETTLED_S
    if settled and _stamp(path) == stamp:
        if len(_known) >= _MOST_KNOWN:
            _known.clear()
        _known[stamp] = found
    return found


def _stamp(path: Path) -> tuple[str, int, int, int, int]:
    status = path.stat()
    return str(path.absolute()), status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
