"""Volumes as NIfTI, MGH and NRRD: the same place as the DICOM series; every refusal says what it is."""

from __future__ import annotations

import bz2
import gzip
import struct
from pathlib import Path

import nibabel as nib
import numpy as np
import pytest
from limb_images import Limb

from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.files.atomic import sha256
from limbcli.imaging.dicom import read_series
from limbcli.imaging.image_files import read_image
from limbcli.imaging.labels import write_labels
from limbcli.imaging.volume import RAS_FROM_LPS, Volume


@pytest.fixture
def image(rng) -> Volume:
    """An oblique grid: every axis of the image turns into every axis of the patient."""
    q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    affine = np.eye(4)
    affine[:3, :3] = q * [0.7, 1.1, 3.0]
    affine[:3, 3] = [-40.0, 25.0, -310.0]
    return Volume(rng.integers(0, 900, (7, 6, 5)).astype(np.int16), affine)


def nifti(image: Volume, path: Path, *, change=None, values=None, dtype=np.int16) -> Path:
    content = image.values if values is None else values
    made = nib.Nifti1Image(content.astype(dtype) if dtype else content, RAS_FROM_LPS @ image.affine)
    made.header.set_xyzt_units("mm")
    made.set_sform(RAS_FROM_LPS @ image.affine, code=1)
    made.set_qform(RAS_FROM_LPS @ image.affine, code=1)
    if change:
        change(made)
    nib.save(made, path)
    return path


def nrrd(image: Volume, path: Path, *, drop: str = "", **fields: str) -> Path:
    n = " ".join(map(str, image.values.shape))
    columns = " ".join(
        "(" + ",".join(f"{each:.9g}" for each in column) + ")" for column in image.affine[:3, :3].T
    )
    given = {
        "type": "short", "dimension": "3", "space": "left-posterior-superior", "sizes": n,
        "space directions": columns, "kinds": "domain domain domain", "endian": "little", "encoding": "gzip",
        "space origin": "(" + ",".join(f"{each:.9g}" for each in image.affine[:3, 3]) + ")",
        **{key.replace("_", " "): value for key, value in fields.items()},
    }  # fmt: skip
    head = "NRRD0004\n" + "".join(f"{key}: {value}\n" for key, value in given.items() if key != drop)
    pack = bz2.compress if given["encoding"] == "bzip2" else gzip.compress
    path.write_bytes(head.encode() + b"\n" + pack(image.values.astype("<i2").tobytes(order="F")))
    return path


def mgh(image: Volume, path: Path, *, good_ras: int = 1, n_frames: int = 1) -> Path:
    """As FreeSurfer's MghFormat describes it; what its footer holds may be missing."""
    ras = (RAS_FROM_LPS @ image.affine)[:3]
    spacing = np.linalg.norm(ras[:, :3], axis=0)
    centre = ras @ [*(np.array(image.values.shape) / 2), 1]
    shorts = 4
    head = struct.pack(">7i", 1, *image.values.shape, n_frames, shorts, 0) + struct.pack(">h", good_ras)
    head += struct.pack(">15f", *spacing, *(ras[:, :3] / spacing).T.ravel(), *centre)
    values = image.values.astype(">i2").tobytes(order="F")
    content = head.ljust(284, b"\0") + n_frames * values
    path.write_bytes(gzip.compress(content) if path.suffix == ".mgz" else content)
    return path


def pair(image: Volume, path: Path) -> Path:
    made = nib.Nifti1Pair(image.values, RAS_FROM_LPS @ image.affine)
    made.set_sform(made.affine, code=1)
    nib.save(made, path)
    return path


def same(found: Volume, wanted: Volume) -> None:
    np.testing.assert_allclose(found.affine, wanted.affine, atol=1e-4)
    np.testing.assert_array_equal(found.values, wanted.values)


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
def test_nifti_lies_where_it_was_written(image, tmp_path, name):
    found = read_image(nifti(image, tmp_path / name))
    same(found.volume, image)
    assert (found.facts["modality"], found.notes) == ("MR", ())
    np.testing.assert_allclose(found.facts["spacing_mm"], [0.7, 1.1, 3.0], atol=1e-3)


