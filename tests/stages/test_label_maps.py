"""Cases with label maps of segmentation programs: the same limb as with ours."""

from __future__ import annotations

import shutil
from pathlib import Path

import nibabel as nib
import numpy as np
import pytest

from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.stages.check import check
from limbcli.stages.segment import segment
from limbcli.stages.segmenting.label_maps import labelled_limb
from tests.conftest import REPOSITORY

pytestmark = pytest.mark.usefixtures("coarse")
CASE = REPOSITORY / "cases" / "phantom"


@pytest.fixture(scope="module")
def ours(tmp_path_factory) -> Path:
    """The label map of the phantom's own series, in our numbers."""
    from limbcli.imaging.image_files import read_image
    from limbcli.imaging.labels import write_labels
    from limbcli.imaging.segmentation import segment_limb

    path = tmp_path_factory.mktemp("ours") / "labels.nii.gz"
    write_labels(path, segment_limb(read_image(CASE / "mri").volume).labels)
    return path


def written(path: Path, ours: Path, change) -> Path:
    image = nib.load(ours)
    values = change(np.asarray(image.dataobj).astype(np.int16))
    header = image.header.copy()
    header.set_data_dtype(np.int16)
    nib.save(nib.Nifti1Image(values, image.affine, header), path)
    return path


def numbered(numbers):
    def change(values):
        return np.select([values == each for each in numbers], list(numbers.values()), 0).astype(np.int16)

    return change


def muscles_and_bones(values):
    """What a program for muscles gives: nothing within about 8 mm of the skin."""
    from scipy import ndimage

    inner = ndimage.binary_erosion(np.isin(values, (1, 2, 4)), np.ones((3, 3, 1)), iterations=4)
    return np.select([values == 2, (values == 1) & inner], [8151, 8131], 0).astype(np.int16)


def case_of(folder: Path, labels: str, *, mri: bool) -> Path:
    shutil.copytree(CASE, folder)
    text = (folder / "case.toml").read_text()
    (folder / "case.toml").write_text(text.replace('mri = "mri"', ('mri = "mri"\n' if mri else "") + labels))
    return folder


TABLE = 'labels = { file = "map.nii.gz", 7101 = "soft tissue", 8151 = "bone", 77 = "marker", 9 = "fat" }'
OWN = {1: 7101, 2: 8151, 3: 77, 4: 9}


@pytest.mark.slow
def test_a_map_with_its_own_numbers_is_read_as_ours_voxel_for_voxel(ours, tmp_path):
    first = case_of(tmp_path / "first", 'labels = "map.nii.gz"', mri=False)
    shutil.copyfile(ours, first / "map.nii.gz")
    second = case_of(tmp_path / "second", TABLE, mri=False)
    written(second / "map.nii.gz", ours, numbered(OWN))
    a, b = (labelled_limb(case, side=case.limb) for case in (Case.open(first), Case.open(second)))
    assert np.array_equal(a.found.labels.values, b.found.labels.values)
    assert len(a.found.bones) == len(b.found.bones) == 2
    for one, other in zip(a.found.bones, b.found.bones, strict=True):
        assert np.array_equal(one.values, other.values)
    assert "map.nii.gz: taken for bone: 8151" in b.lines


@pytest.mark.slow
def test_check_says_what_each_number_is_taken_for(ours, tmp_path):
    folder = case_of(tmp_path / "case", TABLE, mri=False)
    written(folder / "map.nii.gz", ours, numbered(OWN))
    found = check(folder)
    assert not [each.what for each in found.problems if each.severity == "error"]
    assert "map.nii.gz" in found.looked_at
    assert "map.nii.gz: taken for soft tissue: 7101" in found.shown
    assert len(found.shown) == len(set(found.shown))
    (folder / "case.toml").write_text((folder / "case.toml").read_text().replace("8151", "8152"))
    (said,) = (each for each in check(folder).problems if each.severity == "error")
    assert "8151" in said.what


@pytest.mark.slow
def test_muscles_and_bones_get_the_rest_of_the_limb_from_the_image(ours, tmp_path):
    table = 'labels = { file = "map.nii.gz", preset = "musclemap-1" }'
    folder = case_of(tmp_path / "case", table, mri=True)
    written(folder / "map.nii.gz", ours, muscles_and_bones)
    case = Case.open(folder)
    limb = labelled_limb(case, side=case.limb)
    wanted = np.asarray(nib.load(ours).dataobj)
    assert np.array_equal(limb.found.labels.values, wanted)
    assert any("taken from the image" in line for line in limb.lines)
    assert not limb.problems


