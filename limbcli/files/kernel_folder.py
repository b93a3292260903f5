"""Where compiled kernels are cached on disk, if not next to their sources.

numba caches a kernel in the `__pycache__` next to its source, where `materials.cache` removes what is out of
date: numba itself does not notice that a function in another file, which the kernel calls, has changed. A
folder named by NUMBA_CACHE_DIR, and the folder that replaces `__pycache__` in a read-only installation (a
container, a cluster's shared folder), contain one folder for each state of the sources instead.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"
_BEGIN = "limbcli-kernels-"  # prefix of a folder's name; the digest of the sources follows
_LETTERS = 16  # number of hex digits of the digest in the name: enough to distinguish states of the sources
_COMPILED = (b"njit", b"intrinsic", b"llvmlite")  # strings that identify a file with kernels
# permissions that nobody else may have on a temporary folder: the code cached there is executed
_OTHERS = 0o077


def keep_kernels(package: Path) -> Path | None:
    """Make numba cache the kernels of a package in a writable folder where they are never out of date.

    Returns None if that is next to the sources, else the folder, which child processes inherit.
    """
    given = os.environ.get(VARIABLE, "")
    if not given and _is_writable(package):
        return None
    name = _BEGIN + digest(package.rglob("*.py"))[:_LETTERS]
    folder = _first_usable([_besides(Path(given)) / name] if given else [])
    if folder is None and not _is_writable(package):
        folder = _first_usable(_places(name))
    if folder is None:
        return None
    os.environ[VARIABLE] = str(folder)
    if "numba" in sys.modules:  # numba has read the environment already
        sys.modules["numba"].config.CACHE_DIR = str(folder)
    return folder


def digest(sources: Iterable[Path]) -> str:
    """Hash (hex) of all files that contain kernels, in the order of their names."""
    import hashlib  # not needed by the ordinary installation

    texts = (path.read_bytes() for path in sorted(sources))
    return hashlib.sha256(b"".join(each for each in texts if any(w in each for w in _COMPILED))).hexdigest()


def _besides(given: Path) -> Path:
    """The folder that was named, even if a parent process has already appended its subfolder."""
    return given.parent if given.name.startswith(_BEGIN) else given


def _is_writable(package: Path) -> bool:
    kept = package / "materials" / "__pycache__"
    return os.access(kept if kept.is_dir() else kept.parent, os.W_OK)


def _first_usable(folders: Iterable[Path]) -> Path | None:
    """The first folder that is writable, created if necessary; None if there is none."""
    import tempfile

    for folder in folders:
        with suppress(OSError):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
    return None


def _places(name: str) -> Iterator[Path]:
    """Candidates: in the user's cache, then in a temporary folder of the user's own."""
    import tempfile

    cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    if cache.is_absolute():
        yield cache / "limbcli" / name
    with suppress(OSError):  # there may be no temporary folder
        temporary = Path(tempfile.gettempdir())
        user = os.getuid() if hasattr(os, "getuid") else None  # Windows: the folder is the user's own
        own = temporary / f"{name}-{user}"
        with suppress(FileExistsError):
            own.mkdir(mode=0o700)
        status = own.lstat()
        is_ours = own.is_dir() and not own.is_symlink() and status.st_uid == user
        is_private = user is None or (is_ours and not status.st_mode & _OTHERS)
        yield own if is_private else Path(tempfile.mkdtemp(prefix=f"{name}-"))
