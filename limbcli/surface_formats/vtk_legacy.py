"""Read surfaces from legacy VTK files (.vtk): POLYDATA and UNSTRUCTURED_GRID, as text or binary.

Format: VTK File Formats, "Simple Legacy Formats", versions 2.0 to 5.1 (vtkDataReader of VTK 9.7). Read here
because meshio 5.3 has no POLYDATA, and stops at normals. What stands beside the geometry is left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limbcli.model import Array, IntArray
from limbcli.surface_formats.polygons import by_length, from_cells, from_strips

_TYPES = {
    "unsigned_char": "u1", "char": "i1", "unsigned_short": "u2", "short": "i2", "unsigned_int": "u4",
    "int": "i4", "unsigned_long": "u8", "long": "i8", "float": "f4", "double": "f8", "vtkidtype": "i4",
    "vtktypeint64": "i8", "vtktypeuint64": "u8",
}  # fmt: skip
_DATA_SETS = ("POLYDATA", "UNSTRUCTURED_GRID")
_CELLS = ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS", "CELLS")
_ATTRIBUTES = ("POINT_DATA", "CELL_DATA")  # all that follows belongs to points and cells
_ENDS_EARLY = "it ends before all that its header tells of"


def read_vtk(path: Path) -> tuple[Array, list[IntArray]]:
    """Points (n, 3) as in the file, and its polygons by their number of corners.

    Raises OSError if it is not a legacy VTK file, holds another data set than a surface, or is damaged.
    """
    file = _open(path.read_bytes())
    points, kind = np.zeros((0, 3)), ""
    cells: dict[str, tuple[IntArray, IntArray]] = {}
    types = np.zeros(0, np.int64)
    while (line := file.line()) is not None:
        words = line.split()
        name = words[0].upper() if words else ""
        if name in _ATTRIBUTES:
            break
        if name == "DATASET":
            kind = words[1].upper()
            if kind not in _DATA_SETS:
                raise OSError(f"its data set is {kind}, which is no surface")
        elif name == "POINTS":
            points = file.numbers(3 * int(words[1]), words[2]).reshape(-1, 3).astype(np.float64)
        elif name in _CELLS:
            cells[name] = file.cells(int(words[1]), int(words[2]))
        elif name == "CELL_TYPES":
            types = file.numbers(int(words[1]), "int").astype(np.int64)
        elif name == "FIELD":
            file.skip_field(int(words[2]))
        elif name == "METADATA":
            while file.line():
                pass
    if kind == "UNSTRUCTURED_GRID" and "CELLS" in cells:
        return points, from_cells(*cells["CELLS"], types)
    polygons = by_length(*cells["POLYGONS"]) if "POLYGONS" in cells else []
    return points, polygons + (from_strips(*cells["TRIANGLE_STRIPS"]) if "TRIANGLE_STRIPS" in cells else [])


def _open(content: bytes) -> _File:
    file = _File(content)
    first, _title, form = (file.line() for _ in range(3))
    if first is None or not first.startswith("# vtk DataFile Version") or form is None:
        raise OSError("it does not begin like a legacy VTK file")
    file.is_binary = form.strip().upper() == "BINARY"
    file.is_offsets = float(first.split()[-1]) >= 5.0
    return file


@dataclass
class _File:
    """The file's content, read from byte `at` on."""

    content: bytes
    at: int = 0
    is_binary: bool = False
    is_offsets: bool = False  # cells as ends and corners (version 5) instead of number and corners

    def line(self) -> str | None:
        """The next line without its end; None at the end of the file."""
        if self.at >= len(self.content):
            return None
        end = self.content.find(b"\n", self.at)
        end = len(self.content) if end < 0 else end
        found = self.content[self.at : end]
        self.at = end + 1
        return found.decode("latin-1").strip()

    def numbers(self, count: int, kind: str) -> NDArray[Any]:
        if count < 0:
            raise OSError("a number of values is negative")
        if not self.is_binary:
            words = self.content[self.at :].split(None, count)
            rest = words.pop() if len(words) > count else b""
            if len(words) < count:
                raise OSError(_ENDS_EARLY)
            self.at = len(self.content) - len(rest)
            return np.array(words, np.float64 if kind.lower() in ("float", "double") else np.int64)
        if kind.lower() not in _TYPES:
            raise OSError(f"it has numbers of an unknown type ({kind})")
        form = np.dtype(">" + _TYPES[kind.lower()])
        if self.at + count * form.itemsize > len(self.content):
            raise OSError(_ENDS_EARLY)
        found = np.frombuffer(self.content, form, count, self.at)
        self.at += count * form.itemsize
        self._end_of_line()
        return found

    def _end_of_line(self) -> None:
        if self.content[self.at : self.at + 2] == b"\r\n":
            self.at += 2
        elif self.content[self.at : self.at + 1] == b"\n":
            self.at += 1

    def cells(self, first: int, second: int) -> tuple[IntArray, IntArray]:
        """Corners of all cells and the end of each; first, second : the two numbers beside their name."""
        if self.is_offsets:
            if first < 1:
                return np.zeros(0, np.int64), np.zeros(0, np.int64)
            ends = self.numbers(first, self._kind("OFFSETS"))[1:]
            return self.numbers(second, self._kind("CONNECTIVITY")).astype(np.int64), ends.astype(np.int64)
        flat = self.numbers(second, "int").astype(np.int64)
        at, heads = 0, np.zeros(first, np.int64)
        for k in range(first):
            if at >= len(flat) or flat[at] < 0:
                raise OSError("the corners of a cell are missing")
            heads[k] = at
            at += 1 + int(flat[at])
        is_corner = np.ones(len(flat), bool)
        is_corner[heads] = False
        return flat[is_corner], np.cumsum(flat[heads])

    def _kind(self, name: str) -> str:
        words = (self.line() or "").split()
        if len(words) != 2 or words[0] != name:
            raise OSError(f"{name} of its cells is missing")
        return words[1]

    def skip_field(self, n_arrays: int) -> None:
        for _ in range(n_arrays):
            words: list[str] = []
            while not words:
                line = self.line()
                if line is None:
                    raise OSError(_ENDS_EARLY)
                words = line.split()
                if words[:1] == ["METADATA"]:
                    while self.line():
                        pass
                    words = []
            _name, n_components, n_rows, kind = words[-4:]
            count = int(n_components) * int(n_rows)
            if kind == "string":
                for _ in range(count):
                    self._skip_string()
            elif kind == "bit":
                self.numbers(-(-count // 8) if self.is_binary else count, "unsigned_char")
            else:
                self.numbers(count, kind)

    def _skip_string(self) -> None:
        """A line of text, or in a binary file a length of 1, 2, 4 or 8 bytes by its two highest bits."""
        if not self.is_binary:
            self.line()
            return
        head = self.content[self.at : self.at + 1] or b"\0"
        size = {3: 1, 2: 2, 1: 4, 0: 8}[head[0] >> 6]
        length = int.from_bytes(self.content[self.at : self.at + size], "big") & ((1 << (8 * size - 2)) - 1)
        self.at += size + length
        self._end_of_line()
