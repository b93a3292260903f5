"""measure: shear-wave speeds from elastography screens, in the muscle between fat and bone."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case, Site
from limbcli.errors import MeasurementError
from limbcli.measurement.elastography import SweMap, map_file, statistics, write_map
from limbcli.measurement.overlay_places import SCREENS, find_bar, find_box
from limbcli.measurement.swe_image import Box, DecodedMap, Overlay, decode_overlay
from limbcli.measurement.ultrasound_image import UltrasoundImage, is_dicom, read_image
from limbcli.progress import Progress
from limbcli.provenance.staleness import Chain
from limbcli.results import StageWriter

_IMAGE_SUFFIXES = {".png", ".bmp", ".dcm", ".dicom", ".jpg", ".jpeg", ".tif", ".tiff"}
_FILM_SUFFIXES = {".mp4", ".avi", ".mov", ".wmv", ".mkv", ".mpg", ".mpeg", ".gif"}
_MANY_SATURATED = 10.0  # % of saturated pixels in the tissue above which a warning is given
_SAME_SCALE = 0.02  # largest difference of a stated scale from that of the files that is not told
_MANY_UNLIKE = 0.2  # share of coloured pixels that match no colour of the bar above which a warning is given
SCANNER_DENSITY = 1000.0  # kg/m^3
_OFF_BONE = 1.5  # mm above the bone line that are excluded because of its blur


@dataclass(frozen=True)
class TissueBetween:
    """Depth range of the muscle below the probe's face, mm, by level: from fat to bone.

    top : None if the images gave no layers; bottom : (n_levels,) or None without B-mode
    """

    top: float | None
    bottom: tuple[float, ...] | None

    def range(self, level: int) -> tuple[float, float]:
        low = -np.inf if self.top is None else self.top
        known = self.bottom is not None and level < len(self.bottom)
        return low, self.bottom[level] if known and self.bottom is not None else np.inf

    @property
    def is_known(self) -> bool:
        return self.top is not None or self.bottom is not None

    @property
    def words(self) -> str:
        parts = [] if self.top is None else [f"from {self.top:.1f} mm (skin and fat as segment found them)"]
        if self.bottom is not None:
            parts.append(f"to {min(self.bottom):.1f} mm or deeper (above the bone)")
        return " ".join(parts)


def tissue_between(
    case: Case, site: Site, out: Path, skin_bone: Sequence[float] | None, writer: StageWriter
) -> TissueBetween:
    """The tissue range, from the layers found by `segment` at the site and the skin-bone distances.

    skin_bone : from the B-mode images or levels.csv, mm at every level, NaN where it was not read
    """
    bottom = None
    if skin_bone is not None:
        bottom = tuple(each - _OFF_BONE if np.isfinite(each) else np.inf for each in skin_bone)
    segmented = Chain(case, out).present("segment", about=[site.name])
    layers = None
    if segmented is not None:
        layers = segmented.value(f"layers/{site.name}")
        writer.used_result(segmented, data=[f"layers/{site.name}"])
    top = None if layers is None else float(layers["skin_mm"]) + float(layers["fat_mm"])
    return TissueBetween(top, bottom)


def images_of(table: Mapping[str, Any], *, box_pixels: Box | None = None) -> list[UltrasoundImage]:
    """One image per level, sorted by name with numbers in numerical order (9 before 10).

    `frame` of the table selects the frame of multi-frame files; a list selects all levels from a single file.
    """
    folder: Path = table["path"]
    paths = sorted(filter(_is_image, folder.iterdir()), key=lambda each: _by_numbers(each.name))
    if not paths:
        fix = "put one image per level there, named in the order measured (DICOM, PNG, BMP)"
        films = sorted(each.name for each in folder.iterdir() if each.suffix.lower() in _FILM_SUFFIXES)
        if films:
            fix += f"; {films[0]} is a film: save the frame of every hold as PNG, in its full size"
        raise MeasurementError("the folder contains no image", where=str(folder), fix=fix)
    frame = table.get("frame")
    frames = list(frame) if isinstance(frame, list) else [frame] * len(paths)
    files = paths * len(frames) if len(paths) == 1 else paths
    if len(frames) != len(files):
        raise MeasurementError(
            f"frame lists {len(frames)} frames, the folder contains {len(files)} images",
            where=str(folder),
            fix="state one per image, or keep only the file that contains all frames",
        )
    images = [
        read_image(path, mm_per_pixel=table["mm_per_pixel"], box_pixels=box_pixels, frame=number)
        for path, number in zip(files, frames, strict=True)
    ]
    if table["mm_per_pixel"] is not None:
        _require_one_size(images)
    return images


def _require_one_size(images: Sequence[UltrasoundImage]) -> None:
    """Check that no picture has been resized, as one stated scale cannot be that of both sizes.

    A picture of which parts were cut off differs in one direction, or not by the same factor.
    """
    rows, columns = images[0].rgb.shape[:2]
    for each in images:
        if each.replaced_mm_per_pixel is not None:
            continue
        down, across = each.rgb.shape[0] / rows, each.rgb.shape[1] / columns
        if abs(down - 1) > _SAME_SCALE and abs(down / across - 1) < _SAME_SCALE / 2:
            raise MeasurementError(
                f"the picture has {each.rgb.shape[1]} by {each.rgb.shape[0]} pixels, the first {columns} by "
                f"{rows}: it was resized, so that one mm_per_pixel is not true of both",
                where=each.where,
                fix="export all pictures in one size, and take mm_per_pixel from the depth scale of one",
            )


def scale_warnings(images: Sequence[UltrasoundImage], stated: float | None) -> list[str]:
    """A warning where the scale that case.toml states is not that of the files; stated : mm per pixel"""
    own = [each.replaced_mm_per_pixel for each in images if each.replaced_mm_per_pixel is not None]
    if stated is None or not own or max(abs(each / stated - 1) for each in own) < _SAME_SCALE:
        return []
    return [
        f"the images state {min(own):.4g} to {max(own):.4g} mm per pixel, but mm_per_pixel = {stated:g} of "
        "case.toml is used: remove it, unless their calibration is wrong"
    ]


def _is_image(path: Path) -> bool:
    """Whether a visible file is an image, by its suffix or, as DICOM often has none, by its header."""
    if path.name.startswith(".") or path.name == "DICOMDIR" or not path.is_file():
        return False
    return path.suffix.lower() in _IMAGE_SUFFIXES or is_dicom(path)


def _by_numbers(name: str) -> list[tuple[int, str]]:
    """
    >>> sorted(["level10.png", "level9.png", "Level_1.png"], key=_by_numbers)
    ['level9.png', 'level10.png', 'Level_1.png']
    """
    parts = re.split(r"(\d+)", name.lower())
    return [(int(each), "") if k % 2 else (-1, each) for k, each in enumerate(parts)]


def measured_speeds(
    table: Mapping[str, Any], tissue: TissueBetween, writer: StageWriter, progress: Progress
) -> dict[str, Sequence[float]]:
    """The columns of speeds; also writes the maps of all levels and a box plot."""
    from limbcli.measurement.instrument_pictures import draw_speeds

    images = images_of(table, box_pixels=box_of(table["image_pixels"]))
    writer.warnings.extend(scale_warnings(images, table["mm_per_pixel"]))
    if table["image_pixels"] is None and images[0].is_whole:
        writer.warnings.append(
            "the top of the elastography images is taken as the probe face and their middle "
            "as its centre; state where the ultrasound image lies in them with image_pixels"
        )
    overlays = _overlays(images, table, writer)
    decoded: list[DecodedMap] = []
    for k, (image, overlay) in enumerate(zip(images, overlays, strict=True), 1):
        decoded.append(decode_overlay(image, overlay))
        progress.event("task", name="SWE images", done=k, total=len(images))
    worst = max(range(len(decoded)), key=lambda k: decoded[k].share_unlike)
    unlike = decoded[worst].share_unlike
    if unlike > _MANY_UNLIKE:
        writer.warnings.append(
            f"level {worst}: {100 * unlike:.0f} % of the coloured pixels have no colour of the bar "
            "and are excluded; speeds of the others may be wrong: check opacity, bar_pixels and box_pixels"
        )
    maps = within_tissue(decoded, table, tissue, writer)
    for k, each in enumerate(maps):
        write_map(map_file(writer.file("maps", "swe").parent / "swe", k), each)
    figures = [statistics(each) for each in maps]
    draw_speeds(maps, writer.file("speed_picture", "speeds.png"))
    writer.data["swe"] = [
        {"n_masked": d.n_masked, "n_unlike": d.n_unlike, "n_ambiguous": d.n_ambiguous,
         "n_saturated": int(d.saturated.sum()), "box_pixels": list(o.box_pixels), **vars(f)}
        for d, o, f in zip(decoded, overlays, figures, strict=True)
    ]  # fmt: skip
    return {
        "swe_mean_m_per_s": [each.mean_m_per_s for each in figures],
        "swe_sd_m_per_s": [each.sd_m_per_s for each in figures],
        "swe_pixels": [each.n_pixels for each in figures],
    }


def _overlays(
    images: Sequence[UltrasoundImage], table: Mapping[str, Any], writer: StageWriter
) -> list[Overlay]:
    """Colour bar and box of every image: from case.toml, else detected (the bar once, the box in each)."""
    bar = box_of(table["bar_pixels"])
    if bar is None:
        bar = SCREENS[table["preset"]].bar_in(images[0]) if table["preset"] else find_bar(images[0])
    stated = box_of(table["box_pixels"])
    boxes = [stated or find_box(each, bar) for each in images]
    for name, found in (("bar_pixels", bar), ("box_pixels", boxes[0])):
        if not table[name]:
            writer.summary.append(f"{name} found at {list(found)}")
    low, high, of_modulus = bar_ends(table)
    return [Overlay(box, bar, low, high, float(table["opacity"]), of_modulus) for box in boxes]


def bar_ends(table: Mapping[str, Any]) -> tuple[float, float, bool]:
    """(speeds (m/s) at the low and the high end of the bar, whether it is even in kPa).

    A bar in kPa is marked with Young's modulus, E = 3 rho v^2 at the 1000 kg/m^3 that scanners assume.

    >>> bar_ends({"high_kpa": 300.0, "low_kpa": 0.0})
    (0.0, 10.0, True)
    """
    if table.get("high_kpa") is not None:
        low, high = (
            math.sqrt(float(table[name]) * 1e3 / (3 * SCANNER_DENSITY)) for name in ("low_kpa", "high_kpa")
        )
        return low, high, True
    return float(table["low_m_per_s"]), float(table["high_m_per_s"]), table["bar_scale"] == "modulus"


def within_tissue(
    decoded: Sequence[DecodedMap], table: Mapping[str, Any], tissue: TissueBetween, writer: StageWriter
) -> list[SweMap]:
    """The unsaturated pixels in the region of interest: the stated one, else between fat and bone.

    table : [site.swe_images]

    Raises MeasurementError if a level has no such pixels.
    """
    lateral = tuple(table["roi_lateral_mm"] or (-np.inf, np.inf))
    stated = tuple(table["roi_depth_mm"]) if table["roi_depth_mm"] else None
    if stated is None and tissue.is_known:
        writer.summary.append(f"speeds are those of the depths {tissue.words}")
    if stated is None and tissue.top is None:
        writer.warnings.append(
            "speeds are those of the whole colour box from its top: run `limbcli segment` first, or state "
            "roi_depth_mm, so that skin and fat are excluded"
        )
    maps = []
    for k, each in enumerate(decoded):
        depth = stated or tissue.range(k)
        part = each.unsaturated.within(lateral=lateral, depth=depth)
        if not len(part):
            raise MeasurementError(
                f"level {k}: no readable pixel lies between {depth[0]:.1f} and {depth[1]:.1f} mm",
                where=str(each.swe.path),
                fix="state roi_depth_mm, or image_pixels, box_pixels and mm_per_pixel of the pictures",
            )
        read = len(each.swe.within(lateral=lateral, depth=depth))
        share = 100 * (1 - len(part) / read)
        if share > _MANY_SATURATED:
            writer.warnings.append(
                f"level {k}: {share:.0f} % of the pixels are at an end of the colour bar and excluded: "
                "the mean speed is that of the rest; measure with a wider range"
            )
        maps.append(part)
    return maps


def box_of(values: Sequence[float] | None) -> Box | None:
    return (int(values[0]), int(values[1]), int(values[2]), int(values[3])) if values else None
