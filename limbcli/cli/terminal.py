"""Progress on the terminal (stderr) and results (stdout)."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterable, Sequence
from typing import Any, TextIO

from limbcli.progress import SILENT, Progress
from limbcli.results import StageResult

_SECONDS_BETWEEN_LINES = 2.0


def terminal(*, quiet: bool = False, verbose: int = 0, stream: TextIO | None = None) -> Progress:
    """The listener that suits this terminal: one line rewritten in place, or plain lines."""
    if quiet:
        return SILENT
    stream = stream or sys.stderr
    return Progress(_Lines(stream, verbose=verbose, live=stream.isatty()))


class _Lines:
    """One line an event; on a terminal, repeated tasks rewrite their line."""

    def __init__(self, stream: TextIO, *, verbose: int, live: bool):
        self._stream, self._verbose, self._live = stream, verbose, live
        self._open = False
        self._last = 0.0

    def __call__(self, kind: str, facts: dict[str, Any]) -> None:
        text, fleeting = _describe(kind, facts)
        if not text:
            return
        if not fleeting:
            self._line(text)
        elif self._live:
            self._stream.write("\r\x1b[K" + text)
            self._stream.flush()
            self._open = True
        elif self._verbose or time.monotonic() - self._last > _SECONDS_BETWEEN_LINES:
            self._line(text)

    def _line(self, text: str) -> None:
        if self._open:
            self._stream.write("\r\x1b[K")
            self._open = False
        self._stream.write(text + "\n")
        self._stream.flush()
        self._last = time.monotonic()


def _describe(kind: str, facts: dict[str, Any]) -> tuple[str, bool]:
    """(text, whether the next event may overwrite it)."""
    match kind:
        case "stage":
            site = f" {facts['site']}" if facts.get("site") else ""
            return f"{facts['name']}{site}", False
        case "note":
            return f"  {facts['text']}", False
        case "compile":
            return f"  compiling {facts['what']} (the first time on this machine only)", False
        case "task":
            return f"  {facts['name']} {_bar(facts['done'], facts['total'])}", facts["done"] < facts["total"]
        case "newton":
            depth = f", depth {facts['depth']:.2f} mm" if facts.get("depth") is not None else ""
            text = f"  level {facts['step']} of {facts['n_steps']}{depth}, iteration {facts['iteration']}"
            return f"{text}, residual {facts['residual']:.1e} (target {facts['target']:.0e})", True
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
    """Print results: JSON for machines, or the summary for people."""
    several = [results] if isinstance(results, StageResult) else list(results)
    if as_json:
        contents = [{**each.to_json(), "folder": str(each.folder)} for each in several]
        emit_json(contents[0] if isinstance(results, StageResult) else contents)
        return
    for each in several:
        print(f"{each.stage}{' ' + each.site if each.site else ''}: {each.folder}")
        emit_lines(each.summary)
        emit_lines(f"warning: {text}" for text in each.warnings)


def emit_lines(lines: Iterable[str]) -> None:
    for line in lines:
        print(f"  {line}")


def emit_json(content: object) -> None:
    print(json.dumps(content, indent=1))
