"""Clear messages for file-system errors: a full disk, a read-only folder, a file in the way."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Iterator
from pathlib import Path

from limbcli.errors import CaseError, LimbError, ToolError

PARTIAL = ".partial-"  # prefix of the names of incomplete files and folders
SCRATCH = "limbcli-scratch-"  # prefix of the names of temporary folders
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_REFUSED = (errno.EACCES, errno.EPERM, errno.EROFS)
_IN_THE_WAY = (errno.EEXIST, errno.ENOTDIR, errno.EISDIR)
_BROKEN = (errno.EIO, errno.ESTALE, errno.EMFILE, errno.ENFILE, errno.ENAMETOOLONG, errno.ELOOP)

NO_MEMORY = ToolError(
    "not enough memory",
    where="this computer",
    fix="close other programs, use a coarser mesh (--size-mm, --far-size-mm), or a computer with more memory",
)


def in_words(error: OSError, place: Path | None = None) -> LimbError | None:
    """A user-readable error; None for an error that is not self-explanatory, such as a missing file.

    place : what was being written, if the error does not say so

    >>> print(in_words(OSError(errno.ENOSPC, "No space left on device"), Path("out/mesh")))
    the disk is full (No space left on device)
      where: out/mesh
      fix:   free space there, or give another output folder; then repeat the same command
    """
    named = str(error.filename or "")
    where = str(place) if place is not None and (not named or PARTIAL in named) else named or "unknown"
    why = f"({error.strerror})"
    if error.errno in _FULL and SCRATCH in named:
        return ToolError(
            f"the disk with the temporary files is full {why}",
            where=str(Path(named[: named.index(SCRATCH)])),
            fix="free space there, or set TMPDIR to a folder with more; then repeat the same command",
        )
    if error.errno in _FULL:
        return ToolError(
            f"the disk is full {why}",
            where=where,
            fix="free space there, or give another output folder; then repeat the same command",
        )
    if error.errno in _REFUSED:
        return CaseError(
            f"permission denied to read or write a file or folder {why}",
            where=where,
            fix="change its permissions (chmod, chown), or give another output folder",
        )
    if error.errno in _IN_THE_WAY:
        return CaseError(
            f"a file was found where a folder is needed, or a folder where a file is needed {why}",
            where=where,
            fix="move it away, or give another output folder",
        )
    if error.errno in _BROKEN:
        return ToolError(
            f"the system could not read or write {why}",
            where=where,
            fix="check the disk or the network drive, then repeat the same command",
        )
    return None


def not_in_utf8(path: Path) -> CaseError | None:
    """The error for a path that cannot be written into results and pages; None for any other path.

    >>> print(not_in_utf8(Path("caf\\udce9")))
    the path is not UTF-8 text, so results and pages cannot name it
      where: ...caf\\udce9
      fix:   rename that folder, or the one it lies in
    >>> not_in_utf8(Path("caf\\u00e9"))
    """
    text = str(path.absolute())
    shown = in_utf8(text)
    if shown == text:
        return None
    return CaseError(
        "the path is not UTF-8 text, so results and pages cannot name it",
        where=shown,
        fix="rename that folder, or the one it lies in",
    )


def in_utf8(text: str) -> str:
    """The text with backslash escapes for what UTF-8 cannot encode, as in some file names."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


@contextlib.contextmanager
def file_system_errors(place: Path) -> Iterator[None]:
    """Turn file-system errors inside the block into errors with a fix.

    Raises ToolError or CaseError as given by `in_words`; any other error is raised unchanged.
    """
    try:
        yield
    except OSError as error:
        found = in_words(error, place)
        if found is None:
            raise
        raise found from error
