"""FEBio's log: how far the run came, its cost, how it ended, and its messages."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NoReturn

from limbcli.errors import SolveError

_LAST_LINES = 12
_STATISTICS = "N O N L I N E A R"
_LARGEST = 1e15  # largest accepted total
_TIME_TOLERANCE = 1e-6
# FEBio's banner (febio::Hello) and `-info` (FEBioApp): three numbers in a release, and a fourth part, the
# commit, in a build from git (febio::getVersionString).
_VERSION = re.compile(r"^\s*(?:FEBio )?version\s+(?:= )?(\d+(?:\.\d+)+[\w.+-]*)(?: \(DEBUG\))?\s*$")
_CONVERGED = re.compile(r"^-+ converged at time : (\S+)")
_BEGIN = re.compile(r"^=+ beginning time step (\d+) : (\S+) =+")
_TOTAL = re.compile(r"^\s*(Number of|Total number of|Nr of|Total elapsed) ([a-z ]+?) \.* ?: (.+)$")
_NORM = re.compile(r"^\s*(residual|energy|displacement)\s+(\S+)\s+(\S+)\s+(\S+)\s*$")
_SECONDS = re.compile(r"\(([\d.eE+-]+) sec\)")
_BOX_EDGE = re.compile(r"^ \*{20,}$")


def warning_box(text: str) -> str:
    """A warning in the form of FEBio's, which `read_log` finds again.

    >>> read_lines(warning_box("nothing was touched").splitlines()).warnings
    ('nothing was touched',)
    """
    edge = f" {'*' * 73}"
    return f"\n{edge}\n *{'WARNING':^71}*\n * {text}\n{edge}\n"


@dataclass(frozen=True)
class Iteration:
    """One equilibrium iteration; `norms` are (current, required) by name."""

    step: int
    time: float
    number: int
    norms: dict[str, tuple[float, float]]

    def worst(self) -> tuple[float, float]:
        """(current, required) of the norm farthest from its target.

        >>> Iteration(1, 0.1, 3, {"residual": (1e-3, 0.0), "energy": (2e-3, 1e-3)}).worst()
        (0.002, 0.001)
        """
        judged = [(now, target) for now, target in self.norms.values() if target > 0]
        return max(judged, key=lambda each: each[0] / each[1], default=(0.0, 0.0))


@dataclass(frozen=True)
class FebioLog:
    """Content of a log.

    ending : "normal" or "error" as FEBio reports, "none" if the log is incomplete
    times : times of the converged steps (without 0)
    n_iterations, n_reformations : FEBio's totals if present (they exclude attempts that were retried), else
        counted
    """

    version: str
    ending: Literal["normal", "error", "none"]
    times: tuple[float, ...]
    n_iterations: int
    n_reformations: int
    n_retries: int
    n_equations: int
    seconds: float
    linear_solver: str
    warnings: tuple[str, ...]
    errors: tuple[str, ...]
    last_lines: tuple[str, ...]


@dataclass
class LogReader:
    """Incremental parser of a growing log, line by line; `result` can be called at any time."""

    version: str = ""
    ending: Literal["normal", "error", "none"] = "none"
    times: list[float] = field(default_factory=list)
    n_retries: int = 0
    step: int = 0
    iterations: list[Iteration] = field(default_factory=list)
    boxes: dict[str, list[str]] = field(default_factory=lambda: {"WARNING": [], "ERROR": [], "": []})
    _totals: dict[str, float] = field(default_factory=dict)
    _counted: dict[str, int] = field(default_factory=lambda: {"iterations": 0, "reformations": 0})
    _box: list[str] | None = None
    _in_statistics: bool = False
    _open: tuple[float, int] = (0.0, 0)
    _norms: dict[str, tuple[float, float]] = field(default_factory=dict)
    _tail: deque[str] = field(default_factory=lambda: deque(maxlen=_LAST_LINES))

    def feed(self, line: str) -> Iteration | None:
        """Parse one line; returns the iteration that it completes, if any."""
        line = line.rstrip("\n").rstrip("\r")
        self._remember(line.strip())
        if self._in_box(line):
            return None
        if found := _NORM.match(line):
            return self._norm(found)
        self._event(line)
        return None

    def _remember(self, text: str) -> None:
        """Keep the last lines before the statistics, and the ending."""
        self._in_statistics = self._in_statistics or text.startswith(_STATISTICS)
        if text and (not self._in_statistics or text.endswith("T E R M I N A T I O N")):
            self._tail.append(text)

    def _in_box(self, line: str) -> bool:
        """Parse messages, which are boxes of asterisks that begin with WARNING or ERROR."""
        if _BOX_EDGE.match(line):
            if self._box is None:
                self._box = []
            else:
                kind = self._box[0] if self._box and self._box[0] in ("WARNING", "ERROR") else ""
                self.boxes[kind].append(" ".join(self._box[1:] if kind else self._box))
                self._box = None
            return True
        if self._box is None:
            return False
        if not line.startswith(" *"):
            self._box = None
            return False
        self._box.append(line.strip().strip("*").strip())
        return True

    def _norm(self, found: re.Match[str]) -> Iteration | None:
        name, _, now, target = found.groups()
        try:
            self._norms[name] = (float(now), float(target))
        except ValueError:
            return None
        if name != "displacement":
            return None
        iteration = Iteration(self.step, *self._open, dict(self._norms))
        self.iterations.append(iteration)
        return iteration

    def _event(self, line: str) -> None:
        text = line.strip()
        if not self.version and (found := _VERSION.match(line)):
            self.version = found[1]
        elif found := _BEGIN.match(text):
            self.step, self._open = int(found[1]), (_number(found[2]), 0)
            self._in_statistics = False
        elif text.startswith("Nonlinear solution status"):
            self._open = (self._open[0], self._open[1] + 1)
            self._norms = {}
            self._counted["iterations"] += 1
        elif text.startswith("Reforming stiffness matrix"):
            self._counted["reformations"] += 1
        elif found := _CONVERGED.match(text):
            self.times.append(_number(found[1]))
        elif text.startswith("Retrying time step"):
            self.n_retries += 1
        elif text in ("N O R M A L   T E R M I N A T I O N", "E R R O R   T E R M I N A T I O N"):
            self.ending = "normal" if text.startswith("N") else "error"
        elif found := _TOTAL.match(line):
            self._total(found[2], found[3])

    def _total(self, name: str, text: str) -> None:
        """Read totals at the end of a log, summed over its steps; text that is not a number is ignored."""
        if not 0 <= _number(text) < _LARGEST and not _SECONDS.search(text):
            return
        if found := _SECONDS.search(text):
            self._totals["seconds"] = _number(found[1])
        elif name == "equations":
            self._totals[name] = _number(text)
        else:
            self._totals[name] = self._totals.get(name, 0.0) + _number(text)

    def result(self) -> FebioLog:
        counted = self._counted
        solver = [text for text in self.boxes[""] if text.startswith("Selecting linear solver ")]
        return FebioLog(
            version=self.version,
            ending=self.ending,
            times=tuple(self.times),
            n_iterations=int(self._totals.get("equilibrium iterations", counted["iterations"])),
            n_reformations=int(self._totals.get("stiffness reformations", counted["reformations"])),
            n_retries=self.n_retries,
            n_equations=int(self._totals.get("equations", 0)),
            seconds=self._totals.get("seconds", 0.0),
            linear_solver=solver[-1].removeprefix("Selecting linear solver ") if solver else "",
            warnings=tuple(self.boxes["WARNING"]),
            errors=tuple(self.boxes["ERROR"]),
            last_lines=tuple(self._tail),
        )


def _number(text: str) -> float:
    try:
        return float(text.split()[0])
    except (ValueError, IndexError):
        return float("nan")


def read_log(path: Path) -> FebioLog:
    """Parse a log, complete or not.

    Raises SolveError if there is no file, or it is not a FEBio log (the message shows its last lines).
    """
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise SolveError(
            f"there is no log of the run ({error.strerror})",
            where=str(path),
            fix="run the simulation again; if it recurs, start FEBio manually on the model file",
        ) from error
    log = read_lines(lines)
    if not log.version:
        raise SolveError(
            f"this is not a FEBio log. It ends with:\n{quote(log.last_lines)}",
            where=str(path),
            fix="check that the binary is FEBio 4 (`limbcli run --febio FILE`)",
        )
    return log


def read_lines(lines: Iterable[str]) -> FebioLog:
    reader = LogReader()
    for line in lines:
        reader.feed(line)
    return reader.result()


def check_complete(log: FebioLog, path: Path, *, end_time: float | None = None) -> None:
    """Check that the log reports normal termination and that its last time is the end of the load.

    Raises SolveError with FEBio's own messages and the log's last lines.
    """
    reached = log.times[-1] if log.times else 0.0
    if log.ending == "error":
        _fail(log, path, f"FEBio stopped with an error at time {reached:g}", reached)
    if log.ending == "none":
        what = f"FEBio's log ends abruptly at time {reached:g}: the run was stopped or crashed"
        _fail(log, path, what, reached)
    if end_time is not None and abs(reached - end_time) > _TIME_TOLERANCE * max(1.0, end_time):
        _fail(log, path, f"FEBio ended at time {reached:g} and not at {end_time:g}", reached)


def _fail(log: FebioLog, path: Path, what: str, reached: float) -> NoReturn:
    messages = list(dict.fromkeys(log.errors))[-3:]
    reported = f"\nFEBio says: {'; '.join(messages)}" if messages else ""
    raise SolveError(
        f"{what} after {log.n_iterations} iterations and {log.n_retries} retries.{reported}\n"
        f"The log ends with:\n{quote(log.last_lines)}",
        where=str(path),
        fix="try a smaller first step or more steps in the model; `--solver reference` runs without FEBio",
        time_reached=reached,
        n_retries=log.n_retries,
        errors=list(log.errors),
    )


def quote(lines: Iterable[str]) -> str:
    return "\n".join(f"    | {line}" for line in lines)
