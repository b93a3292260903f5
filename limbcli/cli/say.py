"""The one way by which lines of a command reach the terminal: without control characters."""

from __future__ import annotations

import sys

from limbcli.files.plain_text import shown


def say(text: object = "", *, to_stderr: bool = False, end: str = "\n") -> None:
    """Print text of any origin to stdout, or to stderr; see `shown`."""
    print(shown(text), end=end, file=sys.stderr if to_stderr else sys.stdout)
