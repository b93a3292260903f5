"""Parameters of several sites side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from limbcli.reporting.figures.style import INK, literal, new_figure, style
from limbcli.reporting.fit_view import EstimateView

_COLUMNS = (("c", "c [kPa]"), ("m", "m [–]"), ("κ′", "κ′ [kPa]"))
_OPEN = "#8a8a8a"


@dataclass(frozen=True)
class StudyRow:
    """A site's label and what is known of c, m and kappa', by symbol."""

    label: str
    estimates: dict[str, EstimateView]


def study_figure(rows: Sequence[StudyRow]) -> Figure:
    """A row a site, a panel a parameter: a dot with its interval where the data hold a value, else the side
    that is not excluded as an arrow."""
    with style():
        figure = new_figure(8.6, 1.1 + 0.34 * max(len(rows), 2))
        panels = figure.subplots(1, len(_COLUMNS), sharey=True)
        for axes, (name, label) in zip(panels, _COLUMNS, strict=True):
            for k, row in enumerate(rows):
                if name in row.estimates:
                    _draw(axes, k, row.estimates[name])
            axes.set_xscale("log")
            axes.set(xlabel=label)
            axes.grid(True, axis="x", linewidth=0.4, alpha=0.5)
        panels[0].set_yticks(range(len(rows)), [literal(row.label) for row in rows])
        panels[0].set_ylim(len(rows) - 0.5, -0.5)
    return figure


def _draw(axes: object, k: int, each: EstimateView) -> None:
    plot = axes.plot  # type: ignore[attr-defined]
    if each.is_sound and each.value:
        if each.low and each.high:
            plot([each.low, each.high], [k, k], color=INK, lw=1.4)
        plot([each.value], [k], "o", color=INK, markersize=5)
    elif each.low and each.high:
        plot([each.low, each.high], [k, k], color=_OPEN, lw=1.4)
        plot([each.low, each.high], [k, k], "|", color=_OPEN, markersize=7)
    elif each.low:
        plot([each.low], [k], marker=9, color=_OPEN, markersize=8)  # towards larger values
    elif each.high:
        plot([each.high], [k], marker=8, color=_OPEN, markersize=8)  # towards smaller values
