"""The same body out of every form in which scanners and drawing programs write surfaces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from limbcli.imaging.surface import read_surface
from limbcli.surface_formats.triangle_files import read_triangles

POINTS = np.array([[x, y, z] for z in (0.0, 30.0) for x, y in ((0, 0), (20, 0), (20, 10), (0, 10))])
SIDES = [[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
ENDS = [[0, 3, 2], [0, 2, 1], [4, 5, 6], [4, 6, 7]]  # triangles beside the sides' quadrilaterals
VOLUME = 20.0 * 10.0 * 30.0


def write_obj(path: Path, corner: str, *, backwards: bool = False) -> None:
    """corner : a format of the point's number; a texture with more places than there are points."""
    shift = -len(POINTS) if backwards else 1
    rows = [f"v {x} {y} {z}" for x, y, z in POINTS] + ["vn 0 0 1", *["vt 0.5 0.5"] * 11, "usemtl scan"]
    rows += ["f " + " ".join(corner.format(each + shift) for each in face) for face in SIDES + ENDS]
    path.write_text("\n".join(rows))


def write_ply(path: Path, form: str, count: str, corner: str, name: str) -> None:
    """Colours beside points and faces, faces of three and of four corners in turn, an element before both."""
    head = f"ply\nformat {form} 1.0\ncomment from a scanner\nelement camera 1\nproperty float view_x\n"
    head += f"element vertex {len(POINTS)}\n" + "".join(f"property double {each}\n" for each in "xyz")
    head += f"property uchar red\nelement face {len(SIDES + ENDS)}\nproperty list {count} {corner} {name}\n"
    head += "property int flags\nend_header\n"
    order = ">" if "big" in form else "<"
    kinds = {"uchar": "u1", "uint8": "u1", "int": "i4", "uint": "u4", "int32": "i4"}
    rows = [([1.5], "f4"), *((part, kind) for each in POINTS for part, kind in ((each, "f8"), ([200], "u1")))]
    for face in (each for pair in zip(SIDES, ENDS, strict=True) for each in pair):
        rows += [([len(face)], kinds[count]), (face, kinds[corner]), ([7], "i4")]
    if form == "ascii":
        path.write_text(head + " ".join(f"{value:g}" for values, _ in rows for value in values) + "\n")
    else:
        body = b"".join(np.array(values).astype(order + kind).tobytes() for values, kind in rows)
        path.write_bytes(head.encode() + body)


@pytest.mark.parametrize("corner", ["{0}", "{0}/{0}", "{0}//1", "{0}/11/1"])
@pytest.mark.parametrize("backwards", [False, True])
def test_an_obj_with_textures_and_normals_is_its_points_and_faces(tmp_path, corner: str, backwards: bool):
    write_obj(tmp_path / "a.obj", corner, backwards=backwards)
    surface = read_surface(tmp_path / "a.obj")
    assert surface.is_closed
    assert surface.volume == pytest.approx(VOLUME)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(
    ("count", "corner", "name"),
    [("uchar", "int", "vertex_indices"), ("uchar", "uint", "vertex_index"), ("int", "int32", "vertex_index")],
)
def test_a_ply_with_colours_and_faces_of_any_corners_is_read(tmp_path, form, count, corner, name):
    write_ply(tmp_path / "a.ply", form, count, corner, name)
    surface = read_surface(tmp_path / "a.ply")
    assert surface.is_closed
    assert surface.volume == pytest.approx(VOLUME)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_a_ply_that_ends_early_is_refused(tmp_path, form):
    path = tmp_path / "a.ply"
    write_ply(path, form, "uchar", "int", "vertex_indices")
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(OSError, match="ends before"):
        read_triangles(path)


