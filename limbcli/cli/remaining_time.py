"""Estimate of the remaining time from the progress of the work, and a heartbeat during silence."""

from __future__ import annotations

import contextlib
import threading
import time
import weakref
from collections.abc import Callable
from typing import Protocol

TOLD_AFTER_S = 3.0  # time (s) after which the remaining time is shown
SILENCE_S = 4.0  # silence (s) before a heartbeat; slightly less than the limit of five seconds without output
LOG_S = 60.0  # the same in a log that nobody watches, and the least time between two lines of one task


class TimeLeft:
    """Remaining time of the current work; reset when another work starts, or the same one starts again."""

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._name: object = None
        self._done, self._began, self._first = 0.0, 0.0, 0.0

    def words(self, name: object, done: float, total: float) -> str:
        """Text such as ", about 12 s left", or "" if it is too early for an estimate or the work is done."""
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
    """What the heartbeat needs: the time since the last report, and a call that reports that the work goes
    on."""

    def silent_s(self) -> float: ...

    def alive(self) -> None: ...


def keep_alive(listener: SilenceMonitor, *, silence_s: float) -> None:
    """Start a heartbeat that calls the listener whenever it was silent for `silence_s`; ends with the
    listener."""
    reference = weakref.ref(listener)

    def watch() -> None:
        while True:
            time.sleep(0.25 * silence_s)
            found = reference()
            if found is None:
                return
            if found.silent_s() >= silence_s:
                with contextlib.suppress(OSError, ValueError):  # the stream is closed
                    found.alive()
            del found

    threading.Thread(target=watch, daemon=True, name="limbcli-sign-of-life").start()
