"""Read the triangles of a 3MF file: all objects that are to be built, where they are to be built.

Format: 3MF Core Specification 1.3 (objects, components, build items and their transforms) and Production
Extension (objects in other parts of the package, as PrusaSlicer and Bambu Studio write them).
"""

from __future__ import annotations

import contextlib
import posixpath
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from lxml import etree

from limbcli.files.unpacking import DAMAGED, UnpackingBudget
from limbcli.files.xml import parsed_xml
from limbcli.model import Array, IntArray

_RELATIONS = "_rels/.rels"
_MODEL = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_DEEPEST, _MOST_PLACED = 20, 20_000  # objects made of objects; objects in all places
_DEFAULT_UNIT = "millimeter"


def read_3mf(path: Path) -> tuple[Array, list[IntArray]]:
    """Points (n, 3) in the file's own unit, and the triangles (m, 3) of each body.

    Raises OSError if it is not a 3MF file, is damaged, or refers to an object that does not exist.
    """
    with _opened(path) as parts:
        root, build = parts.root, parts.part(parts.root).find("{*}build")
        for item in build.iterfind("{*}item") if build is not None else ():
            parts.add(_path(item, root), item.get("objectid", ""), _transform(item), 0)
    if not parts.points:
        return np.zeros((0, 3)), []
    return np.concatenate(parts.points), parts.faces


def unit_of_3mf(path: Path) -> str:
    """The unit of length of a 3MF file.

    Raises OSError if it cannot be read.
    """
    with _opened(path) as parts:
        return str(parts.part(parts.root).get("unit", _DEFAULT_UNIT))


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[_Package]:
    try:
        with zipfile.ZipFile(path) as package:
            yield _Package(package)
    except DAMAGED as error:
        raise OSError(f"it is not a 3MF file, or damaged ({error})") from error


@dataclass
class _Package:
    """The open package, its parts as far as they were read, and the bodies found."""

    package: zipfile.ZipFile
    budget: UnpackingBudget = field(default_factory=UnpackingBudget)
    n_placed: int = 0
    read: dict[str, etree._Element] = field(default_factory=dict)
    points: list[Array] = field(default_factory=list)
    faces: list[IntArray] = field(default_factory=list)

    @property
    def root(self) -> str:
        """The name of the part with the model."""
        for each in self.part(_RELATIONS):
            if each.get("Type") == _MODEL:
                return posixpath.normpath("/" + each.get("Target", "")).lstrip("/")
        raise KeyError("no relation to a 3D model")

    def part(self, name: str) -> etree._Element:
        if name not in self.read:
            self.read[name] = parsed_xml(self.budget.part(self.package, name))
        return self.read[name]

    def add(self, part: str, number: str, place: Array, depth: int) -> None:
        """Add an object (or what it is made of), moved by `place` (4, 3)."""
        objects = self.part(part).iterfind("{*}resources/{*}object")
        found = next((each for each in objects if each.get("id") == number), None)
        if found is None or depth > _DEEPEST:
            raise OSError(f"it refers to object {number}, which does not exist or is made of itself")
        self.n_placed += 1
        if self.n_placed > _MOST_PLACED:
            raise OSError(f"it places more than {_MOST_PLACED} objects")
        mesh = found.find("{*}mesh")
        if mesh is not None and found.get("type", "model") in ("model", "surface"):
            self._add_mesh(mesh, place)
        for each in found.iterfind("{*}components/{*}component"):
            inner = np.vstack([_transform(each)[:3] @ place[:3], _transform(each)[3] @ place[:3] + place[3]])
            self.add(_path(each, part), each.get("objectid", ""), inner, depth + 1)

    def _add_mesh(self, mesh: etree._Element, place: Array) -> None:
        try:
            rows = [
                [float(each.get(axis, "")) for axis in "xyz"]
                for each in mesh.iterfind("{*}vertices/{*}vertex")
            ]
            corners = [
                [int(each.get(name, "")) for name in ("v1", "v2", "v3")]
                for each in mesh.iterfind("{*}triangles/{*}triangle")
            ]
        except ValueError as error:
            raise OSError("a coordinate or a corner of a triangle is not a number") from error
        points = np.array(rows or np.zeros((0, 3)), dtype=np.float64)
        faces = np.array(corners or np.zeros((0, 3)), dtype=np.int64)
        if len(faces) and not 0 <= faces.min() <= faces.max() < len(points):
            raise OSError(f"a triangle refers to a point that does not exist (of {len(points)})")
        self.budget.spend(points.nbytes + faces.nbytes)  # a mesh may be placed many times
        if np.linalg.det(place[:3]) < 0:
            faces = faces[:, ::-1]
        self.faces.append(faces + sum(map(len, self.points)))
        self.points.append(points @ place[:3] + place[3])


def _path(element: etree._Element, part: str) -> str:
    """The part that a component or an item names (Production Extension), else the one it stands in."""
    named = next((str(value) for key, value in element.items() if str(key).endswith("}path")), None)
    return part if named is None else posixpath.normpath("/" + named).lstrip("/")


def _transform(element: etree._Element) -> Array:
    """The transform (4, 3) of a component or an item, applied to row vectors; the identity if it has none."""
    words = (element.get("transform") or "1 0 0 0 1 0 0 0 1 0 0 0").split()
    try:
        return np.array(words, dtype=np.float64).reshape(4, 3)
    except ValueError as error:
        raise OSError(f"a transform has not 12 numbers: {' '.join(words)[:80]}") from error
