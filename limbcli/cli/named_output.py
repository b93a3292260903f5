"""Where on a command line the output folder is, for what nobody foresaw."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from limbcli.cli.fixes import case_of, out_of
from limbcli.config import default_out


def output_folder(arguments: Sequence[str]) -> Path | None:
    """The output folder that a command line names or means, if it is there.

    >>> output_folder(["mesh", "case", "--out=/tmp"]).as_posix(), output_folder(["mesh", "-o", "/nowhere"])
    ('/tmp', None)
    """
    case = case_of(arguments)
    found = out_of(arguments) or (default_out(case) if case else None)
    return found if found is not None and found.is_dir() else None