@pytest.mark.parametrize("name", ["a.mgh", "a.mgz"])
def test_mgh_lies_where_it_was_written(image, tmp_path, name):
    same(read_image(mgh(image, tmp_path / name)).volume, image)


def test_mgh_without_its_orientation_or_of_several_volumes_is_refused(image, tmp_path):
    with pytest.raises(CaseError, match=r"does not define its orientation(.|\n)*goodRASFlag is 0"):
        read_image(mgh(image, tmp_path / "a.mgz", good_ras=0))
    with pytest.raises(CaseError, match=r"3 volumes \(4-D"):
        read_image(mgh(image, tmp_path / "b.mgh", n_frames=3))


def test_a_pair_of_nifti_is_one_file_whose_values_lie_beside_it(image, tmp_path):
    path = pair(image, tmp_path / "a.hdr")
    same(read_image(path).volume, image)
    before = sha256(path)
    other = path.with_suffix(".img")
    other.write_bytes(bytes(other.stat().st_size))
    assert sha256(path) != before
    other.rename(tmp_path / "b.img")
    with pytest.raises(CaseError, match=r"the \.img of the same name, are not beside it"):
        read_image(path)


def test_analyze_is_refused_as_its_left_is_not_known(image, tmp_path):
    nib.save(nib.AnalyzeImage(image.values, np.diag([2.0, 2.0, 4.0, 1.0])), tmp_path / "a.hdr")
    with pytest.raises(CaseError, match=r"does not define its orientation(.|\n)*Analyze 7\.5(.|\n)*DICOM"):
        read_image(tmp_path / "a.hdr")


def test_nrrd_packed_by_bzip2_is_read(image, tmp_path):
    same(read_image(nrrd(image, tmp_path / "a.nrrd", encoding="bzip2")).volume, image)


def test_nrrd_lies_where_it_was_written_in_either_space(image, tmp_path):
    same(read_image(nrrd(image, tmp_path / "a.nrrd")).volume, image)
    turned = Volume(image.values, RAS_FROM_LPS @ image.affine)
    same(read_image(nrrd(turned, tmp_path / "b.nrrd", space="right-anterior-superior")).volume, image)


@pytest.mark.parametrize("code", ["qform", "sform"])
def test_one_of_both_forms_is_enough(image, tmp_path, code):
    def only(made: nib.Nifti1Image) -> None:
        if code == "qform":
            made.set_sform(None, code=0)
        else:
            made.set_qform(None, code=0)

    same(read_image(nifti(image, tmp_path / "a.nii", change=only)).volume, image)


def test_slope_and_intercept_are_taken(image, tmp_path):
    path = tmp_path / "a.nii"
    made = nib.Nifti1Image(image.values, RAS_FROM_LPS @ image.affine)
    made.set_sform(made.affine, code=1)
    made.to_filename(path)
    content = bytearray(path.read_bytes())
    content[112:120] = np.array([2.0, 10.0], "<f4").tobytes()
    path.write_bytes(bytes(content))
    stored = np.asarray(nib.load(path).dataobj.get_unscaled())
    np.testing.assert_allclose(read_image(path).volume.values, 2.0 * stored + 10.0)


def _no_place(made):
    made.set_sform(None, code=0)
    made.set_qform(None, code=0)


def _two_places(made):
    off = made.affine.copy()
    off[:3, 3] += 30.0
    made.set_sform(off, code=1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_no_place, "does not define its orientation"),
        (_two_places, "two positions, up to 51.96 mm apart: qform .code 1, the scanner's. and"),
        (lambda made: made.header.set_xyzt_units("meter"), "unit of length is meter"),
        (lambda made: made.set_sform(made.affine * 1000, code=1), "two voxel sizes|two positions"),
    ],
    ids=["no place", "two positions", "metres", "sizes"],
)
def test_a_place_that_is_not_sure_is_refused(image, tmp_path, change, message):
    with pytest.raises(CaseError, match=message) as caught:
        read_image(nifti(image, tmp_path / "a.nii", change=change))
    assert caught.value.fix


