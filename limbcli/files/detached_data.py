"""Data files that belong to a header (`.nhdr`, `.mhd`; `.hdr` of a NIfTI pair) and lie beside it."""

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
    if path.suffix.lower() == ".hdr":
        found = image_of_pair(path)
        return [found] if found else []
    if path.suffix.lower() not in HEADERS or not path.is_file():
        return []
    with path.open("rb") as stream:
        header = stream.read(_LONGEST)
    names = [each.decode("utf-8", "replace") for each in _NAMES.findall(header)]
    return [each for name in names if (each := beside(path, name))]


def image_of_pair(header: Path) -> Path | None:
    """The values (`.img`) of a NIfTI pair, by its header (`.hdr`); None if they are not beside it."""
    return beside(header, header.stem + (".IMG" if header.suffix.isupper() else ".img"))


def beside(header: Path, name: str) -> Path | None:
    """The file of this name in the header's folder; None if there is none, or it lies elsewhere."""
    found = header.parent / name
    try:
        within = found.resolve().is_relative_to(header.parent.resolve())
    except (OSError, RuntimeError, ValueError):
        return None
    return found if within and found.is_file() else None
