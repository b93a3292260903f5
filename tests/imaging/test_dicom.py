"""DICOM series to volumes: order, geometry, signal, and what must be refused."""

from __future__ import annotations

import json

import numpy as np
import pydicom
import pytest
from limb_images import without_meta, write_dicom
from pydicom.uid import (
    ExplicitVRLittleEndian,
    ImplicitVRLittleEndian,
    JPEG2000Lossless,
    RLELossless,
    RTStructureSetStorage,
)
from scipy.spatial.transform import Rotation

from limbcli.errors import CaseError
from limbcli.imaging.dicom import read_series
from limbcli.imaging.image_files import read_image
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


@pytest.mark.parametrize(
    "syntax", [ImplicitVRLittleEndian, ExplicitVRLittleEndian], ids=["implicit", "explicit"]
)
def test_plain_datasets_without_preamble_and_file_meta_are_read(ramp, tmp_path, syntax):
    for path in write_dicom(tmp_path, ramp):
        without_meta(path, syntax)
    assert np.array_equal(read_series(tmp_path).volume.values, ramp.values)


def test_a_file_that_only_lacks_the_preamble_is_read(ramp, tmp_path):
    for path in write_dicom(tmp_path, ramp, syntax=ImplicitVRLittleEndian):
        path.write_bytes(path.read_bytes()[132:])
    assert np.array_equal(read_series(tmp_path).volume.values, ramp.values)


def test_compressed_pixels_of_an_unstated_syntax_are_told(ramp, tmp_path):
    for path in write_dicom(tmp_path, ramp, change=lambda dataset, k: dataset.compress(RLELossless)):
        dataset = pydicom.dcmread(path)
        del dataset.file_meta.TransferSyntaxUID
        pydicom.dcmwrite(path, dataset, implicit_vr=False, little_endian=True)
    error = refused(tmp_path)
    assert "pip" not in error.fix
    assert "how its pixels are compressed" in error.fix


@pytest.mark.parametrize("syntax", [RLELossless, JPEG2000Lossless], ids=["RLE", "JPEG 2000"])
def test_compressed_pixels_are_decoded(ramp, tmp_path, syntax):
    wide = Volume(np.tile(ramp.values, (8, 8, 1)), ramp.affine)  # JPEG 2000 wants some pixels
    write_dicom(tmp_path, wide, change=lambda dataset, k: dataset.compress(syntax))
    assert np.array_equal(read_series(tmp_path).volume.values, wide.values)


def test_files_that_are_no_dicom_are_passed_over(ramp, tmp_path):
    write_dicom(tmp_path, ramp)
    (tmp_path / "LICENSE").write_text("free " * 400)
    (tmp_path / "empty.dcm").write_bytes(b"")
    assert read_series(tmp_path).facts["n_slices"] == 5


def test_contours_beside_the_images_are_told(ramp, tmp_path):
    extra = pydicom.dcmread(write_dicom(tmp_path, ramp)[0])
    del extra.PixelData, extra.Rows
    extra.Modality, extra.file_meta.MediaStorageSOPClassUID = "RTSTRUCT", RTStructureSetStorage
    extra.save_as(tmp_path / "rtss.dcm")
    series = read_series(tmp_path)
    assert series.facts["n_slices"] == 5
    assert any("1 RTSTRUCT; to use the contours, give the file as" in note for note in series.notes)


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


def test_identity_in_nested_private_sequences_stays_behind_too(ramp, tmp_path):
    def planted(dataset, k):
        inner, outer = pydicom.Dataset(), pydicom.Dataset()
        inner.private_block(0x11, "VENDOR", create=True).add_new(1, "PN", "Nested^Secret")
        outer.private_block(0x13, "VENDOR", create=True).add_new(2, "SQ", [inner])
        dataset.private_block(0x15, "VENDOR", create=True).add_new(3, "SQ", [outer])
        if k == 2:
            dataset.FrameOfReferenceUID = "1.2.3"

    write_dicom(tmp_path, ramp, change=planted)
    series = read_series(tmp_path)
    assert "Secret" not in json.dumps([dict(series.facts), *series.notes])
    (tmp_path / "extra.dcm").write_bytes(next(tmp_path.glob("*_1.dcm")).read_bytes()[:-40])
    assert "Secret" not in str(refused(tmp_path))


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


