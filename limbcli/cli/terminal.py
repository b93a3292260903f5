"""Progress on the terminal (stderr) and results (stdout)."""

from __future__ import annotations

import contextlib
import json
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TextIO

from limbcli.cli.output import results, say
from limbcli.files.plain_text import shown
from limbcli.progress import SILENT, Progress

if TYPE_CHECKING:
    from limbcli.results import StageResult

_LONGEST = 100  # largest number of characters of the current work in a heartbeat


def terminal(*, quiet: bool = False, verbose: int = 0, stream: TextIO | None = None) -> Progress:
    """The listener for this terminal: one line rewritten in place; in a log, plain lines at least LOG_S apart
    while one task goes on."""
    if quiet:
        return SILENT
    stream = stream or sys.stderr
    live = stream.isatty()
    lines = _Lines(stream, verbose=verbose, live=live)
    keep_alive(lines, silence_s=SILENCE_S if live else LOG_S)
    return Progress(lines)


class _Lines:
    """One line per event; on a terminal, repeated tasks rewrite their line; a heartbeat limits silence."""

    def __init__(self, stream: TextIO, *, verbose: int, live: bool):
        self._stream, self._verbose, self._live = stream, verbose, live
        self._open = False
        self._last = self._begun = time.monotonic()
        self._doing = ""
        self._describe = _Words()
        self._lock = threading.RLock()

    def __call__(self, kind: str, facts: dict[str, Any]) -> None:
        text, fleeting = self._describe(kind, facts)
        if not text:
            return
        with self._lock:
            self._doing, self._begun = text.strip(), time.monotonic()
            if not fleeting:
                self._line(text)
            elif self._live:
                self._rewrite(text)
            elif self._verbose or time.monotonic() - self._last > LOG_S:
                self._line(text)

    def silent_s(self) -> float:
        """Seconds since the last report; 0 before the first event."""
        return time.monotonic() - self._last if self._doing else 0.0

    def alive(self) -> None:
        """Report that the last announced work goes on, and for how long."""
        with self._lock:
            text = f"  {self._doing[:_LONGEST]} ... still running, {time.monotonic() - self._begun:.0f} s"
            self._rewrite(text) if self._live else self._line(text)

    def _rewrite(self, text: str) -> None:
        self._stream.write("\r\x1b[K" + shown(text))
        self._stream.flush()
        self._open, self._last = True, time.monotonic()

    def _line(self, text: str) -> None:
        if self._open:
            self._stream.write("\r\x1b[K")
            self._open = False
        self._stream.write(shown(text) + "\n")
        self._stream.flush()
        self._last = time.monotonic()


class _Words:
    """Events in words, with the remaining time of long work, and the solve that a level belongs to."""

    def __init__(self) -> None:
        self._solve = ""
        self._task, self._level = TimeLeft(), TimeLeft()

    def __call__(self, kind: str, facts: dict[str, Any]) -> tuple[str, bool]:
        """(text, whether the next event may overwrite it)."""
        match kind:
            case "stage":
                self._solve = ""
                site = f" {facts['site']}" if facts.get("site") else ""
                return f"{facts['name']}{site}", False
            case "solve":
                self._solve = _solve(facts)
                return f"  {self._solve}", True
            case "task":
                name, done, total = facts["name"], facts["done"], facts["total"]
                left = self._task.words(name, done, total)
                return f"  {name} {_bar(done, total)}{left}", done < total
            case "newton":
                step, n_steps = facts["step"], facts["n_steps"]
                left = self._level.words((self._solve, n_steps), step, n_steps)
                return _newton(facts, self._solve) + left, True
        return _describe(kind, facts)


def _solve(facts: dict[str, Any]) -> str:
    """
    >>> _solve({"number": 9, "at_most": 20}), _solve({"number": 3})
    ('solve 9 of at most 20', 'solve 3')
    """
    total = f" of at most {facts['at_most']}" if facts.get("at_most") else ""
    return f"solve {facts['number']}{total}"


def _newton(facts: dict[str, Any], solve: str) -> str:
    """
    >>> facts = {"step": 4, "n_steps": 15, "iteration": 2, "residual": 3e-2, "target": 1e-4}
    >>> _newton({**facts, "aim": "donned 40 %"}, "")
    '  level 4 of 15, donned 40 %, iteration 2, residual 3.0e-02 (target 1e-04)'
    """
    aim = f", {facts['aim']}" if facts.get("aim") else ""
    of_solve = f"{solve}, " if solve else ""
    text = f"  {of_solve}level {facts['step']} of {facts['n_steps']}{aim}, iteration {facts['iteration']}"
    return f"{text}, residual {facts['residual']:.1e} (target {facts['target']:.0e})"


def _describe(kind: str, facts: dict[str, Any]) -> tuple[str, bool]:
    """(text, whether the next event may overwrite it), for events that do not depend on earlier ones."""
    match kind:
        case "note":
            return f"  {facts['text']}", False
        case "compile":
            return f"  compiling {facts['what']}", False
        case "alive":
            end = f" of {facts['end_time']:g}" if facts.get("end_time") else ""
            text = f"  {facts['name']} has run for {facts['seconds']:.0f} s, at time {facts['time']:.3g}{end}"
            return f"{text} (stopped after {facts['limit_s']:.0f} s)", True
        case "fit":
            values = ", ".join(f"{name} {value:.4g}" for name, value in facts["parameters"].items())
            return f"  fit iteration {facts['iteration']}: {values}; cost {facts['cost']:.4g}", False
    return "", False


def _bar(done: int, total: int, width: int = 24) -> str:
    filled = round(width * done / max(total, 1))
    return f"[{'#' * filled}{'.' * (width - filled)}] {done}/{total}"


def emit(results: StageResult | Sequence[StageResult], *, as_json: bool) -> None:
    """Print results: JSON for programs, or the summary for people."""
    several = list(results) if isinstance(results, Sequence) else [results]
    if as_json:
        contents = [{**each.to_json(), "folder": str(each.folder)} for each in several]
        emit_json(contents if isinstance(results, Sequence) else contents[0])
        return
    for each in several:
        say(f"{each.stage}{' ' + each.site if each.site else ''}: {each.folder}")
        emit_lines(each.summary)
        emit_lines(f"warning: {text}" for text in each.warnings)


def emit_lines(lines: Iterable[str]) -> None:
    for line in lines:
        say(f"  {line}")


def emit_json(content: object) -> None:
    print(json.dumps(content, indent=1), file=results(), flush=True)


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
