"""Check that a log belongs to a given model file.

Each run gets a mark, derived from the content of the model file, as the name of its plot file, which the log
repeats in its list of files. A log without a mark is identified by the input that FEBio repeats in it: the
number of nodes and the parameters of all materials.

Source: FEBio 4, FEBioModel::echo_input (FEBioLib/input.cpp); numbers are printed with six digits.
"""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

from limbcli.errors import SolveError
from limbcli.feb.outline import Outline, finite_number

_HEAD_LINES = 20_000  # lines at the start of a log that may repeat the input
_DIGITS = 2e-5  # relative tolerance of numbers printed with six digits
_MARK = re.compile(r"^\s*(?:Plot|Model) file\s*: \S*?limbcli-([0-9a-f]{16})\.")
_NODES = re.compile(r"^\s*Number of nodes \.+ ?: (\d+)\s*$")
_MATERIAL = re.compile(r"^  (\d+) - (.*) \(type: (.*)\)$")
_VALUE = re.compile(r"^\t(\w+) \.* ?: (\S+)\s*$")
_SECTION = re.compile(r"^ [A-Z][A-Z ]+$")


def mark_of(feb: Path) -> str:
    """Mark of the runs of this file: 16 hexadecimal digits of the SHA-256 of its content."""
    return hashlib.sha256(feb.read_bytes()).hexdigest()[:16]


def marked(feb: Path, ending: str) -> str:
    """File name with the mark, as it appears in the log's list of files."""
    return f"limbcli-{mark_of(feb)}{ending}"


@dataclass
class Echo:
    """Input repeated in a log; materials: numeric parameters by material id and name."""

    mark: str = ""
    n_nodes: int | None = None
    materials: dict[int, dict[str, float]] = field(default_factory=dict)


def read_echo(lines: Iterable[str]) -> Echo:
    """Parse the head of a log.

    >>> read_echo(["\\tPlot file  : limbcli-0123456789abcdef.xplt"]).mark
    '0123456789abcdef'
    """
    echo = Echo()
    values: dict[str, float] | None = None
    inside = False
    for line in lines:
        if _SECTION.match(line):
            inside, values = line.strip() == "MATERIAL DATA", None
        elif found := _MARK.match(line):
            echo.mark = echo.mark or found[1]
        elif found := _NODES.match(line):
            echo.n_nodes = int(found[1])
        elif inside and (found := _MATERIAL.match(line)):
            values = echo.materials.setdefault(int(found[1]), {})
        elif values is not None and (found := _VALUE.match(line)):
            number = finite_number(found[2])
            if number is not None:
                values[found[1]] = number
    return echo


def check_belongs(log: Path, feb: Path, outline: Outline, *, by_mark: bool = False) -> None:
    """Check that a log belongs to this model file.

    by_mark : only the mark counts, as in a run that was given one

    Raises SolveError if the log belongs to another model, or does not identify its model.
    """
    with log.open(encoding="utf-8", errors="replace") as stream:
        echo = read_echo(line.rstrip("\r\n") for line in itertools.islice(stream, _HEAD_LINES))
    if echo.mark and echo.mark != mark_of(feb):
        _refuse(log, f"the log is of another model file than the {feb.name} next to it (mark {echo.mark})")
    if echo.mark:
        return
    if by_mark:
        _refuse(log, "the log does not contain the mark of this run: it is of another run")
    if echo.n_nodes is None or not echo.materials:
        _refuse(log, f"the log does not state which model it is of, so it cannot be attributed to {feb.name}")
    _compare(echo, outline, log)


def _compare(echo: Echo, outline: Outline, log: Path) -> None:
    n_nodes = outline.n_nodes
    if echo.n_nodes != n_nodes:
        _refuse(log, f"the log reports {echo.n_nodes} nodes, the model file has {n_nodes}")
    for number, parameters in outline.materials.items():
        other = echo.materials.get(number)
        if other is None:
            _refuse(log, f"the log does not report material {number} of the model file")
        for name, ours in parameters.items():
            if name in other and abs(other[name] - ours) > _DIGITS * max(abs(ours), 1e-12):
                _refuse(log, f"the log reports a different material: {name} is {other[name]:g}, not {ours:g}")


def _refuse(log: Path, what: str) -> NoReturn:
    raise SolveError(
        what,
        where=str(log),
        fix="run the simulation again, in a separate folder (`limbcli run`); check which program --febio "
        "names",
    )
