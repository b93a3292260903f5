"""How an interrupted command ends."""

from __future__ import annotations

INTERRUPTED = 130  # exit code
MESSAGE = "interrupted; nothing half-written was kept. The same command finishes the job."
