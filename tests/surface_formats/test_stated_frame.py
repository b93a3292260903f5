"""What surface files say of their frame and unit, as 3D Slicer, 3-matic, SketchUp and VTK write it."""

from __future__ import annotations

import base64
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.surface_formats.stated_frame import stated_frame
from limbcli.surface_formats.triangle_files import read_triangles

POINTS = np.array([[10.0, 20.0, 30.0], [11.0, 20.0, 30.0], [10.0, 22.0, 30.0], [10.0, 20.0, 33.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
TURNED = POINTS * [-1, -1, 1]
OBJ = "".join(f"v {x} {y} {z}\n" for x, y, z in POINTS) + "".join(f"f {a} {b} {c}\n" for a, b, c in FACES + 1)
RAS = "3D Slicer output. SPACE=RAS"


def binary_stl(path: Path, title: str) -> None:
    rows = np.zeros(len(FACES), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])
    rows["corners"] = POINTS[FACES]
    path.write_bytes(title.encode().ljust(80, b"\0") + struct.pack("<I", len(FACES)) + rows.tobytes())


def ascii_stl(path: Path, title: str) -> None:
    corners = ["".join(f"vertex {x} {y} {z}\n" for x, y, z in each) for each in POINTS[FACES]]
    facets = [f"facet normal 0 0 0\nouter loop\n{each}endloop\nendfacet\n" for each in corners]
    path.write_text(f"solid {title}\n{''.join(facets)}endsolid\n")


def ply(path: Path, comment: str) -> None:
    head = f"ply\nformat ascii 1.0\ncomment VTK generated PLY File\ncomment {comment}\nelement vertex 4\n"
    head += "property float x\nproperty float y\nproperty float z\nelement face 4\n"
    rows = [" ".join(map(str, each)) for each in POINTS] + [f"3 {a} {b} {c}" for a, b, c in FACES]
    path.write_text(head + "property list uchar int vertex_indices\nend_header\n" + "\n".join(rows) + "\n")


def obj(path: Path, comment: str) -> None:
    path.write_text(f"#  {comment}\n\nmtllib a.mtl\n{OBJ}")


def vtk(path: Path, title: str) -> None:
    head = f"# vtk DataFile Version 4.2\n{title}\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 float\n"
    cells = "\n".join(f"3 {a} {b} {c}" for a, b, c in FACES)
    points = "\n".join(" ".join(map(str, each)) for each in POINTS)
    path.write_text(f"{head}{points}\nCELLS 4 16\n{cells}\nCELL_TYPES 4\n5\n5\n5\n5\n")


WRITERS = [(binary_stl, "a.stl"), (ascii_stl, "a.STL"), (ply, "a.ply"), (obj, "a.obj"), (vtk, "a.vtk")]


def volume(points, faces) -> float:
    return float(np.linalg.det(points[faces] - points[0]).sum() / 6)


@pytest.mark.parametrize(("write", "name"), WRITERS)
def test_a_stated_frame_is_turned_to_lps(tmp_path, write, name):
    path = tmp_path / name
    for title, wanted in ((RAS, TURNED), (RAS.replace("RAS", "LPS"), POINTS), ("a limb", POINTS)):
        write(path, title)
        points, faces = read_triangles(path)
        np.testing.assert_allclose(points[faces], wanted[FACES])
        assert bool(stated_frame(path).converted) == (title == RAS)
    write(path, "SPACE=left-anterior-superior")  # a mirrored frame: the normals stay outside
    points, faces = read_triangles(path)
    assert {tuple(each) for each in points[faces].reshape(-1, 3)} == {
        tuple(each) for each in POINTS * [1, -1, 1]
    }
    assert volume(points, faces) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("comment", "scale"),
    [
        ("vertex coordinates are measured in units, where 1 unit = 1000.000000 mm", 1000.0),
        ("vertex coordinates are measured in units, where 1 unit = 1.000000 mm", 1.0),
        ("File units = inches", 25.4),
        ("Units: cm", 10.0),
        ("units in metres; +z up", 1000.0),
        ("3 units of each kind, colour SPACES, ColorSPACE=sRGB", 1.0),
    ],
)
def test_a_stated_unit_of_length_is_converted(tmp_path, comment, scale):
    for write, name in ((obj, "a.obj"), (ply, "a.ply")):
        write(tmp_path / name, comment)
        points, faces = read_triangles(tmp_path / name)
        np.testing.assert_allclose(points, scale * POINTS)
        assert volume(points, faces) == pytest.approx(scale**3)
        assert ("converted to mm" in stated_frame(tmp_path / name).converted) == (scale != 1.0)


@pytest.mark.parametrize(
    ("comment", "what"),
    [
        ("SPACE=RAS\n# SPACE=LPS", "states 2 frames: LPS, RAS"),
        ("File units = inches\n# units mm", "states 2 units of length: inch, mm"),
        ("SPACE=world", "frame 'world', which is not known"),
        ("SPACE=RAL", "frame 'RAL', which is not known"),
    ],
)
def test_what_contradicts_itself_or_is_not_known_is_refused(tmp_path, comment, what):
    obj(tmp_path / "a.obj", comment)
    with pytest.raises(CaseError, match=what) as caught:
        read_triangles(tmp_path / "a.obj")
    assert "a.obj" in caught.value.where
    assert caught.value.fix


def vtk_xml(form: str, packer: str, *, text: bytes = b"RAS\0", encoding: str = "base64") -> bytes:
    """A VTP as vtkXMLPolyDataWriter 9.7 writes its field data; only these."""
    packed = {"": text, "vtkZLibDataCompressor": zlib.compress(text), "vtkLZ4DataCompressor": b"\x40" + text}[
        packer
    ]
    head = struct.pack("<4I", 1, 32768, len(text), len(packed)) if packer else struct.pack("<I", len(text))
    coded = base64.b64encode(head) + base64.b64encode(packed) if packer else base64.b64encode(head + packed)
    inner, appended = coded, b""
    if form == "ascii":
        inner = b" ".join(str(each).encode() for each in text)
    if form == "appended":
        inner = b""
        raw = coded if encoding == "base64" else head + packed
        appended = (
            f'<AppendedData encoding="{encoding}">\n _'.encode() + b"12345678" + raw + b"</AppendedData>"
        )
    compressor = f' compressor="{packer}"' if packer else ""
    return (
        f'<VTKFile type="PolyData" byte_order="LittleEndian" header_type="UInt32"{compressor}>'
        f'<PolyData><FieldData><Array type="String" Name="SPACE" format="{form}" offset="8">'.encode()
        + inner
        + b"</Array></FieldData></PolyData>"
        + appended
        + b"</VTKFile>"
    )


@pytest.mark.parametrize("packer", ["", "vtkZLibDataCompressor", "vtkLZ4DataCompressor"])
@pytest.mark.parametrize(
    ("form", "encoding"), [("ascii", ""), ("binary", ""), ("appended", "base64"), ("appended", "raw")]
)
def test_the_frame_in_the_field_data_of_vtk_s_xml_files_is_found(tmp_path, form, encoding, packer):
    path = tmp_path / "a.vtp"
    path.write_bytes(vtk_xml(form, packer, encoding=encoding))
    assert stated_frame(path).frame == "RAS"
    path.write_bytes(path.read_bytes().replace(b'"SPACE"', b'"PLACE"'))
    assert stated_frame(path).frame == ""


def test_a_frame_that_cannot_be_decoded_is_refused(tmp_path):
    path = tmp_path / "a.vtu"
    path.write_bytes(vtk_xml("binary", "vtkZLibDataCompressor").replace(b"eJ", b"AA"))
    with pytest.raises(CaseError, match="cannot be decoded"):
        stated_frame(path)


def test_the_frame_of_a_legacy_vtk_file_may_be_in_its_field_data(tmp_path):
    path = tmp_path / "a.vtk"
    for text in (b"RAS\n", b"\xc3RAS"):  # ASCII and binary, as vtkPolyDataWriter 9.7 writes them
        path.write_bytes(b"# vtk DataFile Version 4.2\nvtk output\nBINARY\nDATASET POLYDATA\n"
                         b"FIELD FieldData 1\nSPACE 1 1 string\n" + text + b"\nPOINTS 0 float\n")  # fmt: skip
        assert stated_frame(path).frame == "RAS"


CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"


def three_mf(path: Path, unit: str, *, number: int = 1) -> None:
    """An object in a part of its own, used twice: by a component, moved; and mirrored."""
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in POINTS)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in FACES)
    mesh = f"<mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh>"
    body = f'<model xmlns="{CORE}"><resources><object id="1">{mesh}</object></resources></model>'
    component = '<component p:path="/3D/Objects/a.model" objectid="1" transform="1 0 0 0 1 0 0 0 1 1 0 0"/>'
    root = (
        f'<model xmlns="{CORE}" xmlns:p="{PRODUCTION}"{unit}><resources>'
        f'<object id="7"><components>{component}</components></object></resources><build>'
        f'<item objectid="7" transform="2 0 0 0 2 0 0 0 2 0 100 0"/><item p:path="/3D/Objects/a.model" '
        f'objectid="{number}" transform="-1 0 0 0 1 0 0 0 1 0 0 0"/></build></model>'
    )
    kind = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    with zipfile.ZipFile(path, "w") as package:
        package.writestr("_rels/.rels", f'<Relationships><Relationship Target="/3D/a.model" Type="{kind}"/>'
                                        "</Relationships>")  # fmt: skip
        package.writestr("3D/a.model", root)
        package.writestr("3D/Objects/a.model", body)


