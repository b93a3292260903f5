"""Do the layers deform as in the model?"""

from __future__ import annotations

from typing import Any

from limbcli.reporting.numbers import quantity
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Reportlet, pictures_of

TITLE = "Do skin, fat and muscle move as the model moves them?"


def layers(page: ReportData, site: SiteMaterial) -> Reportlet | None:
    """Measured and predicted layers, level by level; None if the site has none."""
    result = page.outcomes.of("fit", site.name).result
    layers = result.data.get("layers") if result else None
    if result is None or not isinstance(layers, dict):
        return None
    key = f"layers-{site.name}"
    pictures = pictures_of(result, {"layers_picture": (key, _alt(layers, site.name))})
    if not pictures:
        return None
    p = layers.get("p")
    fits = not isinstance(p, int | float) or p >= 0.01
    return Reportlet(
        key,
        TITLE,
        "neutral" if not isinstance(p, int | float) else "fine" if fits else "warning",
        site.name,
        pictures=pictures,
        look_for="points on the borders of the bands at every level: then one tissue moves as the layers do. "
        "The layer on the bone adds no information beyond the depth",
        bad="a layer that gets thinner much faster than its band (fat is softer than the rest), or hardly "
        "thinner at all (skin, or something stiff above the bone)",
        notes=_notes(layers),
        warned=() if fits else ("The layers do not move as in the fitted model: see the diagnosis.",),
    )


def _alt(layers: dict[str, Any], site: str) -> str:
    names = ", ".join(map(str, layers.get("names", [])))
    return f"Borders of {names} below the probe at site {site}: measured points, predicted bands."


def _notes(layers: dict[str, Any]) -> tuple[str, ...]:
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