@pytest.mark.parametrize(
    ("codes", "used"), [((1, 0), "qform"), ((0, 2), "sform"), ((4, 0), "qform"), ((0, 4), "sform")]
)
def test_a_position_whose_code_is_0_does_not_count(image, tmp_path, codes, used):
    """As nibabel 5.4 and SimpleITK 2.5 read them."""
    moved = RAS_FROM_LPS @ image.affine
    moved[:3, 3] += 30.0

    def change(made):
        made.set_qform(made.affine if used == "qform" else moved, code=codes[0])
        made.set_sform(made.affine if used == "sform" else moved, code=codes[1])
        made.header["qform_code"], made.header["sform_code"] = codes

    same(read_image(nifti(image, tmp_path / "a.nii", change=change)).volume, image)


@pytest.mark.parametrize("codes", [(1, 1), (1, 2), (2, 1), (2, 4), (4, 2)])
@pytest.mark.parametrize("off", [0.3, 0.4])
def test_two_positions_may_differ_by_half_the_smallest_side_of_a_voxel(image, tmp_path, codes, off):
    """0.35 mm here, where the slices are 3 mm apart; of other codes than 1, ITK shows the qform."""

    def change(made):
        moved = made.affine.copy()
        moved[0, 3] += off
        made.set_sform(made.affine, code=codes[1])
        made.set_qform(moved, code=codes[0])

    path = nifti(image, tmp_path / "a.nii", change=change)
    if off < 0.35:
        same(read_image(path).volume, image)
    else:
        with pytest.raises(
            CaseError, match=f"0.40 mm apart: qform .code {codes[0]}, .* sform .code {codes[1]}, "
        ):
            read_image(path)


def test_several_volumes_colours_and_complex_numbers_are_refused_each_in_words(image, tmp_path):
    several = np.stack([image.values] * 3, axis=-1)
    with pytest.raises(CaseError, match=r"3 volumes \(4-D"):
        read_image(nifti(image, tmp_path / "a.nii", values=several))
    one = image.values[..., None]
    same(read_image(nifti(image, tmp_path / "b.nii", values=one)).volume, image)
    colours = np.zeros(image.values.shape, [("R", "u1"), ("G", "u1"), ("B", "u1")])
    with pytest.raises(CaseError, match="colours"):
        read_image(nifti(image, tmp_path / "c.nii", values=colours, dtype=None))
    with pytest.raises(CaseError, match="complex"):
        read_image(nifti(image, tmp_path / "d.nii", dtype=np.complex64))
    with pytest.raises(CaseError, match="2 dimensions"):
        read_image(nifti(image, tmp_path / "e.nii", values=image.values[..., 0]))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"drop": "space"}, "no field `space`"),
        ({"drop": "space directions", "spacings": "1 1 1"}, "no field `space directions`"),
        ({"space_units": '"m" "m" "m"'}, "unit of length is m"),
        ({"kinds": "RGB-color domain domain"}, "colours"),
        ({"sizes": "7 6 5 2", "dimension": "4"}, "several volumes"),
        ({"space": "scanner-xyz"}, "scanner-xyz"),
        ({"data_file": "a.raw"}, "in a separate file"),
    ],
    ids=lambda each: str(each)[:20],
)
def test_nrrd_that_is_not_one_placed_volume_is_refused(image, tmp_path, fields, message):
    with pytest.raises(CaseError, match=message) as caught:
        read_image(nrrd(image, tmp_path / "a.nrrd", **fields))
    assert "label map" not in str(caught.value)


