"""Discards cached compiled kernels when the source of a law or of an element loop has changed.

numba checks only the file of a kernel itself, not those of the functions it calls, so after a change of a law
it would keep using an out-of-date cache. Kernels cached elsewhere than next to their sources are handled by
`kernel_folder`.

Compilation time is waiting time on a new machine. numba recompiles a kernel, with everything it calls, for
every literal constant among its arguments: `np.int64(0)` or `np.bool_(True)` instead of 0 or True reuses the
existing version. Assigning a slice to a slice takes as long to compile as a law; a loop does not.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from limbcli.files.kernel_folder import digest

_STAMP = "kernels.stamp"


def drop_stale_kernels() -> bool:
    """Delete the cached kernels of laws and finite elements if one of their source files has changed.

    Returns whether anything was deleted. Folders that are not writable are skipped.
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
