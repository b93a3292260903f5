"""The stream of results: with --json nothing but our JSON reaches stdout, whatever libraries print."""

from __future__ import annotations

import io
import os
import sys
from typing import TextIO

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