def test_voxels_no_limb_has_and_shears_are_refused(image, tmp_path):
    small = Volume(image.values, image.affine @ np.diag([1e-3, 1e-3, 1e-3, 1]))
    with pytest.raises(CaseError, match="mm; a limb"):
        read_image(nrrd(small, tmp_path / "a.nrrd"))
    shear = np.eye(4)
    shear[0, 2] = 0.3
    with pytest.raises(CaseError, match="right angles"):
        read_image(nrrd(Volume(image.values, image.affine @ shear), tmp_path / "b.nrrd"))


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz", "a.nrrd", "a.mgh", "a.mgz", "a.hdr"])
@pytest.mark.parametrize("cut", [3, 80, 200, 400])
def test_files_that_are_cut_short_are_refused(image, tmp_path, name, cut):
    write = {".nrrd": nrrd, ".mgh": mgh, ".mgz": mgh, ".hdr": pair}.get(Path(name).suffix, nifti)
    path = write(image, tmp_path / name)
    path = path.with_suffix(".img") if name == "a.hdr" else path
    path.write_bytes(path.read_bytes()[:cut])
    path = tmp_path / name
    with pytest.raises(CaseError, match=r"cannot be read|is not a NRRD"):
        read_image(path)


def test_what_nibabel_says_of_a_damaged_header_is_not_written_to_the_terminal(image, tmp_path, caplog):
    path = nifti(image, tmp_path / "a.nii")
    content = bytearray(path.read_bytes())
    content[252:254] = (77).to_bytes(2, "little")  # qform_code
    path.write_bytes(bytes(content))
    assert nib.load(path).shape == (7, 6, 5)
    assert "qform_code 77 not valid" in caplog.text
    caplog.clear()
    assert read_image(path).volume.shape == (7, 6, 5)
    assert caplog.records == []


def test_other_files_are_refused_with_what_can_be_read(tmp_path):
    (tmp_path / "a.img").write_text("x")
    with pytest.raises(CaseError, match=r"not in a supported image format") as caught:
        read_image(tmp_path / "a.img")
    assert ".nii.gz" in caught.value.fix


def test_a_label_map_given_as_image_is_refused(tmp_path):
    drawn, labels = Limb().image(shape=(52, 46, 10), spacing=(2, 2, 4), samples=1)
    write_labels(tmp_path / "a.nii.gz", drawn.with_values(labels))
    with pytest.raises(CaseError, match=r"3 different values only.*label map(.|\n)*imaging. labels"):
        read_image(tmp_path / "a.nii.gz")


def test_values_that_are_no_numbers_are_taken_for_air_and_that_is_said(image, tmp_path):
    values = image.values.astype(np.float32)
    values[0] = np.nan
    found = read_image(nifti(image, tmp_path / "a.nii", values=values, dtype=np.float32))
    assert np.isfinite(found.volume.values).all()
    assert "14.3%" in found.notes[0]


def test_ct_is_known_by_its_air(image, tmp_path):
    air = image.values.copy()
    air[:3] = -1000
    assert read_image(nifti(image, tmp_path / "a.nii", values=air)).facts["modality"] == "CT"


def test_a_case_may_name_a_volume_file(image, tmp_path):
    from tests.case.test_case_text import two_sites

    folder = two_sites(tmp_path / "case")
    nifti(image, folder / "t1.nii.gz")
    (folder / "case.toml").write_text((folder / "case.toml").read_text().replace('"mri"', '"t1.nii.gz"'))
    assert Case.open(folder).imaging.mri == folder / "t1.nii.gz"


@pytest.mark.slow
def test_real_series_as_nifti_and_nrrd_is_the_same_image(shared: Path, tmp_path: Path):
    series = read_series(shared / "data" / "calf-mri")
    part = series.volume.with_values(series.volume.values.astype(np.int16))
    for path in (nifti(part, tmp_path / "a.nii.gz"), nrrd(part, tmp_path / "a.nrrd")):
        found = read_image(path)
        same(found.volume, part)
        assert found.facts == {**series.facts, "modality": "MR"}
