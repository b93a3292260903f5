"""Read triangle surfaces of scanners, CAD and visualisation programs: PLY, OBJ, STL, VTK and others.

PLY: paulbourke.net/dataformats/ply; OBJ: paulbourke.net/dataformats/obj. Colours, normals and texture
coordinates in such files are ignored. PLY and OBJ are read here because meshio rejects many files of
scanners and pymeshlab silently drops quadrilaterals beside triangles.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limbcli.surface_formats.aop import read_aop
from limbcli.surface_formats.glb import read_glb
from limbcli.surface_formats.off import read_off
from limbcli.surface_formats.polygons import triangles_of
from limbcli.surface_formats.stated_frame import stated_frame
from limbcli.surface_formats.stl import read_stl
from limbcli.surface_formats.three_mf import read_3mf
from limbcli.surface_formats.vtk_legacy import read_vtk
from limbcli.surface_formats.vtk_xml import read_vtk_xml

SUFFIXES = (".ply", ".stl", ".obj", ".glb", ".3mf", ".off", ".vtk", ".vtp", ".vtu", ".aop")

_Points = NDArray[np.float64]
_Faces = NDArray[np.int64]
_HEAD = 20_000  # largest size of a PLY header, bytes
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "<"}
_NUMBERS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8", "int64": "i8", "uint64": "u8",
}  # fmt: skip
_CORNERS = ("vertex_indices", "vertex_index")
_SIDES = ("triangle", "quad")


def read_triangles(path: Path) -> tuple[_Points, _Faces]:
    """Points (n, 3) in patient LPS, mm, as the file states its frame and unit, and triangles (m, 3).

    Other polygons are split into triangles. m is 0 if the file contains only other cells; coordinates may be
    NaN, which the caller must check.

    Raises OSError if the file cannot be read, however it is corrupt, or refers to points that do not exist;
    CaseError if the frame or the unit that it states is not known, or contradicts another in it.
    """
    read = {
        ".ply": _ply, ".obj": _obj, ".stl": read_stl, ".3mf": read_3mf, ".off": read_off, ".vtk": read_vtk,
        ".vtp": read_vtk_xml, ".vtu": read_vtk_xml, ".aop": read_aop, ".glb": read_glb,
    }.get(path.suffix.lower(), _by_meshio)  # fmt: skip
    try:
        with np.errstate(all="ignore"):  # meshio computes sizes that may overflow
            points, polygons = read(path)
    except SystemExit as error:
        raise OSError("it is damaged, or of a kind that is not read") from error
    except Exception as error:
        raise OSError(str(error) or type(error).__name__) from error
    if points.ndim != 2 or points.shape[1] < 3:
        raise OSError("its points do not have three coordinates")
    if any(each.ndim != 2 for each in polygons):
        raise OSError("its faces are not lists of corners")
    polygons = [each for each in polygons if each.size and each.shape[1] > 2]
    if any(not 0 <= each.min() <= each.max() < len(points) for each in polygons):
        raise OSError(f"a triangle refers to a point that does not exist (of {len(points)})")
    points = points[:, :3]
    faces = np.concatenate([np.zeros((0, 3), np.int64), *(triangles_of(points, each) for each in polygons)])
    return stated_frame(path).to_lps(points, faces)


def _by_meshio(path: Path) -> tuple[_Points, list[_Faces]]:
    import meshio

    mesh = meshio.read(path)
    is_face = [each.type in _SIDES or each.type.startswith("polygon") for each in mesh.cells]
    blocks = [each for each, face in zip(mesh.cells, is_face, strict=True) if face]
    return np.asarray(mesh.points, np.float64), [np.asarray(each.data, np.int64) for each in blocks]


# ---------------------------------------------------------------- OBJ


def _obj(path: Path) -> tuple[_Points, list[_Faces]]:
    """Parse lines `v x y z` and `f corner corner corner`.

    A corner is point/texture/normal, counted from 1 or, if negative, backwards from the last point.
    """
    points: list[list[float]] = []
    polygons: dict[int, list[list[int]]] = {}
    text = path.read_text(encoding="utf-8", errors="replace")
    for line in text.replace("\\\n", " ").splitlines():  # a backslash continues a line
        kind, *words = line.split("#")[0].split() or [""]
        if kind == "v":
            points.append([float(each) for each in words[:3]])
        elif kind == "f" and len(words) > 2:
            numbers = [int(each.partition("/")[0]) for each in words]
            corners = [each + len(points) if each < 0 else each - 1 for each in numbers]
            polygons.setdefault(len(corners), []).append(corners)
    faces = [np.array(each, np.int64) for each in polygons.values()]
    return np.array(points or np.zeros((0, 3)), np.float64), faces


# ---------------------------------------------------------------- PLY


def _ply(path: Path) -> tuple[_Points, list[_Faces]]:
    content = path.read_bytes()
    end = content[:_HEAD].find(b"end_header")
    if not content.startswith(b"ply") or end < 0:
        raise OSError("its header is not terminated" if end < 0 else "it does not begin with `ply`")
    body = content[content.find(b"\n", end) + 1 :]
    lines = [each.split() for each in content[:end].decode("ascii", "replace").splitlines()]
    form = next(words[1] for words in lines if words[:1] == ["format"])
    if form == "ascii":  # convert all numbers to float64, then treat the file like a binary one
        body = np.array(body.split(), np.float64).tobytes()
    points, polygons, at = np.zeros((0, 0)), [], 0
    for name, count, properties in _elements(lines, _ORDERS[form], "f8" if form == "ascii" else None):
        runs, at = _rows(body, at, count, properties)
        if name == "vertex":
            points = np.concatenate([np.column_stack([run[each] for each in "xyz"]) for run in runs])
        elif name == "face":
            polygons = [run[each] for run in runs for each in _CORNERS if each in (run.dtype.names or ())]
    return points.astype(np.float64), [each.astype(np.int64) for each in polygons]


_Property = tuple[str, str, str | None]


def _elements(
    lines: list[list[str]], order: str, all_as: str | None
) -> list[tuple[str, int, list[_Property]]]:
    """Name, count and properties of each element; for a property its name, type, and type of a list's
    count.
    """
    found: list[tuple[str, int, list[_Property]]] = []
    for words in lines:
        kinds = [order + (all_as or _NUMBERS.get(each, "")) for each in words[1:-1]]
        if words[:1] == ["element"]:
            found.append((words[1], int(words[2]), []))
        elif words[:2] == ["property", "list"]:
            found[-1][2].append((words[-1], kinds[2], kinds[1]))
        elif words[:1] == ["property"]:
            found[-1][2].append((words[-1], kinds[0], None))
    return found


def _rows(body: bytes, at: int, count: int, properties: list[_Property]) -> tuple[list[NDArray[Any]], int]:
    """The rows of an element from byte `at`, in runs whose lists have equal lengths; and the next byte."""
    runs: list[NDArray[Any]] = []
    window = count
    while count:
        kind, counts = _row(body, at, properties)
        rows = np.frombuffer(body, kind, min(count, window, (len(body) - at) // kind.itemsize), at)
        if not len(rows):
            raise OSError("it ends before all that its header tells of")
        unlike = np.any([rows[each] != rows[each][0] for each in counts], axis=0)
        alike = rows[: int(np.argmax(unlike))] if np.any(unlike) else rows
        window = 2 * len(alike)
        runs.append(alike)
        count -= len(alike)
        at += len(alike) * kind.itemsize
    return runs, at


def _row(body: bytes, at: int, properties: list[_Property]) -> tuple[np.dtype[Any], list[str]]:
    """Data type of a row, with lists as long as in the row at byte `at`; and the names of their counts."""
    fields: list[Any] = []
    counts = []
    for name, kind, of_count in properties:
        if of_count is None:
            fields.append((name, kind))
            at += np.dtype(kind).itemsize
            continue
        length = int(np.frombuffer(body, of_count, 1, at)[0])
        counts.append(f"number of {name}")
        fields += [(counts[-1], of_count), (name, kind, (length,))]
        at += np.dtype(of_count).itemsize + length * np.dtype(kind).itemsize
    return np.dtype(fields), counts
