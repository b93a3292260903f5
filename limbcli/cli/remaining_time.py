"""How long a piece of work will still take, from how far it is; and signs of life in between."""

from __future__ import annotations

import contextlib
import threading
import time
import weakref
from collections.abc import Callable
from typing import Protocol

TOLD_AFTER_S = 3.0  # work that is shorter needs no time left
SILENCE_S = 4.0  # a little less than the five seconds that a person is let wait for a sign


class TimeLeft:
    """Time left of the work at hand; it starts anew where another work begins, or the same once more."""

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._name: object = None
        self._done, self._began, self._first = 0.0, 0.0, 0.0

    def words(self, name: object, done: float, total: float) -> str:
        """ ", about 12 s left", or nothing where it is too early to tell or the end is there."""
        now = self._clock()
        if name != self._name or done < self._done:
            self._name, self._began, self._first = name, now, done
        self._done = done
        spent, gained = now - self._began, done - self._first
        if spent < TOLD_AFTER_S or gained <= 0 or done >= total:
            return ""
        return f", about {seconds((total - done) * spent / gained)} left"


def seconds(value: float) -> str:
    """
    >>> seconds(4.2), seconds(75), seconds(130), seconds(7300)
    ('5 s', '80 s', '3 min', '2.1 h')
    """
    if value < 20:
        return f"{-(-value // 1):.0f} s"
    if value < 90:
        return f"{-(-value // 10) * 10:.0f} s"
    if value < 5400:
        return f"{-(-value // 60):.0f} min"
    return f"{-(-value // 360) / 10:.1f} h"


class SilenceMonitor(Protocol):
    """What a heartbeat asks: how long nothing was reported, and to tell that the work goes on."""

    def silent_s(self) -> float: ...

    def alive(self) -> None: ...


def keep_alive(listener: SilenceMonitor, *, silence_s: float = SILENCE_S) -> None:
    """Have a listener told whenever it was silent for so long; ends with the listener."""
    reference = weakref.ref(listener)

    def watch() -> None:
        while True:
            time.sleep(0.25 * silence_s)
            found = reference()
            if found is None:
                return
            if found.silent_s() >= silence_s:
                with contextlib.suppress(OSError, ValueError):  # nobody reads any more
                    found.alive()
            del found

    threading.Thread(target=watch, daemon=True, name="limbcli-sign-of-life").start()
