"""Read the triangles of a GLB file (binary glTF 2.0), as apps that scan with a phone write it, by trimesh.

Lengths are in metres, as the format prescribes (Khronos Group, glTF 2.0 Specification, section 3.4). It has
no patient frame.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.files.unpacking import UnpackingBudget
from limbcli.model import Array, IntArray

_HEADER = struct.Struct("<4sIIII")  # magic, version, length of the file; length and kind of the first chunk
_JSON, _FAN = 0x4E4F534A, 6
_BYTES_OF_TRIANGLE = 3 * 3 * 8 + 3 * 8  # at most, its corners and their numbers


def read_glb(path: Path) -> tuple[Array, list[IntArray]]:
    """Points (n, 3), m, and triangles (m, 3) of every mesh where the scene places it.

    Raises OSError if it is not such a file, is packed, or places more than can be unpacked; and what trimesh
    raises.
    """
    import trimesh

    stated = _json(path)
    _refuse(stated)
    n_stated = sum(int(each["count"]) for each in stated.get("accessors", ()))
    if n_stated > path.stat().st_size:  # each takes a byte at least
        raise OSError(f"it states {n_stated} numbers and points, more than its bytes")
    scene = trimesh.load_scene(path, file_type="glb", process=False, skip_materials=True)
    placed = (scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry)
    UnpackingBudget().spend(_BYTES_OF_TRIANGLE * sum(len(getattr(each, "faces", ())) for each in placed))
    mesh = scene.to_mesh()
    return np.asarray(mesh.vertices, float), [np.asarray(mesh.faces, np.int64)]


def _refuse(stated: dict[str, Any]) -> None:
    """What trimesh 5.2 would leave out or take at another size."""
    packed = [each for each in stated.get("extensionsRequired", ()) if "compression" in str(each)]
    if packed:
        raise OSError(f"its triangles are packed ({packed[0]}): export it without compression")
    for part in (part for mesh in stated.get("meshes", ()) for part in mesh["primitives"]):
        points = stated["accessors"][part["attributes"]["POSITION"]]
        for kind, is_there in (
            ("quantized (normalized whole numbers)", points.get("normalized")),
            ("stored as differences (a sparse accessor)", points.get("sparse")),
            ("of triangle fans", part.get("mode") == _FAN),
        ):
            if is_there:
                raise OSError(f"its points are {kind}, which is not read: export it without this")


def _json(path: Path) -> dict[str, Any]:
    content = path.read_bytes()
    if len(content) < _HEADER.size or content[:4] != b"glTF":
        raise OSError("it is not a binary glTF file")
    _, version, _, length, kind = _HEADER.unpack_from(content)
    if version != 2 or kind != _JSON:
        raise OSError(f"its version of glTF is {version}; 2 is read")
    found = json.loads(content[_HEADER.size : _HEADER.size + length])
    if not isinstance(found, dict):
        raise OSError("its description is not a JSON object")
    return found
