"""GLB files written byte by byte: where the scene places meshes, metres, and what is refused."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from limbcli.meshing.surfaces import read_surface
from limbcli.surface_formats.colours import has_colours
from limbcli.surface_formats.stated_frame import stated_frame
from limbcli.surface_formats.triangle_files import read_triangles
from tests.surface_formats.test_stated_frame import volume

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]]) / 10.0
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def write_glb(path: Path, nodes: list[dict[str, Any]], **more: Any) -> None:
    """One tetrahedron of 1 x 2 x 3 dm, which the nodes place; more : of the file's description."""
    points, faces = POINTS.astype("<f4").tobytes(), FACES.astype("<u4").tobytes()
    stated = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes, "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": len(points + faces)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(points)},
            {"buffer": 0, "byteOffset": len(points), "byteLength": len(faces)},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
             "min": POINTS.min(axis=0).tolist(), "max": POINTS.max(axis=0).tolist()},
            {"bufferView": 1, "componentType": 5125, "count": 12, "type": "SCALAR"},
        ],
    } | more  # fmt: skip
    text = json.dumps(stated).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text
    body += struct.pack("<II", len(points + faces), 0x004E4942) + points + faces
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)


def test_meshes_are_where_the_scene_places_them_in_mm(tmp_path):
    """Twice as large and moved; and mirrored, with its normals still outwards."""
    path = tmp_path / "skin.glb"
    write_glb(
        path, [{"mesh": 0, "scale": [2, 2, 2], "translation": [0, 1, 0]}, {"mesh": 0, "scale": [-1, 1, 1]}]
    )
    points, faces = read_triangles(path)
    assert len(points) == 8
    assert len(faces) == 8
    first, second = (faces[(faces[:, 0] < 4) == each] for each in (True, False))
    large, mirrored = sorted((first, second), key=lambda each: -points[each].max())
    np.testing.assert_allclose(points[large].max(axis=(0, 1)), [200, 1400, 600], atol=1e-4)
    np.testing.assert_allclose(points[mirrored].min(axis=(0, 1)), [-100, 0, 0], atol=1e-4)
    assert volume(points, large) == pytest.approx(8e6, rel=1e-6)
    assert volume(points, mirrored) == pytest.approx(1e6, rel=1e-6)
    assert (
        stated_frame(path).converted == "skin.glb states its lengths in units of m: they were converted to mm"
    )
    assert not has_colours(path)
    assert len(read_surface(path).faces) == 8


@pytest.mark.parametrize("change", [{"normalized": True}, {"sparse": {"count": 1}}])
def test_points_that_would_be_read_at_another_size_are_refused(tmp_path, change):
    path = tmp_path / "skin.glb"
    write_glb(path, [{"mesh": 0}])
    content = path.read_bytes()
    accessors = json.loads(content[20 : content.index(b"BIN\0") - 4])["accessors"]
    write_glb(path, [{"mesh": 0}], accessors=[accessors[0] | change, accessors[1]])
    with pytest.raises(OSError, match="export it without this"):
        read_triangles(path)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "export it without compression"),
        ({"accessors": [{"componentType": 5126, "count": 10**9, "type": "VEC3"}]}, "more than its bytes"),
        ({"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 6}]}]}, "triangle fans"),
        ({"accessors": 3}, "not"),
        ({"bufferViews": []}, "out of range"),
    ],
)
def test_what_cannot_be_read_is_refused(tmp_path, more, words):
    write_glb(tmp_path / "skin.glb", [{"mesh": 0}], **more)
    with pytest.raises(OSError, match=words):
        read_triangles(tmp_path / "skin.glb")


def test_another_file_of_that_name_is_refused(tmp_path):
    for content, words in (
        (b"solid skin", "not a binary glTF"),
        (b"glTF" + bytes(16), "version of glTF is 0"),
    ):
        (tmp_path / "skin.glb").write_bytes(content)
        with pytest.raises(OSError, match=words):
            read_triangles(tmp_path / "skin.glb")