def test_images_of_two_contrasts_in_one_series_are_told_apart(ramp, tmp_path):
    """Dixon's method: water and fat have the same places, and often one series."""
    for stem, kind in (("w", "W"), ("f", "F")):
        write_dicom(tmp_path, ramp, stem=stem, change=lambda dataset, _, kind=kind: named(dataset, kind))
    fix = refused(tmp_path).fix
    n = ramp.shape[2]
    assert (
        f"differ in Image Type (0008,0008): DERIVED, PRIMARY, W ({n} images), DERIVED, PRIMARY, F" in fix
        or (f"DERIVED, PRIMARY, F ({n} images), DERIVED, PRIMARY, W ({n} images)" in fix)
    )


def named(dataset, kind):
    dataset.ImageType = ["DERIVED", "PRIMARY", kind]
    dataset.SeriesInstanceUID = "1.2.3"


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
    (tmp_path / "anat").mkdir()
    (tmp_path / "anat" / "leg_T1w.nii.gz").write_bytes(b"")
    assert "the folder holds anat/leg_T1w.nii.gz" in refused(tmp_path).fix


def test_one_file_of_a_series_stands_for_its_folder(ramp, tmp_path):
    first = write_dicom(tmp_path, ramp)[0]
    assert f"names the file {first.name} alone" in refused(first).fix


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
        ("BitsAllocated", "0028,0100"),
        ("PixelRepresentation", "0028,0103"),
    ],
)
def test_an_absent_tag_that_is_needed_is_named(ramp, tmp_path, keyword, tag):
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
    assert "truncated" in refused(tmp_path).fix


def test_the_written_series_is_valid_dicom(ramp, tmp_path):
    path = write_dicom(tmp_path, ramp)[0]
    assert pydicom.dcmread(path).pixel_array.shape == (7, 9)


def test_monochrome1_is_turned_over(ramp, tmp_path):
    def turn(dataset, k):
        dataset.PhotometricInterpretation = "MONOCHROME1"

    write_dicom(tmp_path, ramp, change=turn)
    series = read_series(tmp_path)
    assert np.array_equal(series.volume.values, ramp.values.max() - ramp.values)
    assert any("inverted" in note for note in series.notes)


@pytest.mark.parametrize("padding", [-32768, 32767])
def test_padding_beside_the_picture_is_as_dark_as_its_air(ramp, tmp_path, padding):
    def padded(dataset, _):
        pixels = dataset.pixel_array.astype("<i2")
        pixels[:2] = padding
        dataset.PixelRepresentation, dataset.PixelData = 1, pixels.tobytes()
        dataset.BitsStored, dataset.HighBit = 16, 15
        dataset.add_new("PixelPaddingValue", "SS", padding)

    write_dicom(tmp_path, ramp, change=padded)
    values = read_series(tmp_path).volume.values
    assert np.array_equal(values[:, 2:], ramp.values[:, 2:])
    assert (values[:, :2] == ramp.values[:, 2:].min(axis=(0, 1))).all()


@pytest.mark.parametrize("kind", ["Float", "DoubleFloat"])
def test_pixels_stored_as_floats_are_read_and_what_is_no_number_is_dark(ramp, tmp_path, kind):
    def floats(dataset, _):
        pixels = dataset.pixel_array.astype("<f4" if kind == "Float" else "<f8") + 0.25
        pixels[:2], pixels[2:3] = np.nan, -1e30
        for keyword in ("PixelData", "PixelRepresentation", "BitsStored", "HighBit"):
            delattr(dataset, keyword)
        dataset.BitsAllocated = 8 * pixels.itemsize
        setattr(dataset, f"{kind}PixelData", pixels.tobytes())
        setattr(dataset, f"{kind}PixelPaddingValue", -1e30)

    write_dicom(tmp_path, ramp, change=floats)
    values = read_series(tmp_path).volume.values
    assert np.array_equal(values[:, 3:], ramp.values[:, 3:] + 0.25)
    assert (values[:, :3] == values[:, 3:].min(axis=(0, 1))).all()


def test_monochrome1_of_floats_turns_fractions_over_too(ramp, tmp_path):
    def turned(dataset, _):
        pixels = dataset.pixel_array.astype("<f4") / 512
        for keyword in ("PixelData", "PixelRepresentation", "BitsStored", "HighBit"):
            delattr(dataset, keyword)
        dataset.BitsAllocated, dataset.FloatPixelData = 32, pixels.tobytes()
        dataset.PhotometricInterpretation = "MONOCHROME1"

    write_dicom(tmp_path, ramp, change=turned)
    assert np.array_equal(read_series(tmp_path).volume.values, (ramp.values.max() - ramp.values) / 512)


