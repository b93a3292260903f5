"""measure: the pennation angle of muscle fibres on the B-mode image of level 0."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from limbcli.errors import MeasurementError
from limbcli.measurement.bmode import BoneLine
from limbcli.measurement.instrument_pictures import draw_pennation
from limbcli.measurement.pennation import read_pennation
from limbcli.measurement.ultrasound_image import UltrasoundImage
from limbcli.results import StageWriter

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
