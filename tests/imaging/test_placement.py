"""Position and directions of images and label maps: checked in one place, the same in every format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import nibabel as nib
import numpy as np
import pydicom
import pytest

from limbcli.errors import CaseError
from limbcli.imaging.dicom import read_series
from limbcli.imaging.fibre_map import read_fibre_map
from limbcli.imaging.image_files import read_image
from limbcli.imaging.label_files import read_label_file
from limbcli.imaging.volume import RAS_FROM_LPS, require_placed
from limbcli.model import Array
from tests.fuzz.targets import make_dicom

LABELS = np.zeros((6, 6, 6), np.uint8)
LABELS[1:5, 1:5, 1:5], LABELS[2:4, 2:4, 2:4] = 1, 2
_SROW = 280  # byte of the affine in a NIfTI-1 header
GOOD = np.array([[2.0, 0, 0, 5], [0, 2, 0, -7], [0, 0, 4, 30], [0, 0, 0, 1]])


def bad(change: Callable[[Array], None]) -> Array:
    affine = GOOD.copy()
    change(affine)
    return affine


def _no_length(affine: Array) -> None:
    affine[:3, 1] = 0


def _parallel(affine: Array) -> None:
    affine[:3, 1] = 1.5 * affine[:3, 0]


def _nearly_in_one_plane(affine: Array) -> None:
    affine[:3, 2] = [2.0, 2.0, 0.1]


def _not_a_number(affine: Array) -> None:
    affine[1, 1] = np.nan


def _placed_nowhere(affine: Array) -> None:
    affine[0, 3] = np.inf


WRONG = {
    "no length": (_no_length, "length 0|no size"),
    "parallel": (_parallel, "parallel"),
    "in one plane": (_nearly_in_one_plane, "in one plane"),
    "not a number": (_not_a_number, "not finite"),
    "nowhere": (_placed_nowhere, "not finite"),
}


def write_nrrd(folder: Path, affine: Array, *, origin: bool = True) -> Path:
    columns = " ".join("(" + ",".join(f"{each:.9g}" for each in column) + ")" for column in affine[:3, :3].T)
    place = "space origin: (" + ",".join(f"{each:.9g}" for each in affine[:3, 3]) + ")\n"
    head = (
        "NRRD0004\ntype: uint8\ndimension: 3\nspace: left-posterior-superior\nsizes: 6 6 6\nencoding: raw\n"
        f"space directions: {columns}\n{place if origin else ''}\n"
    )
    path = folder / "a.nrrd"
    path.write_bytes(head.encode() + LABELS.tobytes(order="F"))
    return path


def write_mha(folder: Path, affine: Array, *, origin: bool = True) -> Path:
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    with np.errstate(invalid="ignore"):
        directions = np.where(spacing > 0, affine[:3, :3] / spacing, np.eye(3))
    rows = " ".join(f"{each:.9g}" for each in directions.T.ravel())
    head = ["ObjectType = Image", "NDims = 3", "DimSize = 6 6 6", "ElementType = MET_UCHAR",
            "BinaryData = True", f"TransformMatrix = {rows}",
            "ElementSpacing = " + " ".join(f"{each:.9g}" for each in spacing)]  # fmt: skip
    if origin:
        head.append("Offset = " + " ".join(f"{each:.9g}" for each in affine[:3, 3]))
    path = folder / "a.mha"
    path.write_bytes("\n".join([*head, "ElementDataFile = LOCAL", ""]).encode() + LABELS.tobytes(order="F"))
    return path


def write_nifti(folder: Path, affine: Array, *, values: Array = LABELS) -> Path:
    image = nib.Nifti1Image(values, RAS_FROM_LPS @ GOOD)
    image.set_sform(image.affine, code=1)
    image.set_qform(None, code=0)
    content = bytearray(image.to_bytes())
    content[_SROW : _SROW + 48] = (RAS_FROM_LPS @ affine)[:3].astype("<f4").tobytes()
    path = folder / "a.nii"
    path.write_bytes(bytes(content))
    return path


def write_fibres(folder: Path, affine: Array) -> Path:
    return write_nifti(folder, affine, values=np.ones((6, 6, 6, 3), np.float32))


FORMATS = {
    "NRRD image": (write_nrrd, read_image),
    "NRRD labels": (write_nrrd, read_label_file),
    "MetaImage image": (write_mha, read_image),
    "MetaImage labels": (write_mha, read_label_file),
    "NIfTI image": (write_nifti, read_image),
    "NIfTI labels": (write_nifti, read_label_file),
    "NIfTI fibres": (write_fibres, read_fibre_map),
}


@pytest.mark.parametrize(("change", "words"), WRONG.values(), ids=WRONG)
@pytest.mark.parametrize(("write", "read"), FORMATS.values(), ids=FORMATS)
def test_a_wrong_place_is_refused_in_every_format(tmp_path: Path, write, read, change, words) -> None:
    read(write(tmp_path, GOOD))
    with np.errstate(all="ignore"), pytest.raises(CaseError, match=words) as caught:
        read(write(tmp_path, bad(change)))
    assert caught.value.fix


@pytest.mark.parametrize("read", [read_image, read_label_file])
@pytest.mark.parametrize("write", [write_nrrd, write_mha])
def test_a_missing_origin_is_not_taken_as_0(tmp_path: Path, write, read) -> None:
    with pytest.raises(CaseError, match="position in the patient") as caught:
        read(write(tmp_path, GOOD, origin=False))
    assert "origin" in caught.value.fix or "Offset" in caught.value.fix


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("TransformMatrix = 1 0 0 0 1 0 0 0 1", "TransformMatrix = 0.5 0 0 0 0.5 0 0 0 0.5"),
        ("ElementSpacing = 2 2 4", "ElementSpacing = -2 2 4"),
    ],
)
def test_directions_that_would_scale_or_mirror_a_metaimage_are_refused(tmp_path: Path, old, new) -> None:
    """ITK keeps sizes in ElementSpacing alone; a length in TransformMatrix would halve the limb."""
    path = write_mha(tmp_path, GOOD)
    content = path.read_bytes()
    assert old.encode() in content
    path.write_bytes(content.replace(old.encode(), new.encode()))
    with pytest.raises(CaseError):
        read_image(path)


@pytest.mark.parametrize("cosines", [(1, 0, 0, 1, 0, 0), (0, 0, 0, 0, 1, 0), (0.5, 0, 0, 0, 0.5, 0)])
def test_a_wrong_orientation_of_a_series_is_refused(tmp_path: Path, cosines) -> None:
    make_dicom("MR_small.dcm")(tmp_path)
    for path in tmp_path.glob("*.dcm"):
        dataset = pydicom.dcmread(path)
        dataset.ImageOrientationPatient = list(cosines)
        dataset.save_as(path)
    with pytest.raises(CaseError, match="Image Orientation"):
        read_series(tmp_path)


def test_a_sheared_grid_is_placed() -> None:
    """A gantry's tilt of 30 degrees."""
    tilted = bad(lambda affine: affine.__setitem__((1, 2), 4 * np.tan(np.radians(30))))
    assert require_placed(tilted, "a", noun="image") is not None


def test_a_damaged_header_is_not_written_to_the_terminal(
    tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    path = write_nifti(tmp_path, GOOD)
    content = bytearray(path.read_bytes())
    content[344:348] = b"\xc0\x07\x1b["
    path.write_bytes(bytes(content))
    for read in (read_image, read_label_file, read_fibre_map):
        with pytest.raises(CaseError):
            read(path)
    assert capfd.readouterr() == ("", "")
