"""Whether a surface file holds colours: of points, of faces, or a picture on them. They are not read.

Where each format has them: PLY: a property `red` or `diffuse_red`; OBJ: six numbers beside `v`, or `usemtl`;
STL: two bytes of each triangle, with "COLOR=" in the header (Materialise) or their highest bit set (VisCAM);
OFF: C in its keyword; VTK: COLOR_SCALARS, or arrays of three or four bytes; 3MF: colour and texture groups;
GLB: COLOR_0 or a texture.
"""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np

from limbcli.files.unpacking import DAMAGED

_HEAD = 1 << 20  # bytes that are searched for a declaration
_OF_TEXT = {
    ".ply": re.compile(rb"^property\s+\w+\s+(?:diffuse_)?red\b", re.MULTILINE),
    ".obj": re.compile(rb"^(?:usemtl\s|v(?:\s+[-+.\deE]+){6}\s*$)", re.MULTILINE),
    ".off": re.compile(rb"\A\s*(?:#[^\n]*\n\s*)*(?:ST)?CN?4?OFF\b"),
    ".vtk": re.compile(
        rb"^(?:COLOR_SCALARS\s|SCALARS\s+\S+\s+unsigned_char\s+[34]\b|\S+\s+[34]\s+\d+\s+unsigned_char)",
        re.MULTILINE,
    ),
    ".vtp": re.compile(rb'<DataArray\b(?=[^>]*"UInt8")(?=[^>]*NumberOfComponents="[34]")'),
    ".glb": re.compile(rb'"(?:COLOR_0|baseColorTexture)"'),
    ".3mf": re.compile(rb"<(?:\w+:)?(?:colorgroup|texture2dgroup)\b"),
}
_OF_TEXT[".vtu"] = _OF_TEXT[".vtp"]
_WHOLE = frozenset({".vtk", ".vtp", ".vtu"})  # their arrays of points follow the geometry


def has_colours(path: Path) -> bool:
    """Whether a surface file holds colours; False where it cannot be told.

    Raises OSError if the file cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix == ".stl":
        return _of_stl(path)
    if suffix not in _OF_TEXT:
        return False
    if suffix == ".3mf":
        content = _parts(path)
    else:
        with path.open("rb") as file:
            content = file.read() if suffix in _WHOLE else file.read(_HEAD)
    return _OF_TEXT[suffix].search(content) is not None


def _of_stl(path: Path) -> bool:
    content = path.read_bytes()
    count = int.from_bytes(content[80:84], "little")
    if len(content) != 84 + 50 * count or count == 0:
        return False
    of_faces = np.frombuffer(content, np.dtype([("", "V48"), ("colour", "<u2")]), count, 84)["colour"]
    return b"COLOR=" in content[:80] or bool((of_faces >> 15).any())


def _parts(path: Path) -> bytes:
    try:
        with zipfile.ZipFile(path) as package:
            names = [each for each in package.namelist() if each.endswith(".model")]
            heads = []
            for name in names:
                with package.open(name) as part:
                    heads.append(part.read(_HEAD))
            return b"".join(heads)
    except DAMAGED:
        return b""
