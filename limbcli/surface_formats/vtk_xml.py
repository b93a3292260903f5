"""Read surfaces and their field data from VTK's XML files: PolyData (.vtp) and UnstructuredGrid (.vtu).

Format: VTK File Formats, "XML File Formats"; blocks of compressed data: vtkXMLDataReader of VTK 9.7. Read
here because meshio 5.3 has no PolyData and no LZ4, and ends the process where it finds them.
"""

from __future__ import annotations

import base64
import binascii
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from lxml import etree

from limbcli.files.unpacking import DAMAGED, UnpackingBudget
from limbcli.files.xml import own_text, parsed_xml
from limbcli.model import Array, IntArray
from limbcli.surface_formats.polygons import by_length, from_cells, from_strips

_TYPES = {"Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4", "UInt32": "u4",
          "Int64": "i8", "UInt64": "u8", "Float32": "f4", "Float64": "f8", "String": "u1"}  # fmt: skip
_APPENDED = b"<AppendedData"
_LARGEST = 1 << 33  # bytes, largest size of an array
_DAMAGED = (*DAMAGED, IndexError, TypeError, binascii.Error)


def read_vtk_xml(path: Path) -> tuple[Array, list[IntArray]]:
    """Points (n, 3) as in the file, all pieces together, and the polygons by their number of corners.

    Raises OSError if it is not such a file, holds another data set or no surface, or is damaged.
    """
    try:
        return _surface(_open(path))
    except _DAMAGED as error:
        raise OSError(f"it is not a VTK XML file, or damaged ({error})") from error


def field_text(path: Path, name: str) -> str:
    """The text array `name` of the field data; "" if there is none.

    Raises OSError if the file or this array cannot be decoded.
    """
    try:
        file = _open(path)
        found = file.root.find(f".//FieldData/*[@Name='{name}']")
        return "" if found is None else bytes(file.array(found)).split(b"\0")[0].decode("ascii")
    except _DAMAGED as error:
        raise OSError(f"its {name} cannot be decoded ({error})") from error


def _surface(file: _File) -> tuple[Array, list[IntArray]]:
    kind = file.root.get("type", "")
    if kind not in ("PolyData", "UnstructuredGrid"):
        raise OSError(f"its data set is {kind or 'not named'}, which is no surface")
    points: list[Array] = [np.zeros((0, 3))]
    faces: list[IntArray] = []
    for piece in file.root.iterfind(f"{kind}/Piece"):
        found = piece.find("Points/DataArray")
        n_before = sum(map(len, points))
        if found is not None:
            points.append(file.array(found).astype(np.float64).reshape(-1, 3))
        if kind == "PolyData":
            own = by_length(*file.cells(piece, "Polys")) + from_strips(*file.cells(piece, "Strips"))
        else:
            types = piece.find("Cells/DataArray[@Name='types']")
            if types is None:
                raise OSError("the types of its cells are missing")
            own = from_cells(*file.cells(piece, "Cells"), file.array(types).astype(np.int64))
        if any(len(each) and not 0 <= each.min() <= each.max() < len(points[-1]) for each in own):
            raise OSError(f"a polygon refers to a point that does not exist (of {len(points[-1])})")
        faces += [each + n_before for each in own]
    return np.concatenate(points), faces


