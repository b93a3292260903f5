"""The frame and the unit of length that a surface file states, and its points in patient LPS, mm.

Where a file says so, and which programs write it:

- `SPACE=RAS` or `SPACE=LPS` in the header of an STL, a comment of a PLY or OBJ, the title of a legacy VTK
  file; a field `SPACE` in VTP and VTU (3D Slicer 5.13, vtkMRMLModelStorageNode; surfa writes it into OBJ)
- "1 unit = 1000.000000 mm" in a comment of an OBJ (Materialise 3-matic, as documented by 3D Slicer 5.13)
- "File units = inches" in a comment of an OBJ (SketchUp); "units mm" in comments of scanners' PLY and OBJ
- a GLB is in metres (glTF 2.0 Specification, section 3.4)
- the attribute `unit` of `<model>` in a 3MF (3MF Core Specification 1.3, millimeter where it is missing)

A file that says nothing is taken as patient LPS in mm.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.errors import CaseError
from limbcli.model import Array, IntArray
from limbcli.numbers.units import LENGTH_UNITS_IN_MM, unit_named
from limbcli.surface_formats.three_mf import unit_of_3mf
from limbcli.surface_formats.vtk_xml import field_text

_AXES = {"R": (0, -1), "L": (0, 1), "A": (1, -1), "P": (1, 1), "I": (2, -1), "S": (2, 1)}  # axis of LPS, sign
_SPACE = re.compile(r"(?<![A-Za-z_])SPACE\s*[=:]\s*([A-Za-z-]+)", re.IGNORECASE)
_ONE_UNIT = re.compile(r"\b1 unit\s*=\s*([0-9][0-9.]*(?:e[+-]?\d+)?)\s*([^\W\d]+)", re.IGNORECASE)
_UNITS = re.compile(r"\bunits?\b\s*(?:(?:is|are|in|of length)\b)?\s*[=:]?\s*([^\W\d]+)", re.IGNORECASE)
_STL_TITLE = 80  # bytes
_VTK_FIELD = re.compile(rb"\nSPACE 1 1 string\r?\n[\x80-\xff]?([A-Za-z-]+)")


@dataclass(frozen=True)
class StatedFrame:
    """What a surface file states: `frame` as three letters ("" if none), `unit` in words ("" if none).

    axes : (3, 3), from the file's coordinates to patient LPS, both in mm; mm_per_unit : mm
    """

    name: str
    frame: str = ""
    unit: str = ""
    mm_per_unit: float = 1.0

    @property
    def axes(self) -> Array:
        axes = np.zeros((3, 3))
        for column, letter in enumerate(self.frame or "LPS"):
            row, sign = _AXES[letter]
            axes[row, column] = sign
        return axes

    @property
    def converted(self) -> str:
        """What was converted, as a sentence; empty if the file is in patient LPS and mm."""
        done = []
        if self.frame not in ("", "LPS"):
            done.append(f"states the frame {self.frame}: it was turned to patient LPS")
        if self.mm_per_unit != 1.0:
            done.append(f"states its lengths in units of {self.unit}: they were converted to mm")
        return f"{self.name} {' and '.join(done)}" if done else ""

    def to_lps(self, points: Array, faces: IntArray) -> tuple[Array, IntArray]:
        """Points (n, 3) in patient LPS, mm; faces (m, 3) with their normals on the same side as before."""
        if not self.converted:
            return points, faces
        mirrored = np.linalg.det(self.axes) < 0
        return self.mm_per_unit * points @ self.axes.T, faces[:, ::-1].copy() if mirrored else faces


def stated_frame(path: Path) -> StatedFrame:
    """The frame and unit that a surface file states.

    Raises CaseError if it states two frames or units, or a frame that is not known; OSError if it cannot be
    read.
    """
    read = {".stl": _of_stl, ".ply": _of_ply, ".vtk": _of_vtk, ".vtp": _of_vtk_xml, ".vtu": _of_vtk_xml,
            ".3mf": _of_3mf, ".glb": _of_glb}.get(path.suffix.lower(), _of_comments)  # fmt: skip
    lines = read(path)
    frames = {_letters(word, path) for line in lines for word in _SPACE.findall(line)}
    units = {size: word for line in lines for word, size in _units_of(line)}
    if len(frames) > 1 or len(units) > 1:
        kind, several = ("frames", frames) if len(frames) > 1 else ("units of length", units.values())
        raise CaseError(
            f"the surface states {len(several)} {kind}: {', '.join(sorted(several))}",
            where=str(path),
            fix="remove the wrong one from its header, or export it again in patient LPS and mm",
        )
    mm_per_unit, unit = next(iter(units.items()), (1.0, ""))
    return StatedFrame(path.name, next(iter(frames), ""), unit, mm_per_unit)


def mixed_frames(files: Iterable[StatedFrame]) -> str:
    """A sentence if some of a case's surfaces were converted as they state, and others state nothing.

    >>> skin, tibia = StatedFrame("skin.stl"), StatedFrame("tibia.stl", "RAS")
    >>> mixed_frames([skin, tibia])
    'in skin.stl no frame is stated (taken as patient LPS), while in tibia.stl one is (turned)'
    """
    files = list(files)
    found = []
    for silent, done, words in (
        ([not each.frame for each in files], [each.frame not in ("", "LPS") for each in files],
         ("no frame is stated (taken as patient LPS)", "one is (turned)")),
        ([not each.unit for each in files], [each.mm_per_unit != 1.0 for each in files],
         ("no unit of length is stated (taken as mm)", "one is (scaled)")),
    ):  # fmt: skip
        if any(silent) and any(done):
            names = [
                ", ".join(each.name for each, one in zip(files, of, strict=True) if one)
                for of in (silent, done)
            ]
            found.append(f"in {names[0]} {words[0]}, while in {names[1]} {words[1]}")
    return "; ".join(found)


def _letters(word: str, path: Path) -> str:
    """A frame's three letters; its long name, as in NRRD, has their words.

    >>> _letters("left-posterior-superior", Path("a.stl"))
    'LPS'
    """
    letters = "".join(part[:1] for part in word.split("-")).upper() if "-" in word else word.upper()
    if len(letters) == 3 and {_AXES.get(letter, (letter, 0))[0] for letter in letters} == {0, 1, 2}:
        return letters
    raise CaseError(
        f"the surface states the frame {word!r}, which is not known",
        where=str(path),
        fix="export it in patient LPS (or RAS, with SPACE=RAS in its header); or remove the statement",
    )


def _units_of(line: str) -> list[tuple[str, float]]:
    """The units that a line states: in words, and in mm.

    >>> _units_of("vertex coordinates are measured in units, where 1 unit = 1000.000000 mm")
    [('1000 mm', 1000.0)]
    >>> _units_of("File units = inches"), _units_of("3 units of two kinds")
    ([('inch', 25.4)], [])
    """
    found = []
    for number, word in _ONE_UNIT.findall(line):
        unit = unit_named(word, LENGTH_UNITS_IN_MM)
        if unit is not None and float(number) > 0:
            found.append((f"{float(number):g} {unit}", float(number) * LENGTH_UNITS_IN_MM[unit]))
    for word in _UNITS.findall(line):
        unit = unit_named(word, LENGTH_UNITS_IN_MM)
        if unit is not None:
            found.append((unit, LENGTH_UNITS_IN_MM[unit]))
    return found


# ---------------------------------------------------------------- where each format has it


def _of_stl(path: Path) -> list[str]:
    with path.open("rb") as file:
        head = file.read(_STL_TITLE + 4)
        count = int.from_bytes(head[_STL_TITLE:], "little")
        is_binary = len(head) == _STL_TITLE + 4 and path.stat().st_size == _STL_TITLE + 4 + 50 * count
        titles = [head[:_STL_TITLE]]
        if not is_binary:
            titles += re.findall(rb"^[ \t]*solid\b[^\r\n]*", head + file.read(), re.MULTILINE)
    return [each.decode("latin-1") for each in titles]


def _of_ply(path: Path) -> list[str]:
    with path.open("rb") as file:
        head = file.read(1 << 20)
    head = head[: max(0, head.find(b"end_header"))]
    return [line for line in head.decode("latin-1").splitlines() if line.startswith(("comment", "obj_info"))]


def _of_comments(path: Path) -> list[str]:
    found = re.findall(rb"(?:^|[ \t])#[^\r\n]*", path.read_bytes(), re.MULTILINE)
    return [each.decode("latin-1") for each in found]


def _of_vtk(path: Path) -> list[str]:
    content = path.read_bytes()
    title = content[:1024].decode("latin-1").splitlines()[1:2]
    return [*title, *(f"SPACE={each.decode('latin-1')}" for each in _VTK_FIELD.findall(content))]


def _of_3mf(path: Path) -> list[str]:
    try:
        unit = unit_of_3mf(path)
    except OSError as error:
        fix = "export it again as 3MF, or as STL, PLY or OBJ"
        raise CaseError(f"the surface cannot be read ({error})", where=str(path), fix=fix) from error
    if unit_named(unit, LENGTH_UNITS_IN_MM) is None:
        raise CaseError(
            f"the surface's unit of length is {unit!r}, which is not known",
            where=str(path),
            fix="export it again in millimeters",
        )
    return [f"unit={unit}"]


def _of_glb(path: Path) -> list[str]:
    return ["unit=m"]


def _of_vtk_xml(path: Path) -> list[str]:
    """The text SPACE of the field data, in any of the encodings of VTK's XML files."""
    try:
        word = field_text(path, "SPACE")
    except OSError as error:
        raise CaseError(
            f"the frame (SPACE) of the surface cannot be read ({error})",
            where=str(path),
            fix="save it as STL, PLY or OBJ, or without compression",
        ) from error
    return [f"SPACE={word}"] if word else []
