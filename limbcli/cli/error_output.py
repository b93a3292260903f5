"""An error as a command shows it: its message, and with --json an object."""

from __future__ import annotations

import json

from limbcli.cli.results_stream import results
from limbcli.cli.say import say
from limbcli.errors import LimbError


def report_error(error: LimbError, *, as_json: bool) -> None:
    """Print the message to stderr and, with --json, the error as an object to stdout."""
    say(f"{type(error).__name__}: {error}", to_stderr=True)
    if as_json:
        report_json(error)


def report_json(error: LimbError) -> None:
    """Print the error as an object to stdout."""
    from limbcli.results import plain

    content = {
        "error": type(error).__name__,
        "exit_code": error.exit_code,
        "what": error.what,
        "where": error.where,
        "fix": error.fix,
        "facts": plain(error.facts),
    }
    print(json.dumps(content, indent=1, default=str), file=results(), flush=True)
