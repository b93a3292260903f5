"""VTK's and OFF's surfaces: the same box out of every form; what is damaged or no surface is refused."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import CaseError, MeshError
from limbcli.imaging.surface import read_surface
from limbcli.meshing.surfaces import read_surface as read_mesh_surface
from limbcli.surface_formats.colours import has_colours
from limbcli.surface_formats.polygons import from_cells
from limbcli.surface_formats.stated_frame import stated_frame
from limbcli.surface_formats.triangle_files import SUFFIXES
from limbcli.surface_formats.vtk_xml import unpacked_lz4

# Written by VTK 9.7.2: a box from (0, 0, 0) to (20, 10, 30) with normals, colours and the field SPACE = RAS
WRITTEN_BY_VTK = sorted((Path(__file__).parents[1] / "data" / "vtk").glob("*.vt*"))
VOLUME = 20.0 * 10.0 * 30.0
POINTS = [[x, y, z] for z in (0, 30) for x, y in ((0, 0), (20, 0), (20, 10), (0, 10))]
FACES = [[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7], [0, 3, 2], [0, 2, 1], [4, 5, 6], [4, 6, 7]]


@pytest.mark.parametrize("path", WRITTEN_BY_VTK, ids=lambda path: path.name)
def test_what_vtk_writes_is_read_in_the_frame_that_it_states(path: Path):
    surface = read_surface(path)
    assert surface.is_closed
    assert surface.volume == pytest.approx(VOLUME)
    np.testing.assert_allclose([surface.points.min(0), surface.points.max(0)], [[-20, -10, 0], [0, 0, 30]])
    assert len(surface.points) == 8
    assert "frame RAS" in stated_frame(path).converted
    assert read_mesh_surface(path).volume == pytest.approx(VOLUME)


def off(path: Path, keyword: str, of_point: str = "", of_face: str = "", *, faces=FACES) -> Path:
    rows = [f"{x} {y} {z}{of_point}" for x, y, z in POINTS]
    rows += [f"{len(face)} {' '.join(map(str, face))}{of_face}" for face in faces]
    path.write_text(f"{keyword}\n# a comment\n\n8 {len(faces)} 0\n" + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize(
    ("keyword", "of_point", "of_face"),
    [
        ("OFF", "", ""),
        ("OFF", "", " 255 0 0"),
        ("COFF", " 255 0 0 255", ""),
        ("NOFF", " 0 0 1", ""),
        ("CNOFF", " 0 0 1 0.5 0.5 0.5 1", " 7"),
        ("4OFF", " 0.5", ""),
    ],
)
def test_an_off_with_normals_and_colours_is_its_points_and_faces(tmp_path, keyword, of_point, of_face):
    surface = read_surface(off(tmp_path / "a.off", keyword, of_point, of_face))
    assert surface.is_closed
    assert surface.volume == pytest.approx(8 * VOLUME if keyword == "4OFF" else VOLUME)


def test_an_off_states_frame_and_unit_in_comments_and_counts_beside_its_keyword(tmp_path):
    path = off(tmp_path / "a.off", "OFF")
    path.write_text(
        path.read_text()
        .replace("OFF\n# a comment\n\n", "OFF ")
        .replace("\n", "  # SPACE=RAS, units: cm\n", 1)
    )
    surface = read_surface(path)
    np.testing.assert_allclose(surface.points.min(0), [-200, -100, 0])
    assert surface.volume == pytest.approx(1e3 * VOLUME)


@pytest.mark.parametrize(
    ("name", "content", "what"),
    [
        ("a.off", "OFF BINARY\n", "OFF BINARY is not read"),
        ("a.off", "nOFF 4\n", "nOFF is not read"),
        ("a.off", "solid\n", "does not begin with OFF"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n", "ends before"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n4 0 1 2\n", "fewer corners"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "does not exist"),
        ("a.vtk", "solid\n", "does not begin like a legacy VTK file"),
        (
            "a.vtk",
            "# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_POINTS\n",
            "STRUCTURED_POINTS, which is no",
        ),
        (
            "a.vtk",
            "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 9 float\n1 2\n",
            "ends before",
        ),
        ("a.vtp", "solid\n", "not a VTK XML file, or damaged"),
        ("a.vtp", '<VTKFile type="ImageData"></VTKFile>', "ImageData, which is no surface"),
        ("a.xyz", "0 0 0\n", "\\.xyz"),
    ],
)
def test_what_is_no_surface_or_damaged_is_refused_in_words(tmp_path, name, content, what):
    (tmp_path / name).write_text(content)
    with pytest.raises(CaseError, match=what) as caught:
        read_surface(tmp_path / name)
    assert caught.value.fix
    with pytest.raises(MeshError, match=what):
        read_mesh_surface(tmp_path / name)


def test_a_grid_of_volume_cells_alone_is_named_so():
    with pytest.raises(OSError, match="fill a volume"):
        from_cells(np.arange(4), np.array([4]), np.array([10]))


@pytest.mark.parametrize("path", WRITTEN_BY_VTK, ids=lambda path: path.name)
def test_a_vtk_file_cut_short_or_with_changed_bytes_is_read_or_refused(tmp_path, path: Path):
    content = path.read_bytes()
    rng = np.random.default_rng(7)
    n_refused = 0
    for k in range(60):
        changed = bytearray(content)
        if k % 2:
            del changed[int(rng.integers(1, len(content))) :]
        else:
            changed[int(rng.integers(len(content)))] = int(rng.integers(256))
        (tmp_path / path.name).write_bytes(changed)
        try:
            read_surface(tmp_path / path.name)
        except CaseError:
            n_refused += 1
    assert n_refused > 10


def test_the_formats_that_a_message_names_are_read(tmp_path):
    with pytest.raises(MeshError) as caught:
        read_mesh_surface(tmp_path / "a.stl")
    assert all(suffix in caught.value.fix for suffix in SUFFIXES)
    for suffix in SUFFIXES:
        (tmp_path / f"a{suffix}").write_bytes(b"\x00")
        with pytest.raises(MeshError, match=r"cannot be read|no triangles") as found:
            read_mesh_surface(tmp_path / f"a{suffix}")
        assert "(1)" not in found.value.what
        assert "Unknown file format" not in found.value.what


def test_a_quadratic_triangle_and_quadrilateral_keep_their_area():
    corners = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])
    middles = (corners + np.roll(corners, -1, axis=0)) / 2
    nine = np.r_[corners, middles, [[1.0, 1.0]]]
    three = np.array([[0.0, 0], [2, 0], [0, 2], [1, 0], [1, 1], [0, 1]])
    for points, kind, area in ((nine[:8], 23, 4.0), (nine, 28, 4.0), (three, 22, 2.0)):
        parts = from_cells(np.arange(len(points)), np.array([len(points)]), np.array([kind]))
        x, y = np.moveaxis(points, 1, 0)
        found = sum(
            float(0.5 * (x[p] * y[np.roll(p, -1)] - x[np.roll(p, -1)] * y[p]).sum())
            for each in parts
            for p in each
        )
        assert found == pytest.approx(area)


@pytest.mark.parametrize("block", [b"\x40RA", b"\x13a\x05\x00", b"\x13a\x00\x00", b"\xf0\xff\xff"])
def test_a_damaged_lz4_block_is_refused(block):
    with pytest.raises(ValueError, match="LZ4"):
        unpacked_lz4(block, 4)


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("a.ply", "ply\nformat ascii 1.0\nproperty float x\nproperty uchar red\nend_header\n", True),
        ("a.ply", "ply\nformat ascii 1.0\ncomment red limb\nproperty float x\nend_header\n", False),
        ("a.obj", "v 0 0 0 0.5 0.5 0.5\n", True),
        ("a.obj", "usemtl skin\n", True),
        ("a.obj", "v 0 0 0\nvn 0 0 1\n", False),
        ("a.off", "# c\nCOFF\n", True),
        ("a.off", "OFF\n", False),
    ],
)
def test_colours_are_noticed(tmp_path, name, content, expected):
    (tmp_path / name).write_text(content)
    assert has_colours(tmp_path / name) == expected


def test_colours_of_binary_files_are_noticed(tmp_path):
    assert all(
        has_colours(path) for path in WRITTEN_BY_VTK if "strips" not in path.name and "zlib" not in path.name
    )
    path = tmp_path / "a.stl"
    for colour, expected in ((b"\0\0", False), (b"\x1f\x80", True)):
        path.write_bytes(bytes(80) + (1).to_bytes(4, "little") + bytes(48) + colour)
        assert has_colours(path) == expected


@pytest.mark.parametrize("n_corners", [7, 0x0C000000, 0x7FFFFFFF])
@pytest.mark.parametrize("kind", ["POLYGONS", "CELLS"])
def test_a_last_cell_with_more_corners_than_there_are_is_refused_at_once(tmp_path, kind, n_corners):
    """Of a grid, as many numbers as it claims were made first, which took minutes or all memory."""
    is_grid = kind == "CELLS"
    head = (
        f"# vtk DataFile Version 4.2\na\nBINARY\nDATASET {'UNSTRUCTURED_GRID' if is_grid else 'POLYDATA'}\n"
    )
    content = head.encode() + b"POINTS 4 float\n" + np.eye(4, 3, dtype=">f4").tobytes()
    content += f"\n{kind} 2 8\n".encode() + np.array([3, 0, 1, 2, n_corners, 1, 2, 3], ">i4").tobytes()
    content += (b"\nCELL_TYPES 2\n" + np.array([5, 7], ">i4").tobytes()) * is_grid
    (tmp_path / "a.vtk").write_bytes(content + b"\n")
    begin = time.monotonic()
    with pytest.raises(CaseError, match=r"beyond their corners|corners of a cell"):
        read_surface(tmp_path / "a.vtk")
    assert time.monotonic() - begin < 5.0


def test_an_lz4_block_that_copies_without_end_is_refused_before_it_does():
    """Each byte of 255 adds as many to what is copied: 20 kB stand for 5 MB."""
    block = b"\x1fa\x01\x00" + b"\xff" * 20_000 + b"\x00"
    with pytest.raises(ValueError, match="damaged"):
        unpacked_lz4(block, 100)