@dataclass(frozen=True)
class _File:
    """root : the XML without appended data; appended : these, decoded by array; order : "<" or ">"."""

    root: etree._Element
    appended: bytes
    is_base64: bool
    order: str
    packer: str
    budget: UnpackingBudget = field(default_factory=UnpackingBudget)

    @property
    def header(self) -> np.dtype[np.unsignedinteger]:
        """The type of the numbers before an array's bytes."""
        return np.dtype(self.order + ("u8" if self.root.get("header_type") == "UInt64" else "u4"))

    def cells(self, piece: etree._Element, name: str) -> tuple[IntArray, IntArray]:
        """Corners of all cells and the end of each; empty where the piece has none."""
        found = {each.get("Name"): each for each in piece.iterfind(f"{name}/DataArray")}
        if not found:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        corners, ends = (self.array(found[each]).astype(np.int64) for each in ("connectivity", "offsets"))
        return corners, ends

    def array(self, element: etree._Element) -> Array | IntArray:
        """The values (n,) of a DataArray in any of the encodings."""
        form = np.dtype(self.order + _TYPES[element.get("type", "")])
        text = own_text(element).strip().encode("latin-1")
        if element.get("format") == "ascii":
            return np.array(text.split(), np.float64 if form.kind == "f" else np.int64).astype(form)
        if element.get("format") == "appended":
            return np.frombuffer(
                self._bytes(self.appended, int(element.get("offset", "0")), self.is_base64), form
            )
        return np.frombuffer(self._bytes(text, 0, True), form)

    def _bytes(self, data: bytes, at: int, is_base64: bool) -> bytes:
        """The bytes of the array that begins at byte `at` of encoded data."""
        if not self.packer:
            (size,), body = self._head(data, at, 1, is_base64)
            return _checked(body(size), size)
        (n_blocks,), _ = self._head(data, at, 1, is_base64)
        if n_blocks == 0:
            return b""
        (_, full, last, *packed), body = self._head(data, at, 3 + n_blocks, is_base64, is_apart=True)
        content, found, begin = body(sum(packed)), [], 0
        for k, n_packed in enumerate(packed):
            size = last if k == n_blocks - 1 and last else full
            found.append(self._unpacked(content[begin : begin + n_packed], size))
            begin += n_packed
        return b"".join(found)

    def _unpacked(self, block: bytes, size: int) -> bytes:
        if "ZLib" in self.packer or "LZMA" in self.packer:
            return _checked(self.budget.inflate(block, size, is_lzma="LZMA" in self.packer), size)
        if "LZ4" in self.packer:
            self.budget.spend(size)
            return unpacked_lz4(block, size)
        raise ValueError(f"its compressor {self.packer!r} is not known")

    def _head(self, data: bytes, at: int, count: int, is_base64: bool, *, is_apart: bool = False):  # type: ignore[no-untyped-def]
        """The numbers before the bytes of an array, and a function that gives so many bytes behind them.

        is_apart : whether in base64 they are coded apart from the bytes
        """
        n_head = count * self.header.itemsize
        if not 0 < n_head <= len(data):
            raise ValueError("the number of its blocks is too large")
        if not is_base64:
            head = data[at : at + n_head]
            return _numbers(head, self.header), lambda size: data[at + n_head : at + n_head + size]
        end = at + 4 * -(-n_head // 3)
        coded = data[at:end]
        numbers = _numbers(base64.b64decode(coded)[:n_head], self.header)
        if is_apart or coded.endswith(b"="):
            return numbers, lambda size: base64.b64decode(data[end : end + 4 * -(-size // 3)])[:size]
        return numbers, lambda size: base64.b64decode(data[at : at + 4 * -(-(n_head + size) // 3)])[
            n_head : n_head + size
        ]


def _numbers(head: bytes, form: np.dtype[np.unsignedinteger]) -> list[int]:
    found = [int(each) for each in np.frombuffer(head, form)]
    if not found or max(found) > _LARGEST:
        raise ValueError("the size of an array is missing, or too large")
    return found


def _checked(content: bytes, size: int) -> bytes:
    if len(content) != size:
        raise ValueError(f"an array has {len(content)} bytes instead of {size}")
    return content


def _open(path: Path) -> _File:
    content = path.read_bytes()
    begin = content.find(_APPENDED)
    text, appended, is_base64 = content, b"", True
    if begin >= 0:
        tag_end = content.index(b">", begin)
        is_base64 = b"base64" in content[begin:tag_end]
        text = content[:begin] + b"</VTKFile>"
        appended = content[content.index(b"_", tag_end) + 1 :]
    root = parsed_xml(text)
    if root.tag != "VTKFile":
        raise ValueError(f"its root is {root.tag}")
    order = "<" if root.get("byte_order", "LittleEndian") == "LittleEndian" else ">"
    return _File(root, appended, is_base64, order, root.get("compressor", ""))


def unpacked_lz4(block: bytes, size: int) -> bytes:
    """The `size` bytes of a block of LZ4; a compiled package for it nothing else here needs.

    Format: LZ4 Block Format Description (github.com/lz4/lz4, doc/lz4_Block_format.md).

    Raises ValueError if it is damaged.

    >>> unpacked_lz4(b"\\x23ab\\x02\\x00\\x10c", 10)
    b'ababababac'
    """
    found, at = bytearray(), 0
    while at < len(block):
        token = block[at]
        n_plain, at = _length(block, at + 1, token >> 4)
        found += block[at : at + n_plain]
        at += n_plain
        if at >= len(block):
            break
        back = int.from_bytes(block[at : at + 2], "little")
        n_copied, at = _length(block, at + 2, token & 15)
        start = len(found) - back
        if back == 0 or start < 0 or len(found) + n_copied + 4 > size:
            raise ValueError("an LZ4 block is damaged")
        piece = bytes(found[start : start + n_copied + 4])
        found += (piece * (-(-(n_copied + 4) // len(piece))))[: n_copied + 4]
    if len(found) != size:
        raise ValueError(f"an LZ4 block has {len(found)} bytes instead of {size}")
    return bytes(found)


def _length(block: bytes, at: int, nibble: int) -> tuple[int, int]:
    """A length that begins in four bits of the token, and the place behind it."""
    length = nibble
    while nibble == 15:
        more = block[at] if at < len(block) else 0
        length, at = length + more, at + 1
        if more != 255:
            break
    return length, at
