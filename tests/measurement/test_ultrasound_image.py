"""Ultrasound images as scanners store them: the colours that were on the screen, and where depth begins."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pydicom import dcmread
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.encaps import encapsulate
from pydicom.pixels import convert_color_space
from pydicom.uid import ExplicitVRLittleEndian, JPEGBaseline8Bit, UltrasoundImageStorage, generate_uid

from limbcli.errors import MeasurementError
from limbcli.measurement.ultrasound_image import read_image
from limbcli.stages.measuring.images import scale_warnings

ROWS, COLUMNS = 64, 80


def screen() -> np.ndarray:
    """(ROWS, COLUMNS, 3) bytes: a red and a blue half below a grey band."""
    rgb = np.empty((ROWS, COLUMNS, 3), np.uint8)
    rgb[:, : COLUMNS // 2], rgb[:, COLUMNS // 2 :], rgb[:16] = (200, 50, 20), (20, 60, 220), (90, 90, 90)
    return rgb


def stored(
    path: Path, pixels: bytes, *, kind: str = "RGB", packed: bool = False, n_frames: int = 1, **region: object
) -> Path:
    """An ultrasound DICOM, of one frame or several, whose one region is the whole image at 0.1 mm a pixel."""
    meta = FileMetaDataset()
    meta.TransferSyntaxUID = JPEGBaseline8Bit if packed else ExplicitVRLittleEndian
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = UltrasoundImageStorage, generate_uid()
    dataset = FileDataset(str(path), {}, file_meta=meta, preamble=b"\0" * 128)
    dataset.SOPClassUID, dataset.SOPInstanceUID = UltrasoundImageStorage, meta.MediaStorageSOPInstanceUID
    dataset.Modality, dataset.PhotometricInterpretation = "US", kind
    dataset.Rows, dataset.Columns, dataset.SamplesPerPixel, dataset.PlanarConfiguration = ROWS, COLUMNS, 3, 0
    dataset.BitsAllocated = dataset.BitsStored = 8
    dataset.HighBit, dataset.PixelRepresentation = 7, 0
    item = Dataset()
    item.RegionSpatialFormat, item.PhysicalUnitsXDirection, item.PhysicalUnitsYDirection = 1, 3, 3
    item.PhysicalDeltaX = item.PhysicalDeltaY = 0.01
    item.RegionLocationMinX0 = item.RegionLocationMinY0 = 0
    item.RegionLocationMaxX1, item.RegionLocationMaxY1 = COLUMNS - 1, ROWS - 1
    for keyword, value in region.items():
        setattr(item, keyword, value)
    dataset.SequenceOfUltrasoundRegions = [item]
    if n_frames > 1:
        dataset.NumberOfFrames = n_frames
    dataset.PixelData = encapsulate([pixels]) if packed else pixels
    dataset["PixelData"].is_undefined_length = packed
    dataset.save_as(path, enforce_file_format=True)
    return path


def as_jpeg(rgb: np.ndarray, *, halved: bool) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(rgb).save(stream, "JPEG", quality=95, subsampling=1 if halved else 0)
    return stream.getvalue() + b"\0" * (len(stream.getvalue()) % 2)


@pytest.mark.parametrize("kind", ["RGB", "YBR_FULL", "YBR_FULL_422"])
def test_the_screen_s_colours_come_out_however_they_are_stored(tmp_path, kind):
    rgb = screen()
    if kind == "RGB":
        path = stored(tmp_path / "a.dcm", rgb.tobytes())
    elif kind == "YBR_FULL":
        path = stored(tmp_path / "a.dcm", convert_color_space(rgb, "RGB", kind).tobytes(), kind=kind)
    else:
        path = stored(tmp_path / "a.dcm", as_jpeg(rgb, halved=True), kind=kind, packed=True)
    # 4 of 255: rounding to bytes twice, and JPEG at quality 95, away from the borders of colours
    found = read_image(path).rgb.astype(int)
    for place in ((4, 4), (40, 10), (40, 70)):
        assert np.abs(found[place] - rgb[place]).max() <= 4


@pytest.mark.parametrize(
    ("row", "depth_cm", "face"), [(21, 0.0, 21), (0, 0.0, 0), (31, 0.1, 21), (-5, 0.0, 0)]
)
def test_depth_begins_where_the_reference_pixel_puts_the_probe_face(tmp_path, row, depth_cm, face):
    reference = {"ReferencePixelY0": row, "ReferencePixelPhysicalValueY": depth_cm}
    image = read_image(stored(tmp_path / "a.dcm", screen().tobytes(), **reference))
    assert image.main_region().top == face


def test_a_picture_that_begins_below_the_face_is_refused_until_its_box_is_told(tmp_path):
    reference = {"ReferencePixelY0": -80, "ReferencePixelPhysicalValueY": 0.0}
    path = stored(tmp_path / "a.dcm", screen().tobytes(), **reference)
    with pytest.raises(MeasurementError, match=r"begins 8\.0 mm below the probe face"):
        read_image(path).main_region()
    assert read_image(path, box_pixels=(0, 3, 79, 60)).main_region().top == 3


@pytest.mark.parametrize(
    "region",
    [{"PhysicalUnitsXDirection": 4}, {"PhysicalUnitsYDirection": 7}, {"PhysicalDeltaY": 0.0},
     {"RegionSpatialFormat": 2}],
    ids=["seconds along x", "cm/s along y", "no size", "motion over time"],
)  # fmt: skip
def test_a_region_that_is_no_picture_in_cm_gives_no_scale(tmp_path, region):
    """A trace of motion or of a flow's speed beside the tissue, whose pixels are no lengths."""
    assert not read_image(stored(tmp_path / "a.dcm", screen().tobytes(), **region)).regions
    assert len(read_image(stored(tmp_path / "b.dcm", screen().tobytes())).regions) == 1


