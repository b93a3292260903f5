"""Text of files and people as it may leave the program: to a terminal, and to tables for spreadsheets.

Names of people, columns and files are the user's, or whoever's the file was. A terminal must not obey control
characters in them, and a spreadsheet must not take a cell for a formula.
"""

from __future__ import annotations

import csv
import unicodedata
from collections.abc import Iterable
from pathlib import Path

_FORMULA = "=+-@"  # beginnings that spreadsheets take for a formula (OWASP, CSV injection)
# marks that reverse the direction of what follows (Unicode 15, UAX 9)
_TURNING = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


def shown(text: object) -> str:
    """The text with its control characters written as escapes; line ends and tabs stay.

    >>> shown("P1\\x1b[2J\\x07"), shown("a\\nb\\tc"), shown("caf\\u00e9 5 \\u00b0")
    ('P1\\\\x1b[2J\\\\x07', 'a\\nb\\tc', 'caf\u00e9 5 \u00b0')
    """
    return "".join(_escaped(each) if _is_control(each) else each for each in str(text))


def _is_control(letter: str) -> bool:
    return letter in _TURNING or (unicodedata.category(letter) in ("Cc", "Zl", "Zp") and letter not in "\n\t")


def _escaped(letter: str) -> str:
    return letter.encode("unicode_escape").decode("ascii")


def text_cell(value: object) -> object:
    """A cell of a table for spreadsheets: text that would be a formula begins with an apostrophe.

    Numbers stay as they are, those with a sign too; control characters are written as escapes.

    >>> text_cell("=1+1"), text_cell("-P1"), text_cell("\\t=1"), text_cell("P1")
    ("'=1+1", "'-P1", "'\\\\t=1", 'P1')
    >>> text_cell("-1.5"), text_cell(-1.5), text_cell("+2e3"), text_cell(None)
    ('-1.5', -1.5, '+2e3', None)
    """
    if not isinstance(value, str) or not value or _is_number(value):
        return value
    if value.isascii() and value.isprintable():
        return f"'{value}" if value[0] in _FORMULA else value
    plain = "".join(_escaped(each) if each in "\r\n\t" or _is_control(each) else each for each in value)
    return f"'{plain}" if value[0] in _FORMULA or _is_control(value[0]) or value[0] in "\n\t" else plain


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text == text.strip()


def write_rows(path: Path, header: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """Write a table for spreadsheets as CSV, its cells as `text_cell` has them."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(header)
        table.writerows([text_cell(each) for each in row] for row in rows)
