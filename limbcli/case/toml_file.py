"""Read a TOML file of the user, so that nothing in it can break what reads its values later."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

_MOST_NESTED = 20  # tables and lists within each other
_LARGEST = 2**63  # TOML 1.0: integers of 64 bits


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file, with or without a byte-order mark.

    Raises ValueError if it is not UTF-8 text (UnicodeDecodeError) or not valid TOML, holds an integer of more
    than 64 bits, or nests tables and lists too deeply.
    """
    text = path.read_text(encoding="utf-8-sig")
    try:
        content = tomllib.loads(text)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    level: list[Any] = [content]
    for _ in range(_MOST_NESTED):
        level = [inner for each in level for inner in _inside(each)]
        if any(isinstance(each, int) and not -_LARGEST <= each < _LARGEST for each in level):
            raise ValueError("an integer has more than 64 bits")
    if level:
        raise ValueError(_TOO_DEEP)
    return content


def toml_fix(path: Path, error: ValueError) -> str:
    """What to do about a file that `read_toml` cannot read, with the line that its error names."""
    found = re.search(r"\(at line (\d+),", str(error))
    if found is None:
        return "correct that line"
    line = path.read_text(encoding="utf-8-sig").split("\n")[int(found[1]) - 1].strip()
    hint = next((words for pattern, words in _MISTAKES if re.search(pattern, line)), "")
    return f"correct that line, `{line[:_SHOWN]}`{hint}"


_SHOWN = 80  # characters of a line
_MISTAKES = (
    (r"=\s*[-+]?\d+,\d", ": write a decimal point"),
    (r"[\u201c-\u201f\u2018\u2019]", ': write straight quotes, "..."'),
    (r"\\", ": write the path with /"),
    (r"=\s*[^\W\d_]", ': write text between quotes, "..."'),
)  # what is common, by its pattern
_TOO_DEEP = f"lists and tables are nested more than {_MOST_NESTED} deep"


def _inside(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return list(value.values())
    return value if isinstance(value, list) else []
