"""A reportlet answers one question with a figure or table, and says what good and bad look like."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from matplotlib.figure import Figure

from limbcli.reporting.outcome import Failure, Outcome

Mood = Literal["fine", "warning", "failed", "missing"]


@dataclass(frozen=True, eq=False)
class Picture:
    """A drawing (saved as PNG and SVG), or a PNG that a stage made.

    name : file name without ending; alt : what a reader who cannot see it must know
    vector : whether the page shows the SVG (lines) rather than the PNG (many facets)
    scene : a view that can be turned (`figures.scene`); the picture stands where there is no WebGL
    """

    name: str
    alt: str
    figure: Figure | None = None
    source: Path | None = None
    vector: bool = True
    scene: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Cell:
    """Text of a table cell; `reason` says why a value is a dash; `lead` makes it a row's head."""

    text: str
    reason: str = ""
    span: int = 1
    down: int = 1
    lead: bool = False


@dataclass(frozen=True)
class Table:
    """Rows of cells below one or two heading rows; numeric tables are set in columns."""

    caption: str
    head: tuple[tuple[Cell, ...], ...]
    rows: tuple[tuple[Cell, ...], ...]
    numeric: bool = True


@dataclass(frozen=True, eq=False)
class Reportlet:
    """One question and its answer.

    look_for, bad : the caption: what to look for, and what bad looks like
    notes : findings in plain words; warned : those that must not be overlooked
    """

    key: str
    title: str
    mood: Mood = "fine"
    site: str | None = None
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    look_for: str = ""
    bad: str = ""
    notes: tuple[str, ...] = ()
    warned: tuple[str, ...] = ()
    failure: Failure | None = None
    command: str = ""
    more: tuple[Table, ...] = field(default=())

    @property
    def is_answered(self) -> bool:
        return bool(self.pictures or self.tables or self.more)


def placeholder(key: str, title: str, outcome: Outcome) -> Reportlet:
    """An honest gap: the stage has not been run, or failed, and what makes it."""
    if outcome.status == "failed":
        return Reportlet(key, title, "failed", outcome.site, failure=outcome.failure, command=outcome.command)
    notes = [f"There is no result of “{outcome.stage}” yet, so this cannot be shown."]
    if outcome.held_by:
        notes.append(f"“{outcome.held_by}” failed before it; mend that first.")
    return Reportlet(key, title, "missing", outcome.site, notes=tuple(notes), command=outcome.command)


def head(*texts: str) -> tuple[Cell, ...]:
    return tuple(Cell(each, lead=True) for each in texts)
