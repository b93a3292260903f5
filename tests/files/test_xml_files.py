"""XML of others: no document type, no text overlooked, within limits; one parser for every format."""

from __future__ import annotations

import gzip
import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import nibabel as nib
import numpy as np
import pytest

from limbcli.errors import LimbError
from limbcli.feb.outline import read_outline
from limbcli.feb.read import read_feb
from limbcli.feb.runnable import runnable
from limbcli.files.xml import XmlError, mixed_text, own_text, parsed_xml
from limbcli.imaging.label_files import read_label_file
from limbcli.imaging.nifti import read_nifti_labels
from limbcli.imaging.surface import read_surface
from limbcli.surface_formats.vtk_xml import read_vtk_xml

PUNCH = Path(__file__).resolve().parents[1] / "data" / "feb" / "punch.feb"
PACKAGE = Path(__file__).resolve().parents[2] / "limbcli"
IN_ATTRIBUTE = '<!DOCTYPE x [<!ENTITY one "1">]>\n'
DEFAULTS = '<!DOCTYPE x [<!ATTLIST Nodes name CDATA "other">]>\n'
EXTERNAL = '<!DOCTYPE x SYSTEM "file:///etc/hostname">\n'
TETRAHEDRON = ((0, 0, 0), (9, 0, 0), (0, 9, 0), (0, 0, 9))
VTU = """<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian"><UnstructuredGrid>
<Piece NumberOfPoints="4" NumberOfCells="4"><Points><DataArray type="Float64" NumberOfComponents="3"
 format="ascii">0 0 0 9 0 0 {inside} 0 9 0 0 0 9</DataArray></Points><Cells>
<DataArray type="Int64" Name="connectivity" format="ascii">0 2 1 0 1 3 1 2 3 0 3 2</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">3 6 9 12</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">5 5 5 5</DataArray></Cells></Piece>
</UnstructuredGrid></VTKFile>"""


def write_feb(folder: Path, head: str) -> Path:
    path = folder / "model.feb"
    path.write_text(PUNCH.read_text().replace("<febio_spec", f"{head}<febio_spec", 1))
    return path


def write_vtu(folder: Path, head: str) -> Path:
    path = folder / "skin.vtu"
    path.write_text(head + VTU.format(inside=""))
    return path


def write_3mf(folder: Path, head: str) -> Path:
    points = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in TETRAHEDRON)
    faces = "".join(
        f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
    )
    kind = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    mesh = f"<mesh><vertices>{points}</vertices><triangles>{faces}</triangles></mesh>"
    path = folder / "skin.3mf"
    with zipfile.ZipFile(path, "w") as package:
        package.writestr("_rels/.rels", f'<R><Relationship Target="/a.model" Type="{kind}"/></R>')
        body = f'<resources><object id="1">{mesh}</object></resources><build><item objectid="1"/></build>'
        package.writestr("a.model", f"{head}<model>{body}</model>")
    return path


def write_labels(folder: Path, head: str) -> Path:
    """A NIfTI label map whose table of names is XML in its header."""
    values = np.zeros((6, 6, 6), np.uint8)
    values[1:5, 1:5, 1:5], values[2:4, 2:4, 2:4] = 1, 2
    image = nib.Nifti1Image(values, np.diag([-2.0, -2.0, 2.0, 1.0]))
    table = f'{head}<a><LabelTable><Label Key="1">muscle</Label><Label Key="2">tibia</Label></LabelTable></a>'
    image.header.extensions.append(nib.nifti1.Nifti1Extension(0, table.encode()))
    path = folder / "labels.nii.gz"
    nib.save(image, path)
    return path


READERS: dict[str, tuple[Callable[[Path, str], Path], Callable[[Path], object]]] = {
    ".feb": (write_feb, read_feb),
    ".feb, outline": (write_feb, read_outline),
    ".feb, run": (write_feb, runnable),
    ".vtu": (write_vtu, read_surface),
    ".3mf": (write_3mf, read_surface),
    "NIfTI's names": (write_labels, read_label_file),
}


@pytest.mark.parametrize("head", [IN_ATTRIBUTE, DEFAULTS, EXTERNAL, "<!DOCTYPE x>"])
@pytest.mark.parametrize(("write", "read"), READERS.values(), ids=READERS)
def test_a_document_type_is_refused_in_every_format(tmp_path: Path, write, read, head: str) -> None:
    read(write(tmp_path, ""))
    with pytest.raises(LimbError, match="document type") as caught:
        read(write(tmp_path, head))
    assert caught.value.fix


