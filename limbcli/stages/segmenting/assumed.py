"""segment without images: the surfaces of a limb whose shape is assumed, marked as such in all results."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from limbcli.case import Case
from limbcli.drawing import put_title, save_picture
from limbcli.meshing.sections import section
from limbcli.results import StageWriter
from limbcli.stages.segmenting.assumed_geometry import AssumedLimb, ThicknessComparison, assumed_limb
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


_SKIN, _BONE, _BEAM, _FAT = "#b08000", "#c03028", "#0050d0", "#3a9a5b"


def draw_assumed(path: Path, limb: AssumedLimb, *, title: str) -> None:
    """Draw a section across the bone through every site's place, with the beam, and the layers if known."""
    names = list(limb.sites) or [""]
    figure = Figure(figsize=(5.2 * len(names) + 1.5, 6.0), layout="constrained")
    for number, name in enumerate(names, 1):
        _draw_section(figure.add_subplot(1, len(names), number), limb, name, limb.sites.get(name))
    put_title(figure, title, size=10.0)
    save_picture(figure, path, dpi=90)


def _draw_section(axes: Axes, limb: AssumedLimb, name: str, site: ThicknessComparison | None) -> None:
    rod = limb.bones[site.bone] if site is not None else next(iter(limb.bones.values()))
    origin = np.array(site.point) if site is not None else rod.centre + rod.radius * rod.towards
    up = np.array(site.normal) if site is not None else rod.towards
    up = up - (up @ rod.axis) * rod.axis
    up /= np.linalg.norm(up)
    across = np.cross(rod.axis, up)
    for each, surface in limb.surfaces.items():
        pieces = section(surface, origin, rod.axis)
        colour = _SKIN if each == "skin" else _BONE
        for k, piece in enumerate((pieces - origin) @ np.stack([across, up], axis=1)):
            axes.plot(*piece.T, color=colour, linewidth=1.4, label=each if k == 0 else None)
    if limb.shape is not None:
        angle = np.linspace(0, 2 * np.pi, 181)
        for word, below in (
            ("skin to fat", limb.shape.skin),
            ("fat to muscle", limb.shape.skin + limb.shape.fat),
        ):
            radius = limb.shape.radius - below
            axes.plot(radius * np.cos(angle), radius * np.sin(angle) - limb.shape.radius, color=_FAT,
                      linewidth=0.7, linestyle="--", label=word)  # fmt: skip
    if site is not None:
        axes.plot([0, 0], [0, -site.measured], color=_BEAM, linewidth=2.0, marker="_", label="measured")
        axes.set_title(f"site {name}: {site.measured:g} mm from skin to bone ({site.source})", fontsize=9)
    axes.set(xlabel="across the limb [mm]", ylabel="above the skin at the site [mm]")
    axes.set_aspect("equal")
    axes.grid(True, linewidth=0.4, alpha=0.5)
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
