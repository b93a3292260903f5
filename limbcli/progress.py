"""Science emits facts, listeners show them.

`progress.event("newton", step=7, n_steps=20, residual=3.1e-2)` says what is so;
whether that becomes a bar, a line in a log or a point of a plot is the
listener's business.

Kinds in use: "stage" (name, site), "task" (name, done, total), "newton" (step,
n_steps, iteration, residual, target, depth), "fit" (iteration, cost, parameters),
"compile" (what), "note" (text).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Listener = Callable[[str, dict[str, Any]], None]


class Progress:
    """Hands every event to every listener, in order.

    >>> seen = []
    >>> Progress(lambda kind, facts: seen.append((kind, facts["done"]))).event("task", done=3)
    >>> seen
    [('task', 3)]
    """

    def __init__(self, *listeners: Listener):
        self._listeners = listeners

    def event(self, kind: str, **facts: Any) -> None:
        for listener in self._listeners:
            listener(kind, facts)

    def also(self, *listeners: Listener) -> Progress:
        """The same, with more listeners."""
        return Progress(*self._listeners, *listeners)


SILENT = Progress()
