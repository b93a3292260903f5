"""Does the model deform like a limb, and its layers like those that were seen?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from limbcli.reporting.figures.deformed import DeformedState, section_figure
from limbcli.reporting.figures.scene import scene_of
from limbcli.reporting.figures.skin import skin_figure
from limbcli.reporting.numbers import quantity
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Picture, Reportlet, pictures_of, placeholder
from limbcli.reporting.sections.of_stage import of_stage
from limbcli.results import StageResult

TITLE = "Does the model deform like a limb?"
_NOT_RUN = "the model has not been run"
_CHANCE = 0.01  # probability of the layers' chi-square below which they contradict the model


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


@of_stage("fit", "layers", "Do skin, fat and muscle move as the model moves them?", silent=True)
def layers(result: StageResult, _: ReportData, site: SiteMaterial) -> Reportlet | None:
    """Measured and predicted layers, level by level; None if the site has none."""
    found = result.data.get("layers")
    if found is None:
        return None
    names, p = ", ".join(found["names"]), found["p"]
    alt = f"Borders of {names} below the probe at site {site.name}: measured points, predicted bands."
    moves_as_modelled = p is None or p >= _CHANCE
    return Reportlet(
        mood="neutral" if p is None else "fine" if moves_as_modelled else "warning",
        pictures=pictures_of(result, {"layers_picture": (f"layers-{site.name}", alt)}),
        look_for="points on the borders of the bands at every level: then one tissue moves as the layers do. "
        "The layer on the bone adds no information beyond the depth",
        bad="a layer that gets thinner much faster than its band (fat is softer than the rest), or hardly "
        "thinner at all (skin, or something stiff above the bone)",
        notes=_layer_notes(found),
        warned=()
        if moves_as_modelled
        else ("The layers do not move as in the fitted model: see the diagnosis.",),
    )


def _layer_notes(found: Mapping[str, Any]) -> tuple[str, ...]:
    notes = [
        f"{name}: measured minus predicted {quantity(each['last_mm'], 'mm', digits=2)} at the last level "
        f"({quantity(each['last_deviations'], 'deviations', digits=2)})."
        for name, each in found["measured_less_predicted"].items()
    ]
    notes.append(
        f"Chi-square {quantity(found['chi_square'], '')} for {found['n_readings']} readings, with "
        f"a deviation of {quantity(found['deviation_mm'], 'mm', digits=2)} of each thickness."
    )
    return tuple(notes)
