"""Progress reports on a running FEBio: iterations, heartbeat, and the default time limit."""

from __future__ import annotations

from pathlib import Path

from limbcli.feb.log import Iteration, LogReader
from limbcli.feb.outline import Outline
from limbcli.progress import Progress

HEARTBEAT_S = 15.0  # seconds without log output after which a heartbeat is reported
# Default time limit: minimum (s), and seconds per node and level. Generous (a model of 30,000 nodes and ten
# levels has 17 hours): it is meant to stop a run that hangs, not one that is slow.
_LEAST_LIMIT_S, _LIMIT_S_PER_NODE_AND_LEVEL = 1800.0, 0.2


def default_limit_s(outline: Outline) -> float:
    """Default time limit of a simulation (s), from its numbers of nodes and levels.

    >>> import numpy as np
    >>> small = Outline(1.0, (), np.arange(-1, 100), np.zeros(1, int), (0.5, 1.0))
    >>> default_limit_s(small)
    1800.0
    """
    n_nodes = outline.n_nodes
    n_levels = max(len(outline.must_points), 10)
    return max(_LEAST_LIMIT_S, _LIMIT_S_PER_NODE_AND_LEVEL * n_nodes * n_levels)


class LogWatcher:
    """Follows a growing log and notifies its listeners of every iteration."""

    def __init__(self, log: Path, outline: Outline, progress: Progress):
        self.log, self.reader = log, LogReader()
        self._progress = progress
        self._end = outline.end_time
        self._goals = sorted({*outline.must_points, *([outline.end_time] if outline.end_time else [])})
        self._offset = 0
        self._rest = ""

    def reached(self) -> float:
        return self.reader.times[-1] if self.reader.times else 0.0

    def look(self) -> bool:
        """Read new log lines; returns whether an iteration was reported."""
        try:
            with self.log.open("rb") as stream:
                stream.seek(self._offset)
                fresh = stream.read()
        except FileNotFoundError:
            return False
        self._offset += len(fresh)
        *lines, self._rest = (self._rest + fresh.decode(errors="replace")).split("\n")
        last = None
        for line in lines:
            last = self.reader.feed(line) or last
        if last is not None:
            self._report(last)
        return last is not None

    def alive(self, seconds: float, limit_s: float) -> None:
        """Report a heartbeat: FEBio is still running although its log shows nothing new."""
        self._progress.event(
            "alive",
            name="FEBio",
            seconds=round(seconds, 1),
            limit_s=limit_s,
            time=self.reached(),
            end_time=self._end,
        )

    def _report(self, iteration: Iteration) -> None:
        residual, target = iteration.worst()
        level = next((k for k, goal in enumerate(self._goals, 1) if goal >= iteration.time - 1e-9), 1)
        self._progress.event(
            "newton",
            step=level,
            n_steps=max(len(self._goals), 1),
            iteration=iteration.number,
            residual=residual,
            target=target,
            depth=None,
            time=iteration.time,
        )
