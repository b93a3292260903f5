"""How an interrupted command ends."""

from __future__ import annotations

INTERRUPTED = 130  # exit code of Ctrl-C: 128 and the number of SIGINT; that of a polite kill is 143
MESSAGE = "interrupted; no incomplete file was kept. Repeat the same command to finish."
