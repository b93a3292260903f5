"""The text of an instrument's file and its cells: encoding, binary files, lines above the header."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from limbcli.errors import MeasurementError
from limbcli.errors.problems import checked
from limbcli.measurement.column_units import is_unit
from limbcli.measurement.number_table import SEPARATOR_LINE, binary_kind, csv_rows, number_of

_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x19\x1b-\x1f]")
_MOST_CONTROL = 0.01  # share of control characters above which a file is not text
_SPECIAL = re.compile(rb"\*\*\*Start_Special\*\*\*.*?(?:\*\*\*End_Special\*\*\*[^\r\n]*|\Z)", re.DOTALL)
_MARKS = ("\t", ";", ",")
_WITH_COMMA = re.compile(r"[+-]?\d+(,\d+([eE][+-]?\d+)?)?")
_MOST_ABOVE = 500  # lines above a header that are searched


@dataclass(frozen=True)
class Sheet:
    """The cells below a header; units : of the columns as another line than the header states them, or ""."""

    header: Sequence[str]
    rows: list[list[str]]
    separator: str
    units: Sequence[str] = ()

    def cell(self, row: int, column: int) -> str:
        return cell(self.rows[row], column)

    def unit(self, column: int) -> str:
        return cell(list(self.units), column)


def cell(row: list[str], position: int) -> str:
    return row[position].strip() if position < len(row) else ""


def is_number(text: str) -> bool:
    """
    >>> is_number("1,5"), is_number("-2e3"), is_number("X0")
    (True, True, False)
    """
    try:
        number_of(text.strip().replace(",", "."))
    except ValueError:
        return False
    return True


def text_of(path: Path) -> str:
    """The text of a file in UTF-8, UTF-16 or Latin-1, without LabVIEW's special blocks (which may be binary).

    Raises MeasurementError if it is a binary file; its content is not shown.
    """
    content = path.read_bytes()
    kind = binary_kind(content)
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encodings = ["utf-16"]
    elif kind is None and content[1::2].count(0) > 0.4 * len(content):  # UTF-16 without its mark
        encodings = ["utf-16-le"]
    else:
        encodings = ["utf-8-sig", "latin-1"]
        content = _SPECIAL.sub(b"", content)
        n_control = len(_CONTROL.findall(content))
        if kind is None and (b"\0" in content or n_control > _MOST_CONTROL * len(content)):
            kind = "no text"
    if kind is not None:
        raise MeasurementError(
            f"the record is a binary file ({kind})",
            where=str(path),
            fix="export it from the program that wrote it: CSV, or LabVIEW's .lvm or .tdms",
        )
    for encoding in encodings:
        try:
            return content.decode(encoding)
        except UnicodeDecodeError:
            continue
    raise MeasurementError(
        "the record is not text in UTF-8 or UTF-16", where=str(path), fix="save it again as CSV in UTF-8"
    )


def csv_sheet(
    text: str, path: Path, is_header: Callable[[Sequence[str]], bool], *, separator: str | None
) -> Sheet:
    """The table of a CSV text: lines that begin with # and lines above its header are left out.

    is_header : whether these titles contain the columns that are wanted
    separator : None: as a first line `sep=` states it, else detected

    Raises MeasurementError if it has no rows, or a row cannot be read.
    """
    lines = text.splitlines()
    named = SEPARATOR_LINE.match(lines[0]) if lines else None
    marks = (separator,) if separator else (named[1],) if named else _MARKS
    if named:
        lines[0] = ""
    if not separator and not named and _has_spaces_between(lines):
        lines = _of_spaces([re.sub(r"^#\s+", "#", line) for line in lines])
    at, mark = _header_line(lines, marks, is_header)
    lines = _without_further_headers(lines, at, mark)
    kept = ["" if k < at or (k > at and line.startswith("#")) else line for k, line in enumerate(lines)]
    cells = checked(*csv_rows("\n".join(kept), path, separator=mark), MeasurementError)
    rows = [row for row in cells if any(each.strip() for each in row)]
    if len(rows) < 2:
        fix = "give the file that the load cell's program wrote"
        raise MeasurementError("the record has no rows", where=str(path), fix=fix)
    _require_width(rows[1:], len(rows[0]), path)
    return Sheet([each.strip() for each in rows[0]], rows[1:], mark)


def _without_further_headers(lines: list[str], at: int, mark: str) -> list[str]:
    """Lines without headers that stand again between rows, as testing machines write them for each block.

    at : number of the header. What stands around it, up to the next rows, is left out too
    """
    again = [k for k in range(at + 1, len(lines)) if lines[k].strip() == lines[at].strip()]
    if not again:
        return lines
    found, kinds = list(lines), [tuple(map(is_number, _titles(line, mark))) for line in lines]
    usual = Counter(kinds[at + 1 :]).most_common(1)[0][0]
    for k in again:
        for way in (-1, 1):
            here = k
            while at < here < len(lines) and kinds[here] != usual:
                found[here] = ""
                here += way
    return found


def _has_spaces_between(lines: list[str]) -> bool:
    """Whether columns are separated by spaces: nothing else separates them, or commas stand within numbers.

    >>> _has_spaces_between(["0,1 2,35"]), _has_spaces_between(["0, 1", "0.1, 2.35"])
    (True, False)
    """
    if any(each in line for line in lines for each in _MARKS[:-1]):
        return False
    rows = [line.split() for line in lines if "," in line]
    return not rows or any(len(row) > 1 and all(map(_WITH_COMMA.fullmatch, row)) for row in rows)


def _of_spaces(lines: list[str]) -> list[str]:
    """Lines in columns separated by spaces, with tabs instead.

    Titles contain spaces too, "Time (s)    Force (N)": a line that two or more spaces divide into as many
    cells as a row has numbers is divided there, others at every space.
    """
    narrow = [line.split() for line in lines]
    width = next((len(row) for row in narrow if len(row) > 1 and all(map(is_number, row))), 0)
    wide = [re.split(r"\s{2,}", line.strip()) for line in lines]
    return ["\t".join(w if len(w) == width else n) for w, n in zip(wide, narrow, strict=True)]


def _require_width(rows: list[list[str]], width: int, path: Path) -> None:
    """Check that no number stands beyond the last title: the columns would be mistaken for each other."""
    for k, row in enumerate(rows, 1):
        if any(map(is_number, row[width:])):
            raise MeasurementError(
                f"the row has {len(row)} cells, the header {width}",
                where=f"{path}, row {k} below the header",
                fix="give every column a title; if the comma is the decimal mark, separate the columns with "
                "semicolons or tabs",
            )


def _header_line(
    lines: list[str], marks: Sequence[str], is_header: Callable[[Sequence[str]], bool]
) -> tuple[int, str]:
    """Number (from 0) and separator of the header: the first line with the wanted columns.

    If there is none, the first line above a row of numbers with as many cells (the line before it, where it
    has only units), so that a message can name its columns.
    """
    filled = [k for k, line in enumerate(lines) if line.strip()][:_MOST_ABOVE]
    for k in filled:
        for mark in marks:
            if is_header(_titles(lines[k], mark)):
                return k, mark
    plain = [k for k in filled if not lines[k].startswith("#")]
    for before, k, following in zip([-1, *plain], plain, plain[1:], strict=False):
        for mark in marks:
            titles, below = _titles(lines[k], mark), _titles(lines[following], mark)
            if (
                len(titles) == len(below) > 1
                and all(map(is_number, below))
                and not any(map(is_number, titles))
            ):
                has_titles = before >= 0 and len(_titles(lines[before], mark)) == len(titles)
                return (before if has_titles and all(map(_is_unit, filter(None, titles))) else k), mark
    first = plain[0] if plain else 0
    return first, max(marks, key=lambda mark: lines[first].count(mark) if lines else 0)


def _is_unit(title: str) -> bool:
    return any(is_unit(title.strip("()[]{} "), name) for name in ("time_s", "force_n", "depth_mm"))


def _titles(line: str, mark: str) -> list[str]:
    try:
        return [each.strip() for each in next(csv.reader([line], delimiter=mark), [])]
    except csv.Error:
        return []
