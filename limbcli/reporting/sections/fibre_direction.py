"""What is the direction of the muscle fibres, and on what evidence?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Reportlet, pictures_of
from limbcli.reporting.sections.of_stage import of_stage
from limbcli.results import StageResult

_USE = (
    "The direction is used by “anisotropy” and “contraction” of a diagnosis and by the law “fibres” of a "
    "joint fit; the Ogden-type law has no fibres."
)


@of_stage("mesh", "fibres", "Which way do the muscle fibres run?", silent=True)
def fibres(result: StageResult, _: ReportData, site: SiteMaterial) -> Reportlet | None:
    """The picture and sentences written by `mesh`; None if it was not run."""
    found = result.data.get("fibres")
    if not isinstance(found, Mapping):
        return None
    alt = f"Two cuts through site {site.name} with the direction of the muscle fibres as short lines."
    return Reportlet(
        pictures=pictures_of(result, {"fibre_picture": (f"fibres-{site.name}", alt)}),
        look_for="lines that run as the muscle does: along the limb, or at its pennation angle",
        bad="lines that point out of the skin or cross the limb (wrong frame, flipped "
        "sign), or an unmeasured direction where a result depends on it",
        notes=(*_words(found), _USE),
    )


def _words(found: Mapping[str, Any]) -> Sequence[str]:
    lines = [f"Fibres: {found.get('source')}."]
    deviation, out, beside = (
        found.get(name) for name in ("deviation_deg", "out_of_skin_deg", "to_image_plane_deg")
    )
    if isinstance(out, float) and isinstance(beside, float):
        lines.append(
            f"On average they run {beside:.0f}° from the probe's long side and {out:.0f}° out of the skin's "
            "plane."
        )
    if isinstance(deviation, float):
        lines.append(f"One standard deviation of that direction: {deviation:.1f}°.")
    if isinstance(found.get("agreement_of_neighbours"), float):
        lines.append(
            f"{100 * found['covered_share']:.0f} % of the tissue's elements lie within the map, "
            f"{100 * found['from_nearest_share']:.0f} % take the nearest direction, "
            f"{100 * found['from_mean_share']:.0f} % the mean near the probe; neighbouring voxels agree to "
            f"{found['agreement_of_neighbours']:.2f} (1: all along one axis)."
        )
    return lines
