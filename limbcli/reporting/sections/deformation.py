"""Does the model deform like a limb, and its layers like those that were seen?"""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.reporting.figures.deformed import DeformedState, section_figure
from limbcli.reporting.figures.scene import scene_of
from limbcli.reporting.figures.skin import skin_figure
from limbcli.reporting.numbers import quantity
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Picture, Reportlet, pictures_of, placeholder

TITLE = "Does the model deform like a limb?"
_OF_LAYERS = "Do skin, fat and muscle move as the model moves them?"
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


def layers(page: ReportData, site: SiteMaterial) -> Reportlet | None:
    """Measured and predicted layers, level by level; None if the site has none."""
    result = page.outcomes.of("fit", site.name).result
    layers = result.data.get("layers") if result else None
    if result is None or not isinstance(layers, dict):
        return None
    key = f"layers-{site.name}"
    pictures = pictures_of(result, {"layers_picture": (key, _layer_alt(layers, site.name))})
    if not pictures:
        return None
    p = layers.get("p")
    fits = not isinstance(p, int | float) or p >= 0.01
    return Reportlet(
        key,
        _OF_LAYERS,
        "neutral" if not isinstance(p, int | float) else "fine" if fits else "warning",
        site.name,
        pictures=pictures,
        look_for="points on the borders of the bands at every level: then one tissue moves as the layers do. "
        "The layer on the bone adds no information beyond the depth",
        bad="a layer that gets thinner much faster than its band (fat is softer than the rest), or hardly "
        "thinner at all (skin, or something stiff above the bone)",
        notes=_layer_notes(layers),
        warned=() if fits else ("The layers do not move as in the fitted model: see the diagnosis.",),
    )


def _layer_alt(layers: dict[str, Any], site: str) -> str:
    names = ", ".join(map(str, layers.get("names", [])))
    return f"Borders of {names} below the probe at site {site}: measured points, predicted bands."


def _layer_notes(layers: dict[str, Any]) -> tuple[str, ...]:
    found = layers.get("measured_less_predicted") or {}
    notes = [
        f"{name}: measured minus predicted {quantity(each.get('last_mm'), 'mm', digits=2)} at the last level "
        f"({quantity(each.get('last_deviations'), 'deviations', digits=2)})."
        for name, each in found.items()
        if isinstance(each, dict)
    ]
    notes.append(
        f"Chi-square {quantity(layers.get('chi_square'), '')} for {layers.get('n_readings')} readings, with "
        f"a deviation of {quantity(layers.get('deviation_mm'), 'mm', digits=2)} of each thickness."
    )
    return tuple(notes)
