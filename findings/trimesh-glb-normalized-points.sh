#!/bin/sh
# trimesh 5.2.0: a surface in a GLB whose points are quantized (KHR_mesh_quantization), to make a scan small.
# Guess: the surface has the size it had, or the file is refused, as its extension is required and not known.
# Seen:  points stored as whole numbers "normalized" to 0 to 1 are taken as they are stored, 32,767 times too
#        large: a box of 0.5 m is 16,383.5 m wide. Whole numbers that are not normalized come out right. (glTF
#        2.0 Specification, section 3.6.2.1: a normalized short c stands for max(c / 32767, -1).)
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q trimesh==5.2.0 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import json
import struct
import sys
from pathlib import Path

import numpy as np
import trimesh

box = trimesh.creation.box(bounds=[[0, 0, 0], [1, 1, 1]])


def written(path, largest, normalized):
    """The box of 1 m, its points as whole numbers up to `largest`, placed by the scene at half its size."""
    points = np.zeros((len(box.vertices), 4), "<i2")  # rows of eight bytes, as the format wants them aligned
    points[:, :3] = np.round(box.vertices * largest)
    faces = box.faces.astype("<u2")
    half = 0.5 if normalized else 0.5 / largest
    content = points.tobytes() + faces.tobytes()
    stated = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "extensionsUsed": ["KHR_mesh_quantization"], "extensionsRequired": ["KHR_mesh_quantization"],
        "nodes": [{"mesh": 0, "scale": [half] * 3}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5122, "normalized": normalized, "count": len(points),
             "type": "VEC3", "min": [0, 0, 0], "max": [int(largest)] * 3},
            {"bufferView": 1, "componentType": 5123, "count": faces.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": points.nbytes, "byteStride": 8},
            {"buffer": 0, "byteOffset": points.nbytes, "byteLength": faces.nbytes},
        ],
        "buffers": [{"byteLength": len(content)}],
    }
    text = json.dumps(stated).encode()
    text += b" " * (-len(text) % 4)
    content += bytes(-len(content) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(content), 0x004E4942) + content
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
    return float(trimesh.load_scene(path).extents.max())


folder = Path(sys.argv[1])
plain, normalized = written(folder / "plain.glb", 1000, False), written(folder / "norm.glb", 32767, True)
print(f"0.5 m wide: {plain:g} m read from whole numbers, {normalized:g} m from normalized ones")
assert abs(plain - 0.5) < 1e-3 and abs(normalized - 0.5 * 32767) < 1
PYTHON
