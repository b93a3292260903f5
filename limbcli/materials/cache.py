"""Compiled kernels on disk: dropped when the source of a law or of an element loop has changed.

numba looks only at the file of a kernel itself, not at those of the functions that it calls, so a
changed law would go on being served from an old cache. Kernels that do not lie beside their sources are
`kernel_folder`'s.

What is compiled is what a fresh machine waits for. numba makes a kernel anew, with all that it calls, for
every constant it is called with: `np.int64(0)` or `np.bool_(True)` instead of 0 or True shares the one there
is. A slice that is assigned to a slice compiles as much as a law; a loop does not.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from limbcli.kernel_folder import digest

_STAMP = "kernels.stamp"


def drop_stale_kernels() -> bool:
    """Delete cached kernels of laws and element loops if a file of theirs changed since they were made.

    Returns whether anything was deleted. A folder that cannot be written is left alone.
    """
    here = Path(__file__).parent
    fem = here.parent / "fem"
    folders = (here, fem, *sorted(each.parent for each in fem.rglob("__init__.py") if each.parent != fem))
    sources = [path for folder in folders for path in folder.glob("*.py")]
    now = digest(sources)
    stamp = here / "__pycache__" / _STAMP
    with suppress(OSError):
        if stamp.is_file() and stamp.read_text() == now:
            return False
    dropped = False
    with suppress(OSError):
        for folder in folders:
            for pattern in ("*.nbi", "*.nbc"):
                for path in (folder / "__pycache__").glob(pattern):
                    path.unlink(missing_ok=True)
                    dropped = True
        stamp.parent.mkdir(exist_ok=True)
        stamp.write_text(now)
    return dropped