def test_monochrome1_of_ct_concerns_the_display_only(ramp, tmp_path):
    def turn(dataset, k):
        dataset.PhotometricInterpretation, dataset.Modality = "MONOCHROME1", "CT"

    write_dicom(tmp_path, ramp, change=turn)
    assert np.array_equal(read_series(tmp_path).volume.values, ramp.values)


@pytest.mark.parametrize("keyword", ["SamplesPerPixel", "PhotometricInterpretation", "BitsStored", "HighBit"])
def test_an_absent_storage_tag_that_is_clear_is_filled_in(ramp, tmp_path, keyword):
    write_dicom(tmp_path, ramp, change=lambda dataset, k: delattr(dataset, keyword))
    assert np.array_equal(read_series(tmp_path).volume.values, ramp.values)


def test_a_patients_name_in_a_file_name_does_not_reach_a_message(ramp, tmp_path):
    write_dicom(tmp_path, ramp, stem="SECRET_Name_", skip=(2,))
    message = str(refused(tmp_path))
    assert "missing" in message
    assert "file 3 in order of name" in message
    assert "secret" not in message.lower().replace(str(tmp_path).lower(), "")


def test_signed_and_8_bit_values_are_read(ramp, tmp_path):
    signed = ramp.with_values(ramp.values - 100)
    write_dicom(tmp_path / "signed", signed, signed=True)
    assert np.array_equal(read_series(tmp_path / "signed").volume.values, signed.values)
    small = ramp.with_values(np.floor(ramp.values / 2))
    write_dicom(tmp_path / "small", small, bits=8)
    assert np.array_equal(read_series(tmp_path / "small").volume.values, small.values)


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("above", [4, 2, 0])
def test_values_are_read_from_where_high_bit_says_that_they_lie(ramp, tmp_path, signed, above):
    """12 bits in words of 16; 0: they lie lowest, and the tag is wrong."""
    values = ramp.with_values(8 * ramp.values - 1000 * signed)

    def moved(dataset, _):
        words = np.frombuffer(dataset.PixelData, "<i2" if signed else "<u2") << above
        dataset.PixelData = words.tobytes()
        dataset.BitsStored, dataset.HighBit = 12, 11 + (above or 4)

    write_dicom(tmp_path, values, signed=signed, change=moved)
    assert np.array_equal(read_series(tmp_path).volume.values, values.values)


@pytest.mark.parametrize(
    ("keyword", "value", "tag"),
    [
        ("PhotometricInterpretation", "RGB", "0028,0004"),
        ("Modality", "US", "0008,0060"),
        ("ImageOrientationPatient", ["1", "0", "0", "1", "0", "0"], "0020,0037"),
        ("PixelSpacing", ["0", "1"], "0028,0030"),
        ("PixelSpacing", ["100", "100"], "0028,0030"),
    ],
)
def test_a_wrong_tag_is_named(ramp, tmp_path, keyword, value, tag):
    write_dicom(tmp_path, ramp, change=lambda dataset, k: setattr(dataset, keyword, value))
    assert tag in refused(tmp_path).what


def test_uneven_slice_distances_are_made_even_and_said(ramp, tmp_path):
    heights = np.array([0.0, 3.0, 6.6, 9.0, 12.0])
    normal = ramp.affine[:3, 2] / ramp.spacing[2]

    def move(dataset, k):
        dataset.ImagePositionPatient = [f"{x:.9g}" for x in ramp.affine[:3, 3] + heights[k] * normal]

    write_dicom(tmp_path, ramp, change=move)
    series = read_series(tmp_path)
    assert any("even" in note for note in series.notes)
    expected = ramp.values[:, :, 1] + (ramp.values[:, :, 2] - ramp.values[:, :, 1]) * 3.0 / 3.6
    np.testing.assert_allclose(series.volume.values[:, :, 2], expected, rtol=1e-5)


