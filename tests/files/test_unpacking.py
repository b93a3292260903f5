"""What packed files unpack to is limited in every format, before memory is filled."""

from __future__ import annotations

import base64
import gzip
import struct
import zipfile
import zlib
from pathlib import Path

import nibabel as nib
import numpy as np
import pydicom
import pytest
from pydicom.uid import DeflatedExplicitVRLittleEndian

from limbcli.errors import LimbError
from limbcli.files.unpacking import UnpackingBudget, read_npz
from limbcli.imaging.dicom import read_series
from limbcli.imaging.dicom_seg import read_dicom_segments
from limbcli.imaging.fibre_map import read_fibre_map
from limbcli.imaging.image_files import read_image
from limbcli.imaging.label_files import read_label_file
from limbcli.imaging.surface import read_surface
from limbcli.measurement.ultrasound_image import read_image as read_picture
from limbcli.solvers.restart import RESTART_FILE, Restart
from limbcli.solvers.solve_folder import SolveFolder
from limbcli.surface_formats.colours import has_colours
from tests.files.test_xml_files import write_3mf
from tests.fuzz.targets import make_dicom

NRRD = (
    "NRRD0004\ntype: uint8\ndimension: 3\nspace: left-posterior-superior\nsizes: 5 5 5\nencoding: gzip\n"
    "space directions: (2,0,0) (0,2,0) (0,0,4)\nspace origin: (0,0,0)\n"
)
PLACED = np.diag([-2.0, -2.0, 4.0, 1.0])


def nrrd(folder: Path, content: bytes, more: str = "") -> Path:
    path = folder / "a.nrrd"
    path.write_bytes(f"{NRRD}{more}\n".encode() + gzip.compress(content))
    return path


def test_a_header_s_byte_skip_does_not_lift_the_limit(tmp_path: Path) -> None:
    values = bytes(range(125))
    read = read_image(nrrd(tmp_path, bytes(352) + values, "byte skip: 352\n"))
    assert read.volume.values.ravel(order="F").tolist() == list(range(125))
    with pytest.raises(LimbError, match="byte skip 20000000"):
        read_image(nrrd(tmp_path, bytes(20_000_000) + values, "byte skip: 20000000\n"))


def test_a_volume_that_unpacks_to_more_than_its_header_says_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LimbError, match="unpacks to more"):
        read_image(nrrd(tmp_path, bytes(20_000_000)))


@pytest.mark.parametrize("read", [read_image, read_label_file, read_fibre_map])
def test_a_nifti_that_unpacks_to_more_than_its_header_says_is_refused(tmp_path: Path, read) -> None:
    image = nib.Nifti1Image(np.ones((5, 5, 5, 3), np.uint8), PLACED)
    path = tmp_path / "a.nii.gz"
    path.write_bytes(gzip.compress(image.to_bytes() + bytes(20_000_000)))
    with pytest.raises(LimbError, match="unpacks to more"):
        read(path)


def test_a_nifti_header_s_extension_is_not_read_without_end(tmp_path: Path) -> None:
    content = bytearray(nib.Nifti1Image(np.ones((5, 5, 5), np.uint8), PLACED).to_bytes())
    content[348] = 1
    content[352:352] = struct.pack("<ii", 2_000_000_000, 0)
    path = tmp_path / "a.nii.gz"
    path.write_bytes(gzip.compress(bytes(content) + bytes(20_000_000)))
    with pytest.raises(LimbError, match="unpacks to more"):
        read_image(path)


def deflated(folder: Path) -> Path:
    make_dicom("MR_small.dcm")(folder)
    for path in sorted(folder.glob("*.dcm")):
        dataset = pydicom.dcmread(path)
        dataset.file_meta.TransferSyntaxUID = DeflatedExplicitVRLittleEndian
        dataset.save_as(path)
    return folder


