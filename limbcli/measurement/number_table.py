"""Strict reading of a CSV of numbers: every wrong cell and column is reported with its location."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection, Mapping, Set
from dataclasses import dataclass
from math import isfinite, isnan
from pathlib import Path

import numpy as np

from limbcli.errors.problems import Problem, errors_of, suggestion
from limbcli.model import Array

_SHOWN_PER_FILE = 8
# Unit suffixes of column names; a longer suffix comes before one that it ends in.
_UNITS = {"_mpa_per_mm": "MPa/mm", "_m_per_s": "m/s", "_mm": "mm", "_n": "N", "_s": "s"}
SEPARATOR_LINE = re.compile(r"^\ufeff?sep=(.)\r?$", re.IGNORECASE)  # for spreadsheets, above a header
_BINARY = {
    b"PK\x03\x04": "an Excel workbook, or another archive", b"\xd0\xcf\x11\xe0": "an old Excel workbook",
    b"TDSh": "the index of a TDMS file beside it", b"\x89HDF": "an HDF5 file", b"MATLAB": "a MATLAB file",
    b"\x02P": "a C3D file",
    b"\x1f\x8b": "compressed", b"\x89PNG": "a picture", b"%PDF": "a PDF",
}  # fmt: skip
_LONGEST_CELL = 40  # characters of a cell that are shown
# the line is kept, empty, so that line numbers stay correct
_COMMENT = re.compile(r"^[ \t]*#[^\r\n]*", re.MULTILINE)


@dataclass(frozen=True, eq=False)
class RawTable:
    """Columns by name: numbers (NaN where empty) and texts; `lines` are the line numbers in the file."""

    numbers: Mapping[str, Array]
    texts: Mapping[str, list[str]]
    lines: list[int]

    def __len__(self) -> int:
        return len(self.lines)


def read_table(
    path: Path, *, required: Collection[str], optional: Collection[str], texts: Collection[str] = (),
    may_be_empty: bool = False, may_be_nan: Collection[str] = (),
) -> tuple[RawTable | None, list[Problem]]:  # fmt: skip
    """Read a table with a header line; lines that begin with # are comments.

    Columns are separated by commas; or, as spreadsheets of many countries write it, by semicolons or tabs,
    with decimal points or commas.

    required, optional : names of numeric columns; texts : names of text columns (optional)
    may_be_empty : whether a header alone is accepted, as a table without rows
    may_be_nan : required columns in which NaN says that nothing was read

    Returns the table, or None if it cannot be read at all, and every problem.
    """
    known = {*required, *optional, *texts}
    content, separator, problems = _content(path, known)
    if content is None:
        return None, problems
    rows, problems = csv_rows(content, path, separator=separator)
    if rows is None:
        return None, problems
    numbered = [(k, row) for k, row in enumerate(rows, 1) if any(cell.strip() for cell in row)]
    if not numbered:
        return None, [problem("the file is empty", path, f"write the header {','.join(required)} and rows")]
    width = max(j for _, row in numbered for j, cell in enumerate(row, 1) if cell.strip())
    # spreadsheets leave empty cells beyond the header
    numbered = [(line, row[:width]) for line, row in numbered]
    header = [cell.strip() for cell in numbered[0][1]]
    problems += _check_header(header, path, required=required, known=known)
    if errors_of(problems):
        return None, problems
    body = numbered[1:]
    if not body and not may_be_empty:
        fix = "add the measured rows; if it is a levels.csv that `limbcli measure CASE --write` will create, "
        return None, [problem("the table has a header but no rows", path, f"{fix}remove the file")]
    cells, found = _check_width(body, len(header), path)
    problems += found
    if separator != ",":
        cells = _with_points(cells, [j for j, name in enumerate(header) if name not in texts])
    numbers: dict[str, Array] = {}
    found = []
    for j, name in enumerate(header):
        if name in texts:
            continue
        numbers[name], wrong = _numbers(
            cells, j, name, path, may_be_empty=name not in required, may_be_nan=name in may_be_nan
        )
        found += wrong
    if len(found) > _SHOWN_PER_FILE:
        more = len(found) - _SHOWN_PER_FILE
        found = [
            *found[:_SHOWN_PER_FILE],
            problem(f"and {more} more cells like these", path, "correct them all"),
        ]
    columns = {name: [row[j].strip() for _, row in cells] for j, name in enumerate(header) if name in texts}
    return RawTable(numbers, columns, [line for line, _ in cells]), problems + found


def header_of(path: Path, known: Set[str]) -> list[str]:
    """The names in the header line of a table; none if it cannot be read, which `read_table` reports.

    known : names that may be there; they show the mark between the columns
    """
    content, separator, _ = _content(path, known)
    line = next((each for each in (content or "").splitlines() if each.strip()), "")
    rows, _ = csv_rows(line, path, separator=separator)
    return [cell.strip() for cell in rows[0]] if rows else []


def problem(what: str, path: Path, fix: str, *, line: int | None = None, warning: bool = False) -> Problem:
    """An error or a warning about a file, at a line."""
    where = f"{path}, line {line}" if line else str(path)
    return Problem(what, where, fix, severity="warning" if warning else "error", family="measurement")


def csv_rows(
    content: str, path: Path, *, separator: str = ","
) -> tuple[list[list[str]] | None, list[Problem]]:
    """The cells of a CSV text, or None and what is wrong with it."""
    rows: list[list[str]] = []
    reader = csv.reader(io.StringIO(content), delimiter=separator)
    begin = 1
    try:
        for row in reader:
            rows.append(row)
            begin = reader.line_num + 1
    except csv.Error as error:
        fix = "close or remove the quotation mark that opens there; numbers need none"
        return None, [problem(f"the row that begins here cannot be read ({error})", path, fix, line=begin)]
    return rows, []


def number_of(cell: str) -> float:
    """The number in a cell; "1_0", which Python reads as ten, is not accepted.

    Raises ValueError if it is not a number.

    >>> number_of("1e-1")
    0.1
    """
    if "_" in cell:
        raise ValueError(cell)
    return float(cell)


def binary_kind(content: bytes) -> str | None:
    """What a binary file is that is mistaken for a table, by its first bytes; None if they tell nothing.

    >>> binary_kind(b"PK\\x03\\x04..."), binary_kind(b"force_n,depth_mm")
    ('an Excel workbook, or another archive', None)
    """
    return next((words for magic, words in _BINARY.items() if content.startswith(magic)), None)


def shown(cell: str) -> str:
    """A cell in quotes, as a message shows it; only the beginning of a long one.

    >>> shown("1_0")
    "'1_0'"
    """
    return repr(cell if len(cell) <= _LONGEST_CELL else f"{cell[:_LONGEST_CELL]}...")


def _read_text(path: Path) -> tuple[str | None, list[Problem]]:
    try:
        content = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        kind = binary_kind(path.read_bytes())
        what = "the file is not UTF-8 text" + (f" but {kind}" if kind else "")
        return None, [problem(what, path, "save it as CSV in UTF-8")]
    except FileNotFoundError:
        fix = "put it there; `limbcli measure CASE --write` creates levels.csv from the instruments' files"
        return None, [problem("the file was not found", path, fix)]
    except OSError as error:
        return None, [
            problem(f"the file cannot be read ({error.strerror})", path, "check its name and permissions")
        ]
    if "\0" in content:
        return None, [problem("the file is binary, not CSV", path, "export it as comma-separated text")]
    return content, []


def _content(path: Path, known: Set[str]) -> tuple[str | None, str, list[Problem]]:
    """The text of a table without its comments, and the mark between its columns."""
    content, problems = _read_text(path)
    if content is None:
        return None, ",", problems
    first, _, rest = content.partition("\n")
    named = SEPARATOR_LINE.match(first)
    content = _COMMENT.sub("", "\n" + rest if named else content)
    return content, named[1] if named else _separator(content, known), problems


def _separator(content: str, known: Set[str]) -> str:
    """The mark between the columns: a comma unless semicolons or tabs show names that are known."""
    header = next((line for line in content.splitlines() if line.strip()), "")
    for mark in ",;\t":
        if known & {each.strip(' "') for each in header.split(mark)}:
            return mark
    return ","


def _with_points(cells: list[tuple[int, list[str]]], columns: list[int]) -> list[tuple[int, list[str]]]:
    """The rows with decimal points for commas, unless there are points too: marks are never mixed."""
    if any("." in row[j] for _, row in cells for j in columns):
        return cells
    return [
        (line, [cell.replace(",", ".") if j in columns else cell for j, cell in enumerate(row)])
        for line, row in cells
    ]


def _check_header(
    header: list[str], path: Path, *, required: Collection[str], known: Set[str]
) -> list[Problem]:
    if not known & set(header) and not any(header[1:]):
        what = f"the first line, {shown(header[0])}, is not a header"
        fix = f"begin the file with the names of its columns: {','.join(required)}"
        return [problem(what, path, fix, line=1)]
    problems = []
    for name in header:
        if name not in known:
            what = f"unknown column {shown(name)}" if name else "a column without a name"
            problems.append(problem(what, path, suggestion(name, known), line=1))
    for name in sorted({each for each in header if header.count(each) > 1}):
        problems.append(problem(f"column {name!r} appears twice", path, "keep one of them", line=1))
    for name in required:
        if name not in header:
            unit = next((each for end, each in _UNITS.items() if name.endswith(end)), None)
            fix = "add it" if unit is None else f"add it; its name includes the unit ({unit})"
            problems.append(problem(f"column {name!r} is missing", path, fix, line=1))
    return problems


def _check_width(
    body: list[tuple[int, list[str]]], width: int, path: Path
) -> tuple[list[tuple[int, list[str]]], list[Problem]]:
    good, problems = [], []
    for line, row in body:
        if len(row) == width:
            good.append((line, row))
            continue
        fix = "give one cell per column; write decimals with a point, not a comma"
        what = f"the row has {len(row)} cells, the header {width}"
        problems.append(problem(what, path, fix, line=line))
    return good, problems[:_SHOWN_PER_FILE]


def _numbers(
    cells: list[tuple[int, list[str]]],
    column: int,
    name: str,
    path: Path,
    *,
    may_be_empty: bool,
    may_be_nan: bool,
) -> tuple[Array, list[Problem]]:
    values = np.full(len(cells), np.nan)
    problems = []
    for k, (line, row) in enumerate(cells):
        cell = row[column].strip()
        if not cell and may_be_empty:
            continue
        try:
            values[k] = value = number_of(cell)
        except ValueError:
            what = f"{name} is {shown(cell)}, not a number" if cell else f"{name} is empty"
            fix = "write a number with a decimal point, without its unit"
            fix += "; leave the cell empty where there is none" * may_be_empty
            problems.append(problem(what, path, fix, line=line))
            continue
        if not isfinite(value) and not (may_be_nan and isnan(value)):
            fix = "leave the cell empty" if may_be_empty else "remove the row, or measure it again"
            problems.append(problem(f"{name} is {cell}", path, fix, line=line))
    return values, problems
