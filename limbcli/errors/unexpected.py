"""Unforeseen failures: a short error for the user, and a full report in a file to send in."""

from __future__ import annotations

import platform
import sys
import tempfile
import time
import traceback
from pathlib import Path

from limbcli.errors import UnforeseenError
from limbcli.errors.file_system import in_utf8
from limbcli.errors.pasted_commands import command_line
from limbcli.version import __version__


def unforeseen(error: BaseException, folder: Path | None) -> UnforeseenError:
    """The error for the user; the full report is written to `folder`, or else to the temporary folder."""
    kind = type(error).__name__
    fix = "send that file to the maintainers of limbcli; it contains paths and the command, but no images"
    try:
        where = str(_left(_story(error), folder))
    except OSError as why:
        last = traceback.extract_tb(error.__traceback__)[-1:]
        where = ", ".join(f"{Path(each.filename).name} line {each.lineno}" for each in last)
        fix = f"send this message to the maintainers of limbcli (no file could be written: {why.strerror})"
    return UnforeseenError(f"an unexpected error occurred in limbcli ({kind}: {error})", where=where, fix=fix)


def _story(error: BaseException) -> str:
    command = command_line(sys.argv)
    trace = "".join(traceback.format_exception(error))
    return (
        f"limbcli {__version__}, Python {platform.python_version()}, {platform.platform()}\n"
        f"{time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime())}\n{command}\n\n{trace}"
    )


def _left(story: str, folder: Path | None) -> Path:
    """Write the report and return its path."""
    name = time.strftime("limbcli-error-%Y%m%d-%H%M%S.txt", time.gmtime())
    for place in [each for each in (folder, Path(tempfile.gettempdir())) if each is not None]:
        try:
            (place / name).write_text(in_utf8(story), encoding="utf-8")
        except OSError:
            continue
        return place / name
    raise OSError(0, "neither in the output folder nor in the temporary one")
