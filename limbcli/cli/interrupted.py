"""Exit code and message of an interrupted command."""

from __future__ import annotations

INTERRUPTED = 130  # exit code after Ctrl-C: 128 + SIGINT; after SIGTERM it is 143
MESSAGE = "interrupted; no incomplete file was kept. Repeat the same command to finish."
