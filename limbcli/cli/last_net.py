"""What nobody foresaw becomes a message and a file to send in; never a traceback on the terminal."""

from __future__ import annotations

import platform
import shlex
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from pathlib import Path

from limbcli.config import default_out
from limbcli.errors import UnforeseenError
from limbcli.version import __version__


def unforeseen(error: BaseException, folder: Path | None) -> UnforeseenError:
    """The message, after the whole story was left in `folder`, else in the temporary folder."""
    kind = type(error).__name__
    fix = "send that file to those who maintain limbcli; it holds paths and the command, but no images"
    try:
        where = str(_left(_story(error), folder))
    except OSError as why:
        last = traceback.extract_tb(error.__traceback__)[-1:]
        where = ", ".join(f"{Path(each.filename).name} line {each.lineno}" for each in last)
        fix = f"send this message to those who maintain limbcli (no file could be written: {why.strerror})"
    return UnforeseenError(
        f"something happened that limbcli did not foresee ({kind}: {error})", where=where, fix=fix
    )


def output_folder(arguments: Sequence[str]) -> Path | None:
    """The output folder that a command line names or means, if it is there.

    >>> output_folder(["mesh", "case", "--out=/tmp"]).as_posix(), output_folder(["mesh", "-o", "/nowhere"])
    ('/tmp', None)
    """
    named = [
        value
        for before, text in zip(["", *arguments], arguments, strict=False)
        for value in _value_of(before, text)
    ]
    cases = [
        Path(each)
        for each in arguments[1:]
        if not each.startswith("-") and (Path(each) / "case.toml").is_file()
    ]
    found = Path(named[-1]) if named else default_out(cases[0]) if cases else None
    return found if found is not None and found.is_dir() else None


def _value_of(before: str, text: str) -> list[str]:
    if before in ("--out", "-o"):
        return [text]
    return [text.removeprefix("--out=")] if text.startswith("--out=") else []


def _story(error: BaseException) -> str:
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    trace = "".join(traceback.format_exception(error))
    return (
        f"limbcli {__version__}, Python {platform.python_version()}, {platform.platform()}\n"
        f"{time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime())}\n{command}\n\n{trace}"
    )


def _left(story: str, folder: Path | None) -> Path:
    """Where the story lies."""
    name = time.strftime("limbcli-error-%Y%m%d-%H%M%S.txt", time.gmtime())
    for place in [each for each in (folder, Path(tempfile.gettempdir())) if each is not None]:
        try:
            (place / name).write_text(story, encoding="utf-8")
        except OSError:
            continue
        return place / name
    raise OSError(0, "neither in the output folder nor in the temporary one")
