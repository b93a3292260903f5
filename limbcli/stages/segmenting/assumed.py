"""segment without images: the surfaces of a limb whose shape is assumed, marked as such in all results."""

from __future__ import annotations

from limbcli.case import Case
from limbcli.results import StageWriter
from limbcli.stages.segmenting.assumed_geometry import assumed_limb
from limbcli.stages.segmenting.assumed_picture import draw_assumed
from limbcli.stages.segmenting.possible_sites import report_places
from limbcli.stages.segmenting.surfaces import check_limb, frames_of, write_surfaces

ASSUMED = "assumed"
FIX = "use an MRI or surfaces of the bones where results depend on it; a fit's intervals allow for it"


def from_assumed(case: Case, writer: StageWriter, *, accept_bones: bool = False) -> None:
    """Write skin and bones under the usual names, from numbers or from a scanned skin and ultrasound."""
    limb = assumed_limb(case)
    words = case.imaging.assumed
    writer.data["source"] = "numbers" if limb.shape is not None else "skin and ultrasound"
    writer.data["markers"] = []
    writer.data["geometry"] = limb.to_json(words)
    writer.summary.append(words)
    writer.warnings.append(words)
    writer.summary.extend(frames_of(case)[0])
    where = str(case.imaging.skin or case.file)
    surfaces = check_limb(limb.surfaces, case, writer, where=where, accept_bones=accept_bones)
    write_surfaces(surfaces, writer)
    report_places(case, surfaces, [], writer)
    for name, each in limb.sites.items():
        made = "no bone" if each.made is None else f"{each.made:.1f} mm"
        writer.summary.append(
            f"site {name}: {each.measured:g} mm from skin to bone ({each.source}), {made} in the model"
        )
    writer.summary.extend(limb.notes)
    writer.warnings.extend(limb.warnings)
    if limb.shape is not None:
        writer.data["layers"] = {
            name: {"skin_mm": limb.shape.skin, "fat_mm": limb.shape.fat} for name in limb.sites
        }
    writer.data["quality"] = {"verdict": ASSUMED}
    draw_assumed(writer.file("contact_sheet", "contact-sheet.png"), limb, title=f"{case.subject}: {words}")
