"""Where on a command line the output folder is, for what nobody foresaw."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from limbcli.config import default_out


def output_folder(arguments: Sequence[str]) -> Path | None:
    """The output folder that a command line names or means, if it is there.

    >>> output_folder(["mesh", "case", "--out=/tmp"]).as_posix(), output_folder(["mesh", "-o", "/nowhere"])
    ('/tmp', None)
    >>> output_folder(["mesh", "-o/tmp"]).as_posix()
    '/tmp'
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
    if text.startswith("--out="):
        return [text.removeprefix("--out=")]
    return [text[2:]] if text.startswith("-o") and len(text) > 2 else []
