"""Ultrasound images with a scale: DICOM with calibrated regions, or PNG and BMP plus mm per pixel.

A DICOM ultrasound image may contain several regions (B-mode, colour box, Doppler trace); each states its
corners and the physical meaning of a pixel (PS3.3 C.8.5.5). A region whose deltas are zero or whose unit is
not cm is not calibrated and is not used. Depth 0 is the probe face: the row given by the region's reference
pixel, else its top.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import MeasurementError
from limbcli.files.unpacking import LIBRARY_ERRORS

_CM = 3  # code of PhysicalUnitsXDirection for cm
_TISSUE = 1  # code of RegionSpatialFormat for two-dimensional tissue
_WITH_PREVIEW = "MPO"  # a camera's JPEG: further frames are smaller copies of the picture
_DEEP = ("I", "F")  # prefixes of Pillow's modes with one channel of 16 or 32 bits, which it would clip at 255
_OVER_EDGE = 2  # pixels by which a box may extend beyond the edge of its region
_UNLIKE = 0.01  # by so large a fraction, distances of rows and columns are not one mm_per_pixel
_MOST_CUT_OFF = 1.0  # mm of tissue below the probe face that an image may lack; it is neglected


@dataclass(frozen=True)
class Region:
    """A calibrated part of the image: pixel corners (inclusive) and mm per pixel; its top is the probe face.

    cut_off : mm of tissue below the face that are missing in the image
    """

    left: int
    top: int
    right: int
    bottom: int
    mm_per_pixel_x: float
    mm_per_pixel_y: float
    cut_off: float = 0.0

    def holds(self, box: tuple[int, int, int, int]) -> bool:
        """Whether a box (left, top, right, bottom) lies inside, up to a pixel or two."""
        left, top, right, bottom = box
        across = self.left - _OVER_EDGE <= left and right <= self.right + _OVER_EDGE
        return across and self.top - _OVER_EDGE <= top and bottom <= self.bottom + _OVER_EDGE

    def shared(self, box: tuple[int, int, int, int]) -> int:
        """Number of pixels in common with a box."""
        left, top, right, bottom = box
        width = min(self.right, right) - max(self.left, left) + 1
        height = min(self.bottom, bottom) - max(self.top, top) + 1
        return max(width, 0) * max(height, 0)


@dataclass(frozen=True, eq=False)
class UltrasoundImage:
    """One frame: rgb (rows, columns, 3) of bytes, and its calibrated regions.

    frame : its number in the file, from 1; None if it is the only one
    replaced_mm_per_pixel : the file's own scale along the beam, where another was stated; None without one
    pixel_spacing : mm between rows and between columns, as a DICOM image states it outside its regions; it
        may be that of a screen or a print, so it is only shown; None without one
    """

    rgb: NDArray[np.uint8]
    regions: tuple[Region, ...]
    path: Path
    frame: int | None = None
    replaced_mm_per_pixel: float | None = None
    pixel_spacing: tuple[float, float] | None = None

    @property
    def where(self) -> str:
        """The file, and the frame in it, for messages."""
        return str(self.path) if self.frame is None else f"{self.path}, frame {self.frame}"

    @property
    def grey(self) -> NDArray[np.float64]:
        """Brightness (rows, columns), 0 to 1 (Rec. 601 weights)."""
        return self.rgb.astype(np.float64) @ np.array([0.299, 0.587, 0.114]) / 255.0

    def main_region(self) -> Region:
        """The largest calibrated two-dimensional region.

        Raises MeasurementError if none is calibrated, or it begins below the probe face.
        """
        return self._from_the_face(max(self.calibrated(), key=_area))

    @property
    def is_whole(self) -> bool:
        """Whether every region is the whole image, so that the ultrasound image is not located in it."""
        rows, columns = self.rgb.shape[:2]
        return all((r.left, r.top, r.right, r.bottom) == (0, 0, columns - 1, rows - 1) for r in self.regions)

    def calibrated(self) -> tuple[Region, ...]:
        """All regions; raises MeasurementError if there is none."""
        if not self.regions:
            what, scale = "the image has no calibrated region", "mm_per_pixel (from the depth scale)"
            if self.pixel_spacing is not None:
                down, across = self.pixel_spacing
                what += f"; its Pixel Spacing (0028,0030), {down:.6g} by {across:.6g} mm, may be of a screen"
                if abs(down - across) < _UNLIKE * down:
                    scale = f"mm_per_pixel = {down:.6g} if the depth scale agrees"
            raise MeasurementError(what, where=self.where, fix=f"state {scale}, or export DICOM with regions")
        return self.regions

    def _from_the_face(self, region: Region) -> Region:
        if region.cut_off > _MOST_CUT_OFF:
            raise MeasurementError(
                f"the picture begins {region.cut_off:.1f} mm below the probe face (Reference Pixel Y0, "
                "0018,6022): depths cannot be counted from its top",
                where=self.where,
                fix="export the frame without zoom; if the face is in the image, state where: its box "
                "(box_pixels of [site.b_mode], image_pixels of [site.swe_images]), whose top is the face",
            )
        return region

    def region_of(self, box: tuple[int, int, int, int]) -> Region:
        """The calibrated region that contains a box; the largest, if regions are nested.

        box : left, top, right, bottom (pixels, inclusive)

        Raises MeasurementError if none is calibrated, the box lies in none or across two, or its region
        begins below the face.
        """
        self.calibrated()
        holding = [each for each in self.regions if each.holds(box)]
        if not holding:
            places = ", ".join(str([r.left, r.top, r.right, r.bottom]) for r in self.regions)
            raise MeasurementError(
                f"the box {list(box)} lies in none of the image's calibrated regions ({places})",
                where=self.where,
                fix="correct box_pixels, or state the image region that contains it: image_pixels = [left, "
                "top, right, bottom], its top the probe face",
            )
        return self._from_the_face(max(holding, key=_area))


def _area(region: Region) -> int:
    return (region.right - region.left) * (region.bottom - region.top)


def read_image(
    path: Path,
    *,
    mm_per_pixel: float | None = None,
    box_pixels: tuple[int, int, int, int] | None = None,
    frame: int | None = None,
) -> UltrasoundImage:
    """Read one frame.

    mm_per_pixel : replaces the file's own calibration; the position of the ultrasound image is still taken
        from the file, else the whole image is used
    box_pixels : left, top, right, bottom of the ultrasound image within the screen shot; its top is the probe
        face
    frame : number of the frame in a multi-frame file (a cine loop), from 1

    Raises MeasurementError if the file is not an image, it contains several frames and none is selected, or
    no scale is in the file or given.
    """
    rgb, regions, number, spacing = _read_dicom(path, frame) if is_dicom(path) else _read_picture(path, frame)
    own = None
    if mm_per_pixel is not None:
        own = max(regions, key=_area).mm_per_pixel_y if regions else None
        if not 0.005 <= mm_per_pixel <= 1.0:
            what = f"mm_per_pixel is {mm_per_pixel:g}; ultrasound images have 0.02 to 0.3"
            raise MeasurementError(what, where=str(path), fix="read it off the depth scale of the image")
        whole = Region(0, 0, rgb.shape[1] - 1, rgb.shape[0] - 1, 1.0, 1.0)
        regions = tuple(_at_scale(each, mm_per_pixel) for each in regions or (whole,))
    image = UltrasoundImage(rgb, regions, path, number, own, spacing)
    return image if box_pixels is None else _within(image, box_pixels)


def _frame_of(path: Path, count: int, wanted: int | None) -> int | None:
    """The number of the requested frame, from 1; None in a file with one frame."""
    if count > 1 and wanted is None:
        raise MeasurementError(
            f"the file contains {count} frames, and it is not stated which one shows the level",
            where=str(path),
            fix="state it in the table that names the folder: frame = 12 (counted from 1) for every file, or "
            "a list, one a level (all of one file where it is the only one); or export still frames",
            n_frames=count,
        )
    if wanted is not None and not 1 <= wanted <= count:
        raise MeasurementError(
            f"frame {wanted} was requested; the file contains {count}",
            where=str(path),
            fix="correct frame, counted from 1",
            n_frames=count,
        )
    return wanted if count > 1 else None


def _at_scale(region: Region, mm_per_pixel: float) -> Region:
    cut_off = region.cut_off * mm_per_pixel / region.mm_per_pixel_y
    return replace(region, mm_per_pixel_x=mm_per_pixel, mm_per_pixel_y=mm_per_pixel, cut_off=cut_off)


def _within(image: UltrasoundImage, box: tuple[int, int, int, int]) -> UltrasoundImage:
    """The image with its region narrowed to a box, at the scale of the region with the largest overlap."""
    left, top, right, bottom = box
    rows, columns = image.rgb.shape[:2]
    if not (0 <= left < right < columns and 0 <= top < bottom < rows):
        raise MeasurementError(
            f"the box {list(box)} does not lie in the image of {columns} by {rows} pixels",
            where=image.where,
            fix="state box_pixels = [left, top, right, bottom]",
        )
    main = max(image.calibrated(), key=lambda each: (each.shared(box), _area(each)))
    region = Region(left, top, right, bottom, main.mm_per_pixel_x, main.mm_per_pixel_y)
    return replace(image, regions=(region,))


def is_dicom(path: Path) -> bool:
    """Whether it is DICOM, by its preamble or suffix. Raises MeasurementError if there is no file."""
    if not path.is_file():
        raise MeasurementError("the image was not found", where=str(path), fix="correct its name")
    with path.open("rb") as stream:
        head = stream.read(132)
    return head[128:] == b"DICM" or path.suffix.lower() in {".dcm", ".dicom"}


_Frame = tuple[NDArray[np.uint8], tuple[Region, ...], int | None, tuple[float, float] | None]


def _read_picture(path: Path, frame: int | None) -> _Frame:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as picture:
            count = 1 if picture.format == _WITH_PREVIEW else getattr(picture, "n_frames", 1)
            number = _frame_of(path, count, frame)
            picture.seek((number or 1) - 1)
            if picture.mode[:1] in _DEEP:
                return _to_bytes(np.asarray(picture), inverted=False), (), number, None
            return np.asarray(picture.convert("RGB"), dtype=np.uint8), (), number, None
    except (UnidentifiedImageError, Image.DecompressionBombError, SyntaxError, *LIBRARY_ERRORS) as error:
        fix = "export the frame as DICOM, PNG or BMP"
        raise MeasurementError(f"the image cannot be read ({error})", where=str(path), fix=fix) from error


def _read_dicom(path: Path, frame: int | None) -> _Frame:
    """Pixels and regions.

    The error for a corrupt file shows no values of it, which may identify the patient.
    """
    from limbcli.files.dicom import DICOM_DAMAGED

    try:
        return _dicom_frame(path, frame)
    except DICOM_DAMAGED as error:
        raise MeasurementError(
            f"the DICOM image cannot be read ({type(error).__name__})",
            where=str(path),
            fix="copy it again, export it uncompressed, or as PNG with mm_per_pixel",
        ) from error


def _dicom_frame(path: Path, frame: int | None) -> _Frame:
    from pydicom.pixels import apply_color_lut, pixel_array

    from limbcli.files.dicom import read_dicom, require_affordable

    dataset = read_dicom(path)
    require_affordable(dataset)
    number = _frame_of(path, int(dataset.get("NumberOfFrames", 1) or 1), frame)
    # already converted to RGB if the file stores YBR
    pixels = pixel_array(dataset, index=(number or 1) - 1)
    kind = str(dataset.get("PhotometricInterpretation", "MONOCHROME2"))
    if kind == "PALETTE COLOR":
        pixels = apply_color_lut(pixels, dataset)
    rgb = _to_bytes(pixels, inverted=kind == "MONOCHROME1")
    return rgb, _regions(dataset), number, _pixel_spacing(dataset)


def _to_bytes(pixels: NDArray, *, inverted: bool) -> NDArray[np.uint8]:
    """Convert to 8-bit RGB; with more than eight bits, the maximum becomes white."""
    values = np.nan_to_num(pixels.astype(np.float64), posinf=0.0, neginf=0.0)
    if pixels.dtype != np.uint8:
        values *= 255.0 / (max(float(values.max()), 0.0) or 1.0)
    if inverted:
        values = 255.0 - values
    if values.ndim == 2:
        values = np.repeat(values[:, :, None], 3, axis=2)
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _pixel_spacing(dataset: Any) -> tuple[float, float] | None:
    """Pixel Spacing (0028,0030), if it is two lengths."""
    try:
        down, across = map(float, dataset.PixelSpacing)
    except (AttributeError, TypeError, ValueError):
        return None
    return (down, across) if 0 < down < np.inf and 0 < across < np.inf else None


def _regions(dataset: object) -> tuple[Region, ...]:
    found = []
    for each in getattr(dataset, "SequenceOfUltrasoundRegions", None) or ():
        dx = abs(float(each.get("PhysicalDeltaX", 0) or 0)) * 10.0
        dy = abs(float(each.get("PhysicalDeltaY", 0) or 0)) * 10.0
        units = (each.get("PhysicalUnitsXDirection", 0), each.get("PhysicalUnitsYDirection", 0))
        if (
            not (0 < dx < np.inf and 0 < dy < np.inf)
            or units != (_CM, _CM)
            or each.get("RegionSpatialFormat", 1) != _TISSUE
        ):
            continue
        corners = [
            int(each.get(name, 0))
            for name in (
                "RegionLocationMinX0",
                "RegionLocationMinY0",
                "RegionLocationMaxX1",
                "RegionLocationMaxY1",
            )
        ]
        left, top, right, bottom = corners
        face = _face_row(each, top, bottom)
        found.append(Region(left, max(top, round(face)), right, bottom, dx, dy, max(0.0, (top - face) * dy)))
    return tuple(found)


def _face_row(region: Any, top: int, bottom: int) -> float:
    """The row of depth 0, from the reference pixel (relative to the region's corner) and its depth.

    The region's top, if there is no reference pixel or depth 0 would lie below the region.
    """
    row, depth = region.get("ReferencePixelY0"), region.get("ReferencePixelPhysicalValueY")
    if row is None or depth is None:
        return top
    face = top + float(row) - float(depth) / float(region.PhysicalDeltaY)
    return face if np.isfinite(face) and face < bottom else top