@pytest.mark.parametrize(("unit", "scale"), [("", 1.0), (' unit="inch"', 25.4), (' unit="centimeter"', 10.0)])
def test_a_3mf_is_what_is_built_in_the_unit_that_it_states(tmp_path, unit, scale):
    three_mf(tmp_path / "a.3mf", unit)
    points, faces = read_triangles(tmp_path / "a.3mf")
    np.testing.assert_allclose(points[:4], scale * (2 * (POINTS + np.array([1, 0, 0])) + [0, 100, 0]))
    np.testing.assert_allclose(points[4:], scale * POINTS * [-1, 1, 1])
    assert volume(points, faces[:4]) == pytest.approx(8 * scale**3)
    assert volume(points, faces[4:]) == pytest.approx(scale**3)


def test_a_damaged_3mf_is_refused(tmp_path):
    three_mf(tmp_path / "a.3mf", ' unit="parsec"')
    with pytest.raises(CaseError, match="'parsec', which is not known"):
        read_triangles(tmp_path / "a.3mf")
    three_mf(tmp_path / "a.3mf", "", number=5)
    with pytest.raises(OSError, match="object 5"):
        read_triangles(tmp_path / "a.3mf")
    (tmp_path / "a.3mf").write_bytes(b"PK\x03\x04 no")
    with pytest.raises(OSError, match="not a 3MF file"):
        read_triangles(tmp_path / "a.3mf")
    with pytest.raises(CaseError, match="not a 3MF file"):
        stated_frame(tmp_path / "a.3mf")
