"""measure: skin, fat and muscle on the B-mode images, as columns of levels.csv, and the fibres' pennation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from limbcli.errors import MeasurementError
from limbcli.measurement.bmode import BoneLine
from limbcli.measurement.bmode_layers import Stated, follow_borders
from limbcli.measurement.instrument_pictures import draw_pennation
from limbcli.measurement.pennation import read_pennation
from limbcli.measurement.ultrasound_image import UltrasoundImage
from limbcli.results import StageWriter

_FOLLOWED = ("skin", "fat")


def read_borders(
    images: Sequence[UltrasoundImage], table: Mapping[str, Any], bone: Sequence[BoneLine], writer: StageWriter
) -> dict[str, list[BoneLine]]:
    """Track the layers' lower borders that [site.b_mode] gives at level 0; by name. Adds a summary.

    Raises MeasurementError as `follow_borders`.
    """
    stated: dict[str, Stated] = {
        name: table[f"{name}_mm"] for name in _FOLLOWED if table.get(f"{name}_mm") is not None
    }
    borders = follow_borders(images, stated, bone)
    if not borders:
        return borders
    writer.data["borders"] = {name: [vars(each) for each in lines] for name, lines in borders.items()}
    for name, values in layer_columns(borders, bone).items():
        layer = name.removesuffix("_mm")
        writer.summary.append(f"{layer} {values[0]:.2f} to {values[-1]:.2f} mm")
    worst = max(each.sd for lines in borders.values() for each in lines)
    writer.summary.append(f"SD of a border at most {worst:.2f} mm (state it as layer_mm of [site.noise])")
    return borders


def layer_columns(
    borders: Mapping[str, Sequence[BoneLine]], bone: Sequence[BoneLine]
) -> dict[str, Sequence[float]]:
    """skin_mm, fat_mm and, if both were read, muscle_mm down to the bone; empty without borders."""
    columns: dict[str, Sequence[float]] = {}
    above = [0.0] * len(bone)
    for name, lines in borders.items():
        columns[f"{name}_mm"] = [line.distance - top for line, top in zip(lines, above, strict=True)]
        above = [line.distance for line in lines]
    if len(borders) == len(_FOLLOWED):
        columns["muscle_mm"] = [line.distance - top for line, top in zip(bone, above, strict=True)]
    return columns


_ABOVE_BONE = 2.0  # mm above the bone line that are excluded because of the bone's echo
_SKIN_AND_FAT = 0.25  # assumed depth of the fat's border as a fraction of the bone's, if it was not read


def write_pennation(
    image: UltrasoundImage, borders: Mapping[str, Sequence[BoneLine]], bone: BoneLine, writer: StageWriter
) -> None:
    """Write `pennation` of measure.json with its figure and how to use it, or why it could not be read."""
    fat = borders.get("fat")
    top = fat[0].distance if fat else _SKIN_AND_FAT * bone.distance
    try:
        found = read_pennation(image, top=top, bottom=bone.distance - _ABOVE_BONE)
    except MeasurementError as error:
        writer.data["pennation"] = {"told": False, "why": error.what}
        writer.summary.append(f"pennation: {error.what}")
        return
    draw_pennation(image, found, writer.file("pennation_picture", "pennation.png"))
    writer.data["pennation"] = {
        "told": True, "pennation_deg": found.angle_deg, "deviation_deg": found.deviation_deg,
        "spread_deg": found.spread_deg, "coherence": found.coherence, "n_tiles": len(found.tile_deg),
        "from_mm": top, "to_mm": bone.distance - _ABOVE_BONE,
    }  # fmt: skip
    use = f"pennation_deg = {found.angle_deg:.1f}, deviation_deg = {found.deviation_deg:.1f}"
    writer.summary.append(
        f"pennation {found.angle_deg:.1f} deg in the image (deviation {found.deviation_deg:.1f}; tiles "
        f"spread by {found.spread_deg:.1f}), positive: deeper to the right; if the image is along "
        f"the fibres, use it: [[site.pennation]] {use}"
    )
