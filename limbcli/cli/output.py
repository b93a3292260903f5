"""What a command prints: lines without control characters, errors, and with --json the results alone."""

from __future__ import annotations

import io
import json
import os
import sys
from typing import TextIO

from limbcli.errors import LimbError
from limbcli.files.plain_text import shown


def say(text: object = "", *, to_stderr: bool = False, end: str = "\n") -> None:
    """Print text of any origin to stdout, or to stderr; see `shown`."""
    print(shown(text), end=end, file=sys.stderr if to_stderr else sys.stdout)


_kept: list[TextIO] = []  # the process's own stdout, once everything else goes to stderr


def results() -> TextIO:
    """Where results are printed."""
    return _kept[-1] if _kept else sys.stdout


def keep_stdout_for_results() -> None:
    """Let what Python, C or child processes print to stdout go to stderr; only `results()` stays there."""
    try:
        out, err = sys.stdout.fileno(), sys.stderr.fileno()
    except io.UnsupportedOperation:  # streams of a test
        return
    sys.stdout.flush()
    own = os.fdopen(os.dup(out), "w", encoding=sys.stdout.encoding, errors="backslashreplace")
    os.dup2(err, out)
    _kept.append(own)


def report_error(error: LimbError, *, as_json: bool) -> None:
    """Print the message to stderr and, with --json, the error as an object to stdout."""
    say(f"{type(error).__name__}: {error}", to_stderr=True)
    if as_json:
        report_json(error)


def report_json(error: LimbError) -> None:
    """Print the error as an object to stdout."""
    from limbcli.results import error_json

    print(json.dumps(error_json(error), indent=1), file=results(), flush=True)


INTERRUPTED = 130  # exit code after Ctrl-C: 128 + SIGINT; after SIGTERM it is 143
MESSAGE = "interrupted; no incomplete file was kept. Repeat the same command to finish."
