"""Are skin, bones and markers outlined correctly?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from limbcli.reporting.numbers import cell, figures_table
from limbcli.reporting.report_data import ReportData
from limbcli.reporting.reportlet import Cell, PageTable, Reportlet, pictures_of, table
from limbcli.reporting.sections.of_stage import of_stage
from limbcli.results import StageResult

TITLE_ASSUMED = "What is assumed about the limb's shape?"
_CAPTION = (
    "each outline follows the edge it belongs to in every slice, and the dark bone cortex lies inside the "
    "bone outline",
    "an outline that jumps between slices, cuts through skin, leaves out a bone's dark rim, or encloses a "
    "vein; a bone that is missing in some slices. Correct the label map in 3D Slicer and enter it as "
    "“labels” in case.toml",
)
_CAPTION_ASSUMED = (
    "the beam ends on the bone, and skin and bone lie as they do on the B-mode image",
    "a second bone, or one that is not round, near the beam: the model contains neither. The uncertainty "
    "covers the bone's radius and depth and the roundness of the limb; it does not cover other bones",
)
_HANDLED = {"markers", "geometry"}


@of_stage("segment", "segmentation", "Are skin and bones outlined correctly?")
def segmentation(result: StageResult, page: ReportData) -> Reportlet:
    """Contact sheet, markers and numbers of the segmentation."""
    alt = f"Slices of the imaging of subject {page.case.subject} with outlines of skin and bones."
    if page.case.imaging.assumed:
        alt = f"Sections of the assumed limb of subject {page.case.subject}: skin, bone and beam."
    rest = {key: value for key, value in result.data.items() if key not in _HANDLED}
    figures = figures_table("Figures of the segmentation", rest)
    look_for, bad = _CAPTION_ASSUMED if page.case.imaging.assumed else _CAPTION
    return Reportlet(
        title=TITLE_ASSUMED if page.case.imaging.assumed else "",
        mood="fine"
        if result.value("quality/verdict") in (None, "good") and not result.warnings
        else "warning",
        pictures=pictures_of(result, {"contact_sheet": ("segmentation", alt)}),
        tables=_markers(result.data["markers"]),
        more=(figures,) if figures.rows else (),
        look_for=look_for,
        bad=bad,
        notes=result.summary,
        warned=result.warnings,
    )


def _markers(markers: Sequence[Mapping[str, Any]]) -> tuple[PageTable, ...]:
    rows: list[tuple[Cell | str, ...]] = [
        (str(each["number"]), *(cell(value, digits=4) for value in each["position_mm"])) for each in markers
    ]
    names = ("marker", "L (left) [mm]", "P (posterior) [mm]", "S (head) [mm]")
    return (table("Skin markers, patient frame (LPS)", names, rows),) if rows else ()
