"""DICOM series to volumes: order, geometry, signal, and what must be refused."""

from __future__ import annotations

import json

import numpy as np
import pydicom
import pytest
from limb_images import write_dicom
from pydicom.uid import ImplicitVRLittleEndian, RLELossless
from scipy.spatial.transform import Rotation

from limbcli.errors import CaseError
from limbcli.imaging.dicom import read_series
from limbcli.imaging.volume import Volume


@pytest.fixture
def ramp(rng):
    """A volume whose every voxel differs, on an oblique grid with uneven spacing."""
    values = rng.permutation(9 * 7 * 5).reshape(9, 7, 5).astype(np.float32)
    affine = np.eye(4)
    affine[:3, :3] = Rotation.from_euler("xyz", [12, -8, 20], degrees=True).as_matrix() * [0.6, 0.9, 3.0]
    affine[:3, 3] = [-40.0, 22.5, -310.25]
    return Volume(values, affine)


def test_slices_are_sorted_by_position_and_the_oblique_affine_is_right(ramp, tmp_path):
    write_dicom(tmp_path, ramp)
    series = read_series(tmp_path)
    assert np.array_equal(series.volume.values, ramp.values)
    np.testing.assert_allclose(series.volume.affine, ramp.affine, atol=1e-6)


def test_rescale_slope_and_intercept_are_applied_slice_by_slice(ramp, tmp_path):
    def own_slope(dataset, k):
        dataset.RescaleSlope, dataset.RescaleIntercept = str(k + 1), "-3"

    write_dicom(tmp_path, ramp, change=own_slope)
    expected = ramp.values * np.arange(1, 6) - 3
    np.testing.assert_allclose(read_series(tmp_path).volume.values, expected, rtol=1e-6)


def test_implicit_transfer_syntax_gives_the_same_values(ramp, tmp_path):
    write_dicom(tmp_path, ramp, syntax=ImplicitVRLittleEndian)
    assert np.array_equal(read_series(tmp_path).volume.values, ramp.values)


def test_compressed_pixels_are_decoded(ramp, tmp_path):
    write_dicom(tmp_path, ramp, change=lambda dataset, k: dataset.compress(RLELossless))
    assert np.array_equal(read_series(tmp_path).volume.values, ramp.values)


def test_files_that_are_no_dicom_are_passed_over(ramp, tmp_path):
    write_dicom(tmp_path, ramp)
    (tmp_path / "LICENSE").write_text("free " * 400)
    (tmp_path / "empty.dcm").write_bytes(b"")
    assert read_series(tmp_path).facts["n_slices"] == 5


def test_a_series_uid_per_image_is_one_series_with_a_note(ramp, tmp_path):
    def own_uid(dataset, k):
        dataset.SeriesInstanceUID = f"1.2.3.{k}"

    write_dicom(tmp_path, ramp, change=own_uid)
    series = read_series(tmp_path)
    assert series.facts["n_slices"] == 5
    assert any("0020,000E" in note for note in series.notes)


def test_nothing_identifying_leaves_the_series(ramp, tmp_path):
    write_dicom(tmp_path, ramp)
    series = read_series(tmp_path)
    text = json.dumps([dict(series.facts), *series.notes])
    for secret in ("Secret", "4711", "1970", "Hidden"):
        assert secret not in text


def refused(folder):
    with pytest.raises(CaseError) as caught:
        read_series(folder)
    assert caught.value.fix
    return caught.value


def test_a_missing_slice_is_told_with_its_place(ramp, tmp_path):
    write_dicom(tmp_path, ramp, skip=(2,))
    error = refused(tmp_path)
    assert "missing" in error.what
    assert error.facts["n_missing"] == 1


def test_doubled_slices_are_told(ramp, tmp_path):
    write_dicom(tmp_path, ramp)
    write_dicom(tmp_path, ramp, stem="again")
    assert refused(tmp_path).facts["n_doubled"] == 5


def test_two_series_in_one_folder_are_told(ramp, tmp_path):
    write_dicom(tmp_path, ramp, series=3)
    write_dicom(tmp_path, ramp, series=4, stem="other")
    error = refused(tmp_path)
    assert error.facts["n_series"] == 2
    assert "series 3" in error.what


def test_no_pixel_data_is_told(ramp, tmp_path):
    def strip(dataset, k):
        del dataset.PixelData

    write_dicom(tmp_path, ramp, change=strip)
    assert "pixel data" in refused(tmp_path).what


def test_no_dicom_at_all_and_no_folder_are_told(tmp_path):
    (tmp_path / "notes.txt").write_text("no image here")
    assert "no DICOM" in refused(tmp_path).what
    assert "does not exist" in refused(tmp_path / "absent").what


def test_slices_that_are_not_parallel_are_told(ramp, tmp_path):
    def tilt(dataset, k):
        if k == 3:
            dataset.ImageOrientationPatient = ["1", "0", "0", "0", "1", "0"]

    write_dicom(tmp_path, ramp, change=tilt)
    assert refused(tmp_path).facts["n_not_parallel"] == 1


@pytest.mark.parametrize(
    ("keyword", "tag"),
    [
        ("ImageOrientationPatient", "0020,0037"),
        ("ImagePositionPatient", "0020,0032"),
        ("PixelSpacing", "0028,0030"),
    ],
)
def test_an_absent_geometry_tag_is_named(ramp, tmp_path, keyword, tag):
    def strip(dataset, k):
        if k == 1:
            del dataset[keyword]

    write_dicom(tmp_path, ramp, change=strip)
    assert tag in refused(tmp_path).what


def test_images_of_another_size_are_told(ramp, tmp_path):
    def shrink(dataset, k):
        if k == 0:
            rows = dataset.pixel_array[:4]
            dataset.Rows, dataset.PixelData = 4, np.ascontiguousarray(rows).tobytes()

    write_dicom(tmp_path, ramp, change=shrink)
    assert "differ in size" in refused(tmp_path).what


def test_a_truncated_file_is_told(ramp, tmp_path):
    def cut(dataset, k):
        if k == 0:
            dataset.PixelData = dataset.PixelData[:20]

    write_dicom(tmp_path, ramp, change=cut)
    assert "decoded" in refused(tmp_path).what


def test_the_written_series_is_valid_dicom(ramp, tmp_path):
    path = write_dicom(tmp_path, ramp)[0]
    assert pydicom.dcmread(path).pixel_array.shape == (7, 9)