@pytest.mark.parametrize(
    ("spacing", "fix"), [([0.08, 0.08], "mm_per_pixel = 0.08 if"), ([0.08, 0.1], "the depth scale")]
)
def test_a_pixel_spacing_beside_no_region_is_shown_and_not_used(tmp_path, spacing, fix):
    path = stored(tmp_path / "a.dcm", screen().tobytes(), PhysicalDeltaY=0.0)
    dataset = dcmread(path)
    dataset.PixelSpacing = spacing
    dataset.save_as(path)
    with pytest.raises(MeasurementError, match=r"0\.08 by 0") as caught:
        read_image(path).main_region()
    assert fix in caught.value.fix


def test_a_box_beyond_the_image_is_refused(tmp_path):
    path = stored(tmp_path / "a.dcm", screen().tobytes())
    for box in ((0, 0, COLUMNS, ROWS - 1), (0, 0, COLUMNS - 1, ROWS), (-1, 0, 9, 9), (9, 0, 9, 9)):
        with pytest.raises(MeasurementError, match="does not lie in the image of 80 by 64 pixels"):
            read_image(path, box_pixels=box)


def test_of_a_real_convex_probe_s_picture_the_face_is_8_mm_below_the_region_s_top(shared):
    region = read_image(shared / "data" / "us-dicom" / "gdcm-US-ALOKA-16.dcm").main_region()
    assert region.top == 45  # its corner is at 24, its reference pixel 21 below


def test_a_scale_that_is_stated_leaves_the_picture_where_the_file_has_it(tmp_path):
    reference = {"ReferencePixelY0": 21, "ReferencePixelPhysicalValueY": 0.0}
    path = stored(tmp_path / "a.dcm", screen().tobytes(), RegionLocationMinX0=8, **reference)
    image = read_image(path, mm_per_pixel=0.2)
    own = read_image(path).main_region().mm_per_pixel_y
    assert image.replaced_mm_per_pixel == own
    (said,) = scale_warnings([image], 0.2)
    assert f"{own:.4g} mm per pixel, but mm_per_pixel = 0.2" in said
    assert not scale_warnings([read_image(path, mm_per_pixel=own)], own)
    assert not scale_warnings([read_image(path)], None)
    region = image.main_region()
    assert (region.left, region.top, region.mm_per_pixel_x, region.mm_per_pixel_y) == (8, 21, 0.2, 0.2)
    assert not read_image(path).is_whole
    Image.fromarray(screen()).save(tmp_path / "a.png")
    picture = read_image(tmp_path / "a.png", mm_per_pixel=0.2)
    assert picture.is_whole
    assert not scale_warnings([picture], 0.2)
    assert picture.main_region().bottom == ROWS - 1


def loop(path: Path, n_frames: int = 4) -> Path:
    """A file of frames of one grey each: 10, 20, ... of 255."""
    greys = [np.full((ROWS, COLUMNS, 3), 10 * (k + 1), np.uint8) for k in range(n_frames)]
    if path.suffix == ".dcm":
        return stored(path, np.stack(greys).tobytes(), n_frames=n_frames)
    first, *others = (Image.fromarray(each) for each in greys)
    first.save(path, save_all=True, append_images=others)
    return path


@pytest.mark.parametrize("name", ["cine.dcm", "cine.tif"])
def test_of_a_loop_the_frame_is_read_that_is_told_and_none_that_is_not(tmp_path, name):
    path = loop(tmp_path / name)
    with pytest.raises(MeasurementError, match="contains 4 frames, and it is not stated which") as found:
        read_image(path, mm_per_pixel=0.1)
    assert "frame = 12" in found.value.fix
    image = read_image(path, mm_per_pixel=0.1, frame=3)
    assert (int(image.rgb[0, 0, 0]), image.where) == (30, f"{path}, frame 3")
    with pytest.raises(MeasurementError, match="frame 5 was requested; the file contains 4"):
        read_image(path, mm_per_pixel=0.1, frame=5)


@pytest.mark.parametrize(("ending", "kind"), [("png", np.uint16), ("tif", np.uint16), ("tif", np.float32)])
def test_greys_of_more_than_eight_bits_are_not_cut_off(tmp_path, ending, kind):
    grey = np.tile(np.arange(256), (8, 1))
    deep = (grey * 257).astype(kind) if kind is np.uint16 else (grey / 255).astype(kind)
    Image.fromarray(deep).save(tmp_path / f"a.{ending}")
    found = read_image(tmp_path / f"a.{ending}", mm_per_pixel=0.1)
    np.testing.assert_array_equal(found.rgb, np.repeat(grey[:, :, None], 3, axis=2))


def test_a_still_image_is_its_own_first_frame(tmp_path):
    path = stored(tmp_path / "a.dcm", screen().tobytes())
    assert read_image(path, frame=1).where == str(path)
    with pytest.raises(MeasurementError, match="frame 2 was requested; the file contains 1"):
        read_image(path, frame=2)
