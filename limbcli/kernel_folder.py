"""Where compiled kernels are kept on disk, where that is not beside their sources.

numba keeps a kernel in the `__pycache__` beside it, where `materials.cache` drops what is out of date: numba
itself does not see that a function in another file, which the kernel calls, has changed. A folder named by
NUMBA_CACHE_DIR, and the one that takes the place of `__pycache__` in an installation that cannot be written
(a container, a cluster's shared folder), hold one folder for each state of the sources instead.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"
_BEGIN = "limbcli-kernels-"  # of a folder's name; the state of the sources follows
_LETTERS = 16  # of the digest: enough to tell states apart
_COMPILED = (b"njit", b"intrinsic", b"llvmlite")  # words of a file that holds kernels
_OTHERS = 0o077  # rights that nobody else may have in a temporary folder: what lies there is run


def keep_kernels(package: Path) -> Path | None:
    """Have numba keep the kernels of a package where they can be written and are never out of date.

    None where that is beside the sources; else the folder, which goes to child processes, too.
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
    if "numba" in sys.modules:  # it has looked at the environment already
        sys.modules["numba"].config.CACHE_DIR = str(folder)
    return folder


def digest(sources: Iterable[Path]) -> str:
    """Of all files that hold kernels, in the order of their names (hex)."""
    texts = (path.read_bytes() for path in sorted(sources))
    return hashlib.sha256(b"".join(each for each in texts if any(w in each for w in _COMPILED))).hexdigest()


def _besides(given: Path) -> Path:
    """The folder that was named, also where the process that started this one took a part of it already."""
    return given.parent if given.name.startswith(_BEGIN) else given


def _is_writable(package: Path) -> bool:
    kept = package / "materials" / "__pycache__"
    return os.access(kept if kept.is_dir() else kept.parent, os.W_OK)


def _first_usable(folders: Iterable[Path]) -> Path | None:
    """The first that can be written, made where it is not there; None where none can."""
    for folder in folders:
        with suppress(OSError):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
    return None


def _places(name: str) -> Iterator[Path]:
    """In the user's cache, then in a temporary folder of the user's own."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    if cache.is_absolute():
        yield cache / "limbcli" / name
    with suppress(OSError):  # there may be no temporary folder
        temporary = Path(tempfile.gettempdir())
        own = temporary / f"{name}-{os.getuid()}"
        with suppress(FileExistsError):
            own.mkdir(mode=0o700)
        status = own.lstat()
        is_ours = own.is_dir() and not own.is_symlink() and status.st_uid == os.getuid()
        yield own if is_ours and not status.st_mode & _OTHERS else Path(tempfile.mkdtemp(prefix=f"{name}-"))
