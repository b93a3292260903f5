"""measure: skin, fat and muscle on the B-mode images, as columns of levels.csv."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from limbcli.measurement.bmode import BoneLine
from limbcli.measurement.bmode_layers import Stated, follow_borders
from limbcli.measurement.ultrasound_image import UltrasoundImage
from limbcli.results import StageWriter

_FOLLOWED = ("skin", "fat")


def read_borders(
    images: Sequence[UltrasoundImage], table: Mapping[str, Any], bone: Sequence[BoneLine], writer: StageWriter
) -> dict[str, list[BoneLine]]:
    """Track the layers' lower borders that [site.b_mode] gives at level 0; by name. Adds a summary.

    Raises
    ------
    MeasurementError
        As `follow_borders`.
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
