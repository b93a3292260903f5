"""Find the output folder of a command line, for the report of an unexpected error."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from limbcli.cli.fixes import case_of, out_of
from limbcli.config import default_out


def output_folder(arguments: Sequence[str]) -> Path | None:
    """The output folder of a command line, given or default, if it exists.

    >>> output_folder(["mesh", "case", "--out=/tmp"]).as_posix(), output_folder(["mesh", "-o", "/nowhere"])
    ('/tmp', None)
    """
    case = case_of(arguments)
    found = out_of(arguments) or (default_out(case) if case else None)
    return found if found is not None and found.is_dir() else None