def coarser_above(ramp, folder, *, numbers):
    """A series of 2.5 mm below and 7.5 mm above; returns the values and affine every 2.5 mm."""
    fine = np.repeat(np.arange(31.0)[None, None], 9, axis=0).repeat(7, axis=1)
    affine = ramp.affine.copy()
    affine[:3, 2] *= 2.5 / 3.0
    kept = [*range(16), *range(18, 31, 3)]
    skipped = tuple(k for k in range(31) if k not in kept)

    def number(dataset, k):
        dataset.InstanceNumber = numbers(kept.index(k), k)

    write_dicom(folder, Volume(fine.astype(np.float32), affine), change=number, skip=skipped)
    return fine, affine


def test_a_spacing_that_changes_within_a_series_is_resampled_to_the_narrow_one_and_said(ramp, tmp_path):
    fine, affine = coarser_above(ramp, tmp_path, numbers=lambda place, k: place + 1)
    series = read_series(tmp_path)
    np.testing.assert_allclose(series.volume.values, fine, atol=1e-4)
    np.testing.assert_allclose(series.volume.affine, affine, atol=1e-4)
    assert any("from 2.50 to 7.50 mm; resampled every 2.50 mm" in note for note in series.notes)


def test_gaps_that_the_numbers_skip_too_are_missing_slices(ramp, tmp_path):
    coarser_above(ramp, tmp_path, numbers=lambda place, k: k + 1)
    error = refused(tmp_path)
    assert error.facts["n_missing"] == 10
    assert "0020,0013" in error.fix


def test_gantry_tilt_is_straightened(tmp_path):
    """A straight bar seen by sheared slices comes out straight, in its place."""
    shape, spacing, drift = (40, 20, 8), (1.0, 1.0, 4.0), 2.0
    values = np.zeros(shape, np.float32)
    for k in range(shape[2]):
        values[24 - int(drift) * k : 30 - int(drift) * k, 6:12, k] = 500
    affine = np.diag([*spacing, 1.0])
    affine[0, 2] = drift
    volume = Volume(values, affine)
    write_dicom(tmp_path, volume)
    series = read_series(tmp_path)
    assert any("tilt" in note for note in series.notes)
    straight = series.volume
    np.testing.assert_allclose(straight.affine[:3, :3], np.diag(spacing), atol=1e-6)
    bar = straight.to_patient(np.argwhere(straight.values > 250).astype(float))
    assert (bar[:, 0].min(), bar[:, 0].max()) == pytest.approx((24.0, 29.0))
    assert len(bar) == (values > 250).sum()


def moved_aside(volume, aside):
    """Change of a slice's place along its rows (mm), by its number."""

    def change(dataset, k):
        place = volume.affine[:3, 3] + k * volume.affine[:3, 2] + [aside(k), 0.0, 0.0]
        dataset.ImagePositionPatient = [f"{x:.9g}" for x in place]

    return change


def test_slices_beside_the_line_of_the_others_are_put_in_their_place(tmp_path):
    """The first and the last slice agree: only those between tell."""
    values = np.zeros((40, 20, 8), np.float32)
    for k in range(8):
        left = 14 if 2 <= k < 5 else 24
        values[left : left + 6, 6:12, k] = 500
    volume = Volume(values, np.diag([1.0, 1.0, 4.0, 1.0]))
    write_dicom(tmp_path, volume, change=moved_aside(volume, lambda k: 10.0 * (2 <= k < 5)))
    series = read_series(tmp_path)
    assert any("10.0 mm beside" in note for note in series.notes)
    straight = series.volume
    bar = straight.to_patient(np.argwhere(straight.values > 250).astype(float))
    assert (bar[:, 0].min(), bar[:, 0].max()) == pytest.approx((24.0, 29.0))
    assert len(bar) == (values > 250).sum()


def test_slices_whose_pictures_do_not_overlap_are_told(tmp_path):
    volume = Volume(np.ones((40, 20, 8), np.float32), np.diag([1.0, 1.0, 4.0, 1.0]))
    write_dicom(tmp_path, volume, change=moved_aside(volume, lambda k: 1e7 * (k == 3)))
    assert "do not overlap" in refused(tmp_path).what


