"""STL surfaces, binary and text.

Text files are read by their keywords alone, whatever their indentation, case and names; meshio rejects some
that are valid, such as those of trimesh. Format: paulbourke.net/dataformats/stl.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from limbcli.numbers.distinct_rows import distinct_rows

_HEAD, _FACET = 84, 50  # bytes of the header with the number of facets, and of a facet
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
_LOOP = re.compile(rb"\bendloop\b", re.IGNORECASE)


def read_stl(path: Path) -> tuple[NDArray[np.float64], list[NDArray[np.int64]]]:
    """Points (n, 3), each once, and triangles [(m, 3)].

    Raises OSError or ValueError if it ends early, or a facet is no triangle or no numbers.
    """
    content = path.read_bytes()
    told = int(np.frombuffer(content, "<u4", 1, _HEAD - 4)[0]) if len(content) >= _HEAD else 0
    is_exact = len(content) >= _HEAD and len(content) == _HEAD + _FACET * told
    is_text = content.lstrip()[:5].lower() == b"solid" and _LOOP.search(content) is not None
    corners = _of_text(content) if is_text and not is_exact else _of_binary(content, told)
    first, number = distinct_rows(corners)
    return corners[first], [number.reshape(-1, 3)]


def _of_text(content: bytes) -> NDArray[np.float64]:
    facets = content[content.find(b"\n") + 1 :]  # the name of the solid may be any words
    found = _VERTEX.findall(facets)
    if len(found) != 3 * len(_LOOP.findall(facets)):
        raise OSError("it ends early, or has facets of other than three corners")
    return np.array(found, dtype=np.float64).reshape(-1, 3)


def _of_binary(content: bytes, told: int) -> NDArray[np.float64]:
    if len(content) < _HEAD:
        raise OSError("it is neither text nor binary STL")
    if len(content) < _HEAD + _FACET * told:
        raise OSError(f"it ends before all {told} triangles that its header tells of")
    facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    rows = np.frombuffer(content, facet, told, _HEAD)
    return rows["corners"].reshape(-1, 3).astype(np.float64)