def test_deflated_dicom_is_read_within_the_budget(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = deflated(tmp_path)
    assert read_series(folder).volume.shape == (64, 64, 4)
    monkeypatch.setattr("limbcli.files.unpacking.MOST_UNPACKED", 5000)
    with pytest.raises(LimbError, match="damaged"):
        read_series(folder)


@pytest.mark.parametrize("beyond", [-1, 0, 1, 100, 300])
def test_a_deflated_stream_is_counted_to_its_end(beyond: int) -> None:
    """Also where the last bytes are still to come out when all of the input has gone in."""
    packer = zlib.compressobj(wbits=-zlib.MAX_WBITS)
    n_bytes = (1 << 20) + beyond
    content = packer.compress(bytes(n_bytes)) + packer.flush()
    budget = UnpackingBudget(2 * n_bytes)
    budget.measure_deflated(content)
    assert budget.left == n_bytes
    with pytest.raises(zlib.error, match="ends early"):
        UnpackingBudget().measure_deflated(content[:-3])


def test_damaged_deflated_dicom_is_refused(tmp_path: Path) -> None:
    path = sorted(deflated(tmp_path).glob("*.dcm"))[1]
    content = bytearray(path.read_bytes())
    content[-2000:] = b"\xff" * 2000
    path.write_bytes(bytes(content))
    with pytest.raises(LimbError, match="damaged"):
        read_series(tmp_path)


@pytest.mark.parametrize("read", [lambda path: read_series(path.parent), read_dicom_segments, read_picture])
def test_pixels_of_a_packed_dicom_are_counted_before_they_are_decoded(tmp_path: Path, read) -> None:
    make_dicom("MR_small_RLE.dcm")(tmp_path)
    for path in tmp_path.glob("*.dcm"):
        dataset = pydicom.dcmread(path)
        dataset.Rows = dataset.Columns = 60_000
        if read is read_dicom_segments:
            dataset.Modality = "SEG"
        dataset.save_as(path)
    with pytest.raises(LimbError) as caught:
        read(tmp_path / "slice0.dcm")
    assert caught.value.fix


def vtu(folder: Path) -> Path:
    points = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], "<f8")
    parts = []
    for name, values, kind in (
        ("", points, "Float64"),
        ("connectivity", np.array([0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2], "<i8"), "Int64"),
        ("offsets", np.array([3, 6, 9, 12], "<i8"), "Int64"),
        ("types", np.full(4, 5, "u1"), "UInt8"),
    ):
        packed = zlib.compress(values.tobytes())
        head = struct.pack("<4I", 1, values.nbytes, 0, len(packed))
        coded = (base64.b64encode(head) + base64.b64encode(packed)).decode()
        shape = 'NumberOfComponents="3"' if not name else f'Name="{name}"'
        parts.append(f'<DataArray type="{kind}" {shape} format="binary">{coded}</DataArray>')
    path = folder / "a.vtu"
    path.write_text(
        '<VTKFile type="UnstructuredGrid" byte_order="LittleEndian" compressor="vtkZLibDataCompressor">'
        f"<UnstructuredGrid><Piece><Points>{parts[0]}</Points><Cells>{''.join(parts[1:])}</Cells></Piece>"
        "</UnstructuredGrid></VTKFile>"
    )
    return path


@pytest.mark.parametrize("make", [vtu, lambda folder: write_3mf(folder, "")])
def test_all_parts_of_a_surface_file_share_one_budget(tmp_path: Path, monkeypatch, make) -> None:
    """Each array of the .vtu has 96 bytes or less; together they have more than 150."""
    path = make(tmp_path)
    assert len(read_surface(path).faces) == 4
    monkeypatch.setattr("limbcli.files.unpacking.MOST_UNPACKED", 150)
    with pytest.raises(LimbError, match="unpacks to more"):
        read_surface(path)


@pytest.mark.slow
def test_a_3mf_cannot_place_objects_of_objects_without_end(tmp_path: Path) -> None:
    """Ten objects, each made of ten of the next one: ten thousand million of the last."""
    path = tmp_path / "a.3mf"
    kind = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    objects = "".join(
        f'<object id="{k}"><components>{f"""<component objectid="{k + 1}"/>""" * 10}</components></object>'
        for k in range(10)
    )
    with zipfile.ZipFile(path, "w") as package:
        package.writestr("_rels/.rels", f'<R><Relationship Target="/a.model" Type="{kind}"/></R>')
        body = f'<resources>{objects}<object id="10"/></resources><build><item objectid="0"/></build>'
        package.writestr("a.model", f"<model>{body}</model>")
    with pytest.raises(LimbError, match="places more than"):
        read_surface(path)


def test_colours_of_a_damaged_package_are_not_a_traceback(tmp_path: Path) -> None:
    path = tmp_path / "a.3mf"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as package:
        package.writestr("a.model", "<model>" + "abc" * 4000)
    content = bytearray(path.read_bytes())
    content[38:60] = b"\xff" * 22
    path.write_bytes(bytes(content))
    assert not has_colours(path)


def test_arrays_of_our_own_unpack_within_the_budget(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(100_000), b=np.zeros(100_000))
    assert set(read_npz(tmp_path / "a.npz")) == {"a", "b"}
    with pytest.raises(OSError, match="unpacks to more"):
        read_npz(tmp_path / "a.npz", budget=UnpackingBudget(1_000_000))


def test_stored_solves_that_unpack_without_end_are_solved_again(tmp_path: Path, monkeypatch) -> None:
    np.savez_compressed(tmp_path / "k-levels.npz", times=np.zeros(10_000))
    feb = tmp_path / "model.feb"
    feb.write_text("a")
    key = Restart(feb.parent, feb.read_bytes(), "").key
    arrays = {
        "key": np.array(key),
        "times": np.zeros(1),
        "u0": np.zeros((9, 3)),
        "shift0": [],
        "rotation0": [],
    }
    np.savez_compressed(tmp_path / RESTART_FILE, **arrays, more=np.zeros(10_000))
    assert Restart(feb.parent, feb.read_bytes(), "").n_stored == 1
    monkeypatch.setattr("limbcli.files.unpacking.MOST_UNPACKED", 5000)
    assert Restart(feb.parent, feb.read_bytes(), "").n_stored == 0
    assert SolveFolder(folder=tmp_path).levels("k") is None


def test_the_first_bytes_of_a_gzip_file_cost_only_themselves() -> None:
    packed = gzip.compress(bytes(1_000_000))
    budget = UnpackingBudget(100)
    assert budget.gunzip(packed, first=40) == bytes(40)
    assert budget.left == 60
    with pytest.raises(OSError, match="unpacks to more"):
        budget.gunzip(packed)