def enhanced(path, volume, *, frames=True):
    """The volume as one multi-frame file, slices in a scrambled order."""
    first = pydicom.dcmread(write_dicom(path.parent / "single", volume)[0])
    order = [(k * 3) % volume.shape[2] for k in range(volume.shape[2])]
    first.NumberOfFrames = len(order)
    first.PixelData = np.stack([volume.values[:, :, k].T for k in order]).astype("<u2").tobytes()
    orientation, measures, shared = pydicom.Dataset(), pydicom.Dataset(), pydicom.Dataset()
    orientation.ImageOrientationPatient = first.ImageOrientationPatient
    measures.PixelSpacing = first.PixelSpacing
    shared.PlaneOrientationSequence, shared.PixelMeasuresSequence = [orientation], [measures]
    groups = []
    for k in order:
        position, transform, group = pydicom.Dataset(), pydicom.Dataset(), pydicom.Dataset()
        place = volume.to_patient(np.array([[0.0, 0.0, k]]))[0]
        position.ImagePositionPatient = [f"{each:.10g}" for each in place]
        transform.RescaleSlope, transform.RescaleIntercept = "2", "1"
        group.PlanePositionSequence = [position]
        group.PixelValueTransformationSequence = [transform]
        groups.append(group)
    for keyword in ("ImageOrientationPatient", "ImagePositionPatient", "PixelSpacing"):
        del first[keyword]
    if frames:
        first.SharedFunctionalGroupsSequence = [shared]
        first.PerFrameFunctionalGroupsSequence = groups
    first.save_as(path)


def test_an_enhanced_multi_frame_file_is_read(ramp, tmp_path):
    (tmp_path / "one").mkdir()
    enhanced(tmp_path / "one" / "all.dcm", ramp)
    for extra in (tmp_path / "one" / "single").iterdir():
        extra.unlink()
    for path in (tmp_path / "one", tmp_path / "one" / "all.dcm"):
        series = read_image(path)
        assert np.array_equal(series.volume.values, 2 * ramp.values + 1)
        np.testing.assert_allclose(series.volume.affine, ramp.affine, atol=1e-6)


def test_contrasts_of_one_enhanced_file_are_told_apart(ramp, tmp_path):
    """There is nothing to move to another folder; what differs stands in the groups of the frames."""
    path = tmp_path / "all.dcm"
    enhanced(path, ramp)
    dataset = pydicom.dcmread(path)
    groups, pixels = dataset.PerFrameFunctionalGroupsSequence, dataset.PixelData
    both = []
    for kind in ("WATER", "FAT"):
        for each in groups:
            frame = pydicom.Dataset()
            frame.update(each)
            frame.MRImageFrameTypeSequence = [pydicom.Dataset()]
            frame.MRImageFrameTypeSequence[0].FrameType = ["DERIVED", "PRIMARY", "DIXON", kind]
            both.append(frame)
    dataset.PerFrameFunctionalGroupsSequence = both
    dataset.PixelData, dataset.NumberOfFrames = 2 * pixels, len(both)
    dataset.save_as(path)
    fix = refused(path).fix
    assert "dcm2niix" in fix
    n = ramp.shape[2]
    assert f"Frame Type (0008,9007): DERIVED, PRIMARY, DIXON, WATER ({n} images)" in fix


def test_frames_without_places_are_told(ramp, tmp_path):
    (tmp_path / "one").mkdir()
    enhanced(tmp_path / "one" / "all.dcm", ramp, frames=False)
    for extra in (tmp_path / "one" / "single").iterdir():
        extra.unlink()
    assert "5200,9230" in refused(tmp_path / "one").what


@pytest.mark.parametrize(
    ("keyword", "value", "text"),
    [("PatientID", "ID-0815", "another patient"), ("FrameOfReferenceUID", "1.2.99", "frame of reference")],
)
def test_a_slice_of_another_patient_or_frame_is_refused_by_name(ramp, tmp_path, keyword, value, text):
    def one_odd(dataset, k):
        dataset.FrameOfReferenceUID = "1.2.3"
        if k == 3:
            setattr(dataset, keyword, value)

    write_dicom(tmp_path, ramp, change=one_odd)
    error = refused(tmp_path)
    assert text in error.what
    assert "1 of 5" in error.what
    assert "_3.dcm" in error.what
    assert error.facts["n_odd"] == 1
    assert not [secret for secret in ("4711", "0815", "1.2.99") if secret in str(error)]


def test_frames_that_tell_nothing_or_lack_are_noted(ramp, tmp_path):
    def own_frame(dataset, k):
        dataset.FrameOfReferenceUID = f"1.2.{k}"
        if k == 1:
            del dataset.PatientID

    write_dicom(tmp_path, ramp, change=own_frame)
    notes = read_series(tmp_path).notes
    assert any("0020,0052" in note for note in notes)
    assert any("0010,0020" in note for note in notes)