def test_an_entity_in_an_attribute_is_not_expanded(tmp_path: Path) -> None:
    """A guard that looks at the content of elements alone does not see it."""
    path = write_feb(tmp_path, '<!DOCTYPE x [<!ENTITY c "0.5">]>\n')
    path.write_text(path.read_text().replace('version="4.0"', 'version="&c;"', 1))
    with pytest.raises(LimbError, match="document type"):
        read_feb(path)


def test_a_document_type_is_seen_in_another_encoding() -> None:
    with pytest.raises(XmlError, match="document type"):
        parsed_xml('<?xml version="1.0" encoding="UTF-16"?><!DOCTYPE a><a/>'.encode("utf-16"))


def test_a_document_type_far_from_the_beginning_is_seen() -> None:
    with pytest.raises(XmlError, match="document type"):
        parsed_xml(b"<!-- " + b"a" * 200_000 + b" --><!DOCTYPE a><a/>")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("</Nodes>", "</Nodes>1,2,3"),
        ("<Nodes", "junk<Nodes"),
        ("</Material>", "</Material>0.5"),
        ("<Mesh>", "<Mesh><!-- a -->4,5"),
    ],
)
def test_text_beside_the_tags_of_a_model_is_not_passed_over(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "model.feb"
    text = PUNCH.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(LimbError, match="beside other tags") as caught:
        read_feb(path)
    assert caught.value.facts["line"] > 0


@pytest.mark.parametrize(
    "inside", ["<!-- two of four -->", '<InformationKey name="L2"><Value>7</Value></InformationKey>']
)
def test_numbers_after_a_tag_in_an_array_count(tmp_path: Path, inside: str) -> None:
    """VTK writes `InformationKey` into an array; the numbers after it belong to the array, too."""
    path = tmp_path / "skin.vtu"
    path.write_text(VTU.format(inside=inside))
    points, faces = read_vtk_xml(path)
    assert points.tolist() == [list(map(float, each)) for each in TETRAHEDRON]
    assert sum(map(len, faces)) == 4


def test_names_around_a_comment_are_whole(tmp_path: Path) -> None:
    path = write_labels(tmp_path, "")
    assert read_nifti_labels(path)[1] == {1: "muscle", 2: "tibia"}
    assert own_text(parsed_xml(b"<Label>left<!-- a --> tibia</Label>")) == "left tibia"


def test_long_texts_are_read_but_not_elements_without_end() -> None:
    assert len(parsed_xml(b"<a>" + b"1" * 11_000_000 + b"</a>").text or "") == 11_000_000
    for n_deep in (300, 3000):
        with pytest.raises(XmlError, match=r"[dD]eep|depth"):
            parsed_xml(b"<a>" * n_deep + b"</a>" * n_deep)


def test_a_document_beyond_the_limit_is_refused_unread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("limbcli.files.xml.LARGEST", 100)
    with pytest.raises(XmlError, match="larger"):
        parsed_xml(b"<a>" + b" " * 100 + b"</a>")


def test_text_beside_tags_is_found_with_its_owner() -> None:
    assert mixed_text(parsed_xml(b"<a> <b>1</b> \n <b>2</b></a>")) is None
    owner, text = mixed_text(parsed_xml(b"<a><b><c/> x </b></a>")) or (None, "")
    assert owner is not None
    assert (owner.tag, text) == ("b", "x")


def test_nothing_else_in_the_package_parses_xml() -> None:
    """Every reader goes through `parsed_xml`; `etree` may still make elements and write them."""
    parses = re.compile(
        r"\.(fromstring|parse|XML|iterparse|XMLParser)\(|minidom|pyexpat|xml\.sax\.(?!saxutils)"
    )
    found = [
        str(path.relative_to(PACKAGE))
        for path in sorted(PACKAGE.rglob("*.py"))
        if path != PACKAGE / "files" / "xml.py" and parses.search(path.read_text(encoding="utf-8"))
    ]
    assert found == []


def test_a_packed_header_as_large_as_it_likes_is_not_read(tmp_path: Path) -> None:
    path = write_labels(tmp_path, "")
    content = bytearray(nib.load(path).to_bytes())
    struct.pack_into("<f", content, 108, 3e9)  # vox_offset
    path.write_bytes(gzip.compress(bytes(content)))
    with pytest.raises(LimbError, match="begin at byte"):
        read_label_file(path)