def test_a_ply_whose_faces_are_no_lists_is_refused(tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 1\nproperty int vertex_indices\nend_header\n"
    (tmp_path / "a.ply").write_text(head + "0 0 0\n0\n")
    with pytest.raises(OSError, match="not lists of corners"):
        read_triangles(tmp_path / "a.ply")


def test_an_obj_without_points_holds_no_triangles(tmp_path):
    (tmp_path / "a.obj").write_text("# nothing\n")
    points, faces = read_triangles(tmp_path / "a.obj")
    assert points.shape == faces.shape == (0, 3)


def test_lines_of_obj_that_go_on_are_one(tmp_path: Path) -> None:
    rows = ["v " + " ".join(map(str, each)) for each in POINTS]
    rows += ["f " + " \\\n ".join(str(each + 1) for each in face) for face in SIDES + ENDS]
    (tmp_path / "a.obj").write_text("\n".join(rows))
    points, faces = read_triangles(tmp_path / "a.obj")
    assert (len(points), len(faces)) == (8, 12)


@pytest.mark.parametrize("first", range(6))
@pytest.mark.parametrize("turn", [np.eye(3), -np.eye(3)[[1, 2, 0]]])
def test_a_face_that_is_not_convex_is_covered_once(tmp_path: Path, first: int, turn: np.ndarray) -> None:
    # an L of 500 mm2 with sides of 120 mm in all, 20 mm high; a fan would cover parts of its ends twice
    outline = np.roll([(0, 0), (30, 0), (30, 10), (10, 10), (10, 30), (0, 30)], -first, axis=0)
    points = np.vstack([np.column_stack([outline, np.full(6, z)]) for z in (0, 20)]) @ turn
    faces = [
        [*range(5, -1, -1)],
        [*range(6, 12)],
        *([k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6] for k in range(6)),
    ]
    rows = [f"v {x} {y} {z}" for x, y, z in points] + [
        "f " + " ".join(str(k + 1) for k in each) for each in faces
    ]
    (tmp_path / "a.obj").write_text("\n".join(rows))
    points, faces = read_triangles(tmp_path / "a.obj")
    a, b, c = (points[faces[:, k]] for k in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(2 * 500 + 20 * 120)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(np.linalg.det(turn) * 500 * 20)


def stl_text(*, name: str = "", indent: str = "", upper: bool = False) -> str:
    triangles = [[face[0], face[k], face[k + 1]] for face in SIDES + ENDS for k in range(1, len(face) - 1)]
    lines = [f"solid {name}"]
    for face in triangles:
        corners = [f"{indent * 3}vertex {x:.6e} {y:.6e} {z:.6e}" for x, y, z in POINTS[face]]
        lines += [f"{indent}facet normal 0 0 0", f"{indent * 2}outer loop", *corners]
        lines += [f"{indent * 2}endloop", f"{indent}endfacet"]
    text = "\n".join([*lines, "endsolid"]) + "\n"
    return text.upper() if upper else text


@pytest.mark.parametrize(
    "text",
    [
        stl_text().replace("endsolid", "\nendsolid"),  # as trimesh writes it
        stl_text(name="vertex 1 2 3", indent="  "),
        stl_text(name="skin", indent="\t", upper=True).replace("\n", "\r\n"),
    ],
)
def test_text_stl_is_read_by_its_keywords(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.stl").write_bytes(text.encode())
    points, faces = read_triangles(tmp_path / "a.stl")
    assert (len(points), len(faces)) == (8, 12)
    corners = points[faces]
    volume = np.linalg.det(corners - corners.mean(axis=(0, 1))).sum() / 6
    assert volume == pytest.approx(VOLUME)


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (stl_text()[:900].encode(), "ends early"),
        (b"solid binary".ljust(80) + (99).to_bytes(4, "little") + bytes(50), "before all 99 triangles"),
        (b"no surface", "neither text nor binary"),
    ],
)
def test_a_damaged_stl_is_refused(tmp_path: Path, content: bytes, part: str) -> None:
    (tmp_path / "a.stl").write_bytes(content)
    with pytest.raises(OSError, match=part):
        read_triangles(tmp_path / "a.stl")
