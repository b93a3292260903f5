"""Progress events: computations report facts, listeners display them.

`progress.event("newton", step=7, n_steps=20, residual=3.1e-2)` reports a fact; whether it becomes a progress
bar, a log line or a point of a plot is up to the listener.

Kinds in use: "stage" (name, site), "task" (name, done, total), "newton" (step, n_steps, iteration, residual,
target, depth, aim, time, krylov, factorisations), "fit" (iteration, cost, parameters), "compile" (what),
"solve" (number, at_most: which of the simulations of a fit begins), "alive" (name, seconds, limit_s, time,
end_time), "note" (text).
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

PROGRESS_FILE = "progress.jsonl"

Listener = Callable[[str, dict[str, Any]], None]


class Progress:
    """Passes every event to every listener, in order.

    >>> seen = []
    >>> Progress(lambda kind, facts: seen.append((kind, facts["done"]))).event("task", done=3)
    >>> seen
    [('task', 3)]
    """

    def __init__(self, *listeners: Listener):
        self._listeners = listeners

    def __repr__(self) -> str:
        return f"Progress({', '.join(map(repr, self._listeners))})"

    def event(self, kind: str, **facts: Any) -> None:
        """Pass an event to every listener."""
        for listener in self._listeners:
            listener(kind, facts)

    def also(self, *listeners: Listener) -> Progress:
        """The same, with additional listeners."""
        return Progress(*self._listeners, *listeners)


SILENT = Progress()


@contextlib.contextmanager
def recorded(progress: Progress, path: Path) -> Iterator[Progress]:
    """The same progress, with every event also written to `path`: one JSON object per line.

    Each line has "kind", "elapsed_s" (since the recording began) and the event's facts. From a record in a
    stage's folder, the report plots the convergence of the solver and the fit.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "progress.jsonl"
    >>> with recorded(SILENT, path) as progress:
    ...     progress.event("newton", step=1, n_steps=2, residual=3e-2)
    >>> [(each["kind"], each["residual"]) for each in read_events(path)]
    [('newton', 0.03)]
    """
    start = time.monotonic()
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", buffering=1) as stream:

        def keep(kind: str, facts: dict[str, Any]) -> None:
            line = {"kind": kind, "elapsed_s": round(time.monotonic() - start, 3), **facts}
            stream.write(json.dumps(line, default=_plain_number) + "\n")

        yield progress.also(keep)


def read_events(path: Path) -> list[dict[str, Any]]:
    """Read the events written by `recorded`. A last line truncated by an interruption is omitted."""
    events = []
    for line in path.read_text(encoding="utf-8").splitlines():
        with contextlib.suppress(ValueError):
            event = json.loads(line)
            if isinstance(event, dict) and "kind" in event:
                events.append(event)
    return events


def _plain_number(value: object) -> object:
    """numpy scalars and arrays as plain numbers; anything else as text."""
    as_list = getattr(value, "tolist", None)
    return as_list() if callable(as_list) else str(value)