@pytest.mark.slow
def test_a_map_of_a_part_of_the_image_still_gets_the_whole_limb_around_it(ours, tmp_path):
    """Bones drawn within a region of interest whose sides lie within the limb."""
    table = 'labels = { file = "map.nii.gz", preset = "musclemap-1" }'
    folder = case_of(tmp_path / "case", table, mri=True)
    image = nib.load(ours)
    wanted = np.asarray(image.dataobj)
    i, j, k = np.nonzero(wanted == 2)
    part = slice(i.min(), i.max() + 1), slice(j.min(), j.max() + 1), slice(k.min() + 2, k.max() - 1)
    bones = image.slicer[part]
    drawn = np.where(np.asarray(bones.dataobj) == 2, 8151, 0).astype(np.int16)
    nib.save(nib.Nifti1Image(drawn, bones.affine), folder / "map.nii.gz")
    case = Case.open(folder)
    limb = labelled_limb(case, side=case.limb)
    (cut,) = limb.problems
    low, high = np.nonzero(np.isin(wanted, (1, 2, 4)).any(axis=(0, 1)))[0][[0, -1]]
    below, above = (part[2].start - low) * 4.0, (high - part[2].stop + 1) * 4.0
    assert (
        f"goes on {below:.0f} mm distally and {above:.0f} mm proximally of the label map's grid" in cut.what
    )
    assert cut.severity == "warning"
    found = limb.found.labels
    for axis in (0, 1):
        assert not np.isin(np.take(found.values, [0, -1], axis), (1, 2, 4)).any()
    for number in (1, 2, 4):
        assert (found.values == number).sum() == (wanted[:, :, part[2]] == number).sum()
    assert len(limb.found.bones) == 2


@pytest.mark.slow
def test_muscles_and_bones_without_an_image_are_warned_of(ours, tmp_path):
    table = 'labels = { file = "map.nii.gz", preset = "musclemap-1" }'
    folder = case_of(tmp_path / "case", table, mri=False)
    written(folder / "map.nii.gz", ours, muscles_and_bones)
    case = Case.open(folder)
    (said,) = labelled_limb(case, side=case.limb).problems
    assert said.severity == "warning"
    assert "neither skin nor soft tissue" in said.what


@pytest.mark.slow
def test_a_map_that_lies_beside_the_limb_is_refused(ours, tmp_path):
    table = 'labels = { file = "map.nii.gz", preset = "musclemap-1" }'
    folder = case_of(tmp_path / "case", table, mri=True)
    written(folder / "map.nii.gz", ours, lambda values: np.roll(muscles_and_bones(values), 30, axis=0))
    case = Case.open(folder)
    with pytest.raises(CaseError, match="outside the limb in the image"):
        segment(case, out=tmp_path / "out")


@pytest.mark.slow
def test_the_calf_in_the_numbers_of_programs_is_the_calf(shared: Path, tmp_path: Path):
    """Real MRI: muscles and bones as MuscleMap numbers them, bones alone as TotalSegmentator names them."""
    from limbcli.imaging.bones import name_bones
    from limbcli.imaging.dicom import read_series
    from limbcli.imaging.labels import write_labels
    from limbcli.imaging.segmentation import segment_limb

    series = tmp_path / "mri"  # a third of its slices, from the middle
    series.mkdir()
    for path in sorted((shared / "data" / "calf-mri").glob("*.dcm"))[20:40]:
        shutil.copy(path, series)
    found = segment_limb(read_series(series).volume)
    assert name_bones(found.bones) == ("tibia", "fibula")
    write_labels(tmp_path / "ours.nii.gz", found.labels)
    bones = tmp_path / "bones"
    bones.mkdir()
    turned, order, flipped = found.labels.along_limb()
    assert turned.shape == found.bones[0].shape
    assert (order, flipped) == ((0, 1, 2), False)
    for name, bone in zip(("tibia", "fibula"), found.bones, strict=True):
        written(
            bones / f"{name}.nii.gz",
            tmp_path / "ours.nii.gz",
            lambda _, mask=bone: mask.values.astype(np.int16),
        )
    written(bones / "patella.nii.gz", tmp_path / "ours.nii.gz", lambda values: np.zeros_like(values))
    written(tmp_path / "mm.nii.gz", tmp_path / "ours.nii.gz", muscles_and_bones)
    head = '[subject]\nid = "S1"\nlimb = "right"\n[files]\nallow_outside = true\n'
    labels = 'labels = [{ file = "mm.nii.gz", preset = "musclemap-1" }, "bones"]'
    text = f'format = 1\n{head}[imaging]\nmri = "{series.as_posix()}"\n{labels}\n'
    (tmp_path / "case.toml").write_text(text)
    case = Case.open_images(tmp_path)
    limb = labelled_limb(case, side=case.limb)
    assert np.array_equal(limb.found.labels.values, found.labels.values)
    assert limb.found.bone_names[:2] == ("tibia", "fibula")
