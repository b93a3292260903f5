"""A reportlet answers one question with a figure or table, and explains what good and bad look like."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any, Literal

from matplotlib.figure import Figure

from limbcli.reporting.outcome import Failure, Outcome
from limbcli.results import StageResult

Mood = Literal["fine", "warning", "failed", "missing", "neutral"]
# What a colour says, in words: colour alone says nothing to who cannot see it. Neutral: nothing is tested.
MOOD_WORDS: Mapping[Mood, str] = {
    "fine": "good", "warning": "doubtful", "failed": "bad", "missing": "not yet", "neutral": "not judged",
}  # fmt: skip
_WORST: tuple[Mood, ...] = ("neutral", "fine", "missing", "warning", "failed")


def worst_mood(*moods: Mood) -> Mood:
    """
    >>> worst_mood("fine", "warning"), worst_mood("neutral", "fine")
    ('warning', 'fine')
    """
    return max(moods, key=_WORST.index)


@dataclass(frozen=True, eq=False)
class Picture:
    """A drawing (saved as PNG and SVG), or a PNG made by a stage.

    name : file name without suffix
    alt : alternative text for readers who cannot see the picture
    vector : whether the page shows the SVG (lines) rather than the PNG (many facets)
    scene : an interactive 3-D view (`figures.scene`); the picture is shown where WebGL is not available
    """

    name: str
    alt: str
    figure: Figure | None = None
    source: Path | None = None
    vector: bool = True
    scene: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Cell:
    """Text of a table cell; `reason` explains a dash; `lead` makes it a row heading."""

    text: str
    reason: str = ""
    span: int = 1
    down: int = 1
    lead: bool = False


@dataclass(frozen=True)
class PageTable:
    """Rows of cells below one or two heading rows; numeric tables are aligned in columns."""

    caption: str
    head: tuple[tuple[Cell, ...], ...]
    rows: tuple[tuple[Cell, ...], ...]
    numeric: bool = True

    @property
    def labelled(self) -> tuple[tuple[tuple[Cell, str], ...], ...]:
        """Rows of cells, each with its column heading, for screens too narrow for columns.

        >>> names = (Cell("site", down=2), Cell("Ogden", span=2)), (Cell("c"), Cell("m"))
        >>> [label for _, label in PageTable("", names, ((Cell("p1"), Cell("8"), Cell("6")),)).labelled[0]]
        ['site', 'Ogden: c', 'Ogden: m']
        """
        columns: dict[int, list[str]] = {}
        for row in _placed(self.head):
            for cell, first in row:
                for k in range(first, first + cell.span):
                    columns.setdefault(k, []).append(cell.text)
        return tuple(
            tuple((cell, ": ".join(columns.get(first, [])) if cell.span == 1 else "") for cell, first in row)
            for row in _placed(self.rows)
        )


def _placed(rows: Sequence[Sequence[Cell]]) -> list[list[tuple[Cell, int]]]:
    """Each cell with its first column; cells that span several rows shift those below."""
    taken: set[tuple[int, int]] = set()
    placed = []
    for k, row in enumerate(rows):
        column, found = 0, []
        for cell in row:
            while (k, column) in taken:
                column += 1
            found.append((cell, column))
            taken |= {(k + i, column + j) for i in range(cell.down) for j in range(cell.span)}
            column += cell.span
        placed.append(found)
    return placed


@dataclass(frozen=True, eq=False)
class Reportlet:
    """One question and its answer.

    answer : a sentence, if there is one; it is shown first
    look_for, bad : the caption: what to look for, and what a bad result looks like
    notes : findings in plain words
    warned : findings that must not be overlooked
    n_above : number of further ones, which the page tells at its top
    """

    key: str = ""
    title: str = ""
    mood: Mood = "neutral"
    site: str | None = None
    _: KW_ONLY
    pictures: tuple[Picture, ...] = ()
    tables: tuple[PageTable, ...] = ()
    look_for: str = ""
    bad: str = ""
    notes: tuple[str, ...] = ()
    warned: tuple[str, ...] = ()
    failure: Failure | None = None
    command: str = ""
    more: tuple[PageTable, ...] = field(default=())
    answer: str = ""
    n_above: int = 0

    @property
    def word(self) -> str:
        """The state in words."""
        return "failed" if self.failure else MOOD_WORDS[self.mood]

    @property
    def is_answered(self) -> bool:
        return bool(self.pictures or self.tables or self.more)


def placeholder(key: str, title: str, outcome: Outcome) -> Reportlet:
    """Reportlet of a stage that has not been run or failed, with the command that provides its result."""
    if outcome.status == "failed":
        return Reportlet(key, title, "failed", outcome.site, failure=outcome.failure, command=outcome.command)
    notes = [f"There is no result of “{outcome.stage}” yet, so this cannot be shown."]
    if outcome.held_by:
        notes.append(f"“{outcome.held_by}” failed before it; resolve that first.")
    return Reportlet(key, title, "missing", outcome.site, notes=tuple(notes), command=outcome.command)


def table(
    caption: str, titles: Sequence[str], rows: Iterable[Sequence[Cell | str]], *, numeric: bool = True
) -> PageTable:
    """A table with one heading row; a text becomes a cell, and the first text of a row its heading."""
    cells = (
        tuple(each if isinstance(each, Cell) else Cell(each, lead=k == 0) for k, each in enumerate(row))
        for row in rows
    )
    return PageTable(caption, (head(*titles),), tuple(cells), numeric=numeric)


def pictures_of(result: StageResult, texts: Mapping[str, tuple[str, str]]) -> tuple[Picture, ...]:
    """The pictures that a stage wrote; those that it did not write are left out.

    texts : by the file's key in the result, or its name: the picture's name and alternative text
    """
    found = []
    for key, (name, alt) in texts.items():
        path = result.folder / result.files.get(key, key)
        if path.is_file():
            found.append(Picture(name, alt, source=path, vector=False))
    return tuple(found)


def head(*texts: str) -> tuple[Cell, ...]:
    return tuple(Cell(each, lead=True) for each in texts)
