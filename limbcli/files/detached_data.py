"""Data files that belong to a header of a few lines (`.nhdr`, `.mhd`) and lie beside it."""

from __future__ import annotations

import re
from pathlib import Path

HEADERS = (".nhdr", ".mhd")
_NAMES = re.compile(rb"^\s*(?:data ?file\s*:|ElementDataFile\s*=)\s*(.+?)\s*$", re.IGNORECASE | re.MULTILINE)
_LONGEST = 65536  # bytes of a header


def detached_data(path: Path) -> list[Path]:
    """The data files that a header names, if they exist in its folder; none for any other file.

    Files elsewhere are never returned: a header may come from somebody else.
    """
    if path.suffix.lower() not in HEADERS or not path.is_file():
        return []
    with path.open("rb") as stream:
        header = stream.read(_LONGEST)
    return [
        found for each in _NAMES.findall(header) if (found := beside(path, each.decode("utf-8", "replace")))
    ]


def beside(header: Path, name: str) -> Path | None:
    """The file of this name in the header's folder; None if there is none, or it lies elsewhere."""
    found = header.parent / name
    try:
        within = found.resolve().is_relative_to(header.parent.resolve())
    except (OSError, RuntimeError, ValueError):
        return None
    return found if within and found.is_file() else None
