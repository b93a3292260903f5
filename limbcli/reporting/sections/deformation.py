"""Does the model deform like a limb?"""

from __future__ import annotations

import numpy as np

from limbcli.reporting.figures.deformed import DeformedState, section_figure
from limbcli.reporting.figures.scene import scene_of
from limbcli.reporting.figures.skin import skin_figure
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Picture, Reportlet, placeholder

TITLE = "Does the model deform like a limb?"
_NOT_RUN = "the model has not been run"


def deformation(page: ReportData, site: SiteMaterial) -> Reportlet:
    """A section under the probe and an outside view of the skin, at the deepest level."""
    key = f"deformation-{site.name}"
    state = site.deformed
    if state is None:
        outcome = page.outcomes.of("run", site.name)
        if outcome.status != "done":
            return placeholder(key, TITLE, outcome)
        return Reportlet(key, TITLE, "missing", site.name, notes=(site.why_not_deformed or _NOT_RUN,))
    most = float(state.depth)
    pictures = (
        Picture(
            f"section-{site.name}",
            f"Section through the model at site {site.name} in the probe's long plane at {most:.1f} mm "
            "depth: displacement is largest under the probe and fades towards the bones and the cut faces.",
            figure=section_figure(state),
            vector=False,
        ),
        Picture(
            f"skin-{site.name}",
            f"Skin of the model at site {site.name} seen from outside, dented by the probe to {most:.1f} mm.",
            figure=skin_figure(state),
            vector=False,
            scene=scene_of(state),
        ),
    )
    return Reportlet(
        key,
        TITLE,
        "neutral",
        site.name,
        pictures=pictures,
        look_for="a smooth bowl under the probe that fades before it reaches the cut faces, skin that "
        "follows the probe's face, and the largest compression between probe and bone",
        bad="skin that penetrates the probe, a checkerboard or spikes in the compression (locking, or a "
        "nearly collapsed element), or displacement that is still large at a cut face (the model is too "
        "small)",
        notes=tuple(_notes(site, state)),
    )


def _notes(site: SiteMaterial, state: DeformedState) -> list[str]:
    notes = [f"Drawn from {site.deformed_source}, at {state.depth:.1f} mm depth."]
    if state.stretch is None:
        notes.append("The run recorded no deformation gradients, so the compression is not shown.")
    elif not np.isfinite(state.stretch).all():
        notes.append("The compression is recorded around the scanner's window only; grey is not recorded.")
    return notes
