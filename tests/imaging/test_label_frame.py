"""A label map that lies elsewhere than its image is told."""

from __future__ import annotations

from pathlib import Path

import nibabel as nib
import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.imaging.label_frame import frame_problems, in_order_of, same_grid
from limbcli.imaging.nifti import read_nifti_labels
from limbcli.imaging.volume import RAS_FROM_LPS, Volume

SPACING = np.array([2.0, 2.0, 4.0])


def limb(shape=(50, 50, 30), spacing=SPACING, origin=(0.0, 0.0, 0.0)) -> Volume:
    """Labels of a tapering limb, 36 to 25 mm in radius, with a bone, round x = y = 50 mm."""
    affine = np.diag([*spacing, 1.0])
    affine[:3, 3] = origin
    grid = Volume(np.zeros(shape, np.uint8), affine)
    places = grid.to_patient(np.indices(shape).reshape(3, -1).T)
    radius = np.hypot(places[:, 0] - 50, places[:, 1] - 50)
    labels = np.where(radius < 36 - 0.09 * places[:, 2], 1, 0)
    labels[radius < 8] = 2
    return grid.with_values(labels.reshape(shape).astype(np.uint8))


@pytest.fixture
def image(rng) -> Volume:
    signal = np.choose(limb().values, [20.0, 300.0, 500.0])
    return limb().with_values(signal + rng.normal(0, 8, signal.shape))


def whats(labels: Volume, image: Volume) -> list[tuple[str, str]]:
    return [(each.severity, each.what) for each in frame_problems(labels, image, where="a")]


def test_the_image_s_own_grid_is_not_questioned_in_any_order_of_its_axes(image):
    assert same_grid(limb(), image)
    values, affine = limb().values, limb().affine
    turned = Volume(np.transpose(values, (2, 0, 1))[::-1], affine[:, [2, 0, 1, 3]].copy())
    turned.affine[:3, 3] += turned.affine[:3, 0] * (values.shape[2] - 1)
    turned.affine[:3, 0] *= -1
    assert same_grid(turned, image)
    seen = in_order_of(turned, image)
    index = np.array([[3, 20, 31], [17, 5, 40]])
    there = np.round(image.to_voxel(turned.to_patient(index.astype(float)))).astype(int)
    assert np.array_equal(seen.values[tuple(index.T)], image.values[tuple(there.T)])
    assert seen.shape == turned.shape


@pytest.mark.parametrize(
    "affine",
    [
        np.diag([2.0, 2.0, 2.0, 1.0]),
        np.diag([2.0, 2.0, -4.0, 1.0]),
        np.array([[2, 0, 0, 30], [0, 2, 0, 0], [0, 0, 4, 0], [0, 0, 0, 1.0]]),
    ],
    ids=["half the slice distance", "upside down", "moved"],
)
def test_the_image_s_matrix_at_another_place_is_an_error(image, affine):
    ((severity, what),) = whats(Volume(limb().values, affine), image)
    assert severity == "error"
    assert "a different position" in what


def test_a_grid_of_its_own_is_taken_where_it_covers_the_limb(image):
    fine = limb((110, 100, 50), np.array([1.0, 1.0, 2.0]), (0.0, 0.0, 8.0))
    assert not same_grid(fine, image)
    assert whats(fine, image) == []


def test_a_grid_of_its_own_elsewhere_is_an_error(image):
    fine = limb((100, 100, 50), np.array([1.0, 1.0, 2.0]))
    fine.affine[:3, 3] += [25.0, 0, 0]
    assert [each[0] for each in whats(fine, image)] == ["error"]
    fine.affine[:3, 3] += [0, 0, 300.0]
    ((severity, what),) = whats(fine, image)
    assert severity == "error"
    assert "outside" in what


def saved(path: Path, **header) -> Path:
    labels = limb()
    affine = RAS_FROM_LPS @ labels.affine
    nifti = nib.Nifti1Image(labels.values, affine)
    nifti.set_sform(affine, 1)
    nifti.set_qform(header.get("qform", affine), 1)
    nifti.header.set_xyzt_units(header.get("unit", "mm"))
    if "pixdim" in header:
        nifti.set_qform(None, 0)
        nifti.header["pixdim"][1:4] = header["pixdim"]
    nib.save(nifti, path)
    return path


@pytest.mark.parametrize(
    ("header", "text"),
    [
        ({"unit": "meter"}, "not mm"),
        ({"pixdim": [1.0, 1.0, 4.0]}, "two voxel sizes"),
        ({"qform": np.array([[-2, 0, 0, 40], [0, -2, 0, 0], [0, 0, 4, 0], [0, 0, 0, 1.0]])}, "two positions"),
        ({"qform": RAS_FROM_LPS @ limb().affine + 1.1 * np.eye(4, k=3)}, "1.10 mm apart"),
    ],
)
def test_a_header_that_contradicts_itself_is_refused(tmp_path, header, text):
    assert read_nifti_labels(saved(tmp_path / "good.nii.gz"))[0].shape == (50, 50, 30)
    with pytest.raises(CaseError, match=text):
        read_nifti_labels(saved(tmp_path / "a.nii.gz", **header))
