"""Parameters of several sites in comparison."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from limbcli.reporting.figures.style import INK, literal, new_figure, plain_log, style
from limbcli.reporting.fit_view import EstimateView

_COLUMNS = (("c", "c [kPa]"), ("m", "m [–]"), ("κ′", "κ′ [kPa]"))
_OPEN = "#8a8a8a"
_NAME_WIDTH = 28  # characters per line of a label


@dataclass(frozen=True)
class StudyRow:
    """Label of a site, and its estimates of c, m and kappa', by symbol."""

    label: str
    estimates: dict[str, EstimateView]


def study_figure(rows: Sequence[StudyRow]) -> Figure:
    """One row per site, one panel per parameter: a dot with its interval if the data determine a value, else
    an arrow on the side that is not excluded."""
    with style():
        names = [textwrap.fill(row.label, _NAME_WIDTH) for row in rows]
        lines = max((name.count("\n") + 1 for name in names), default=1)
        figure = new_figure(9.2, 1.5 + (0.2 + 0.14 * lines) * max(len(rows), 2))
        panels = figure.subplots(1, len(_COLUMNS), sharey=True)
        for axes, (name, label) in zip(panels, _COLUMNS, strict=True):
            for k, row in enumerate(rows):
                if name in row.estimates:
                    _draw(axes, k, row.estimates[name], literal(row.label))
            drawn = any(_is_drawn(row.estimates.get(name)) for row in rows)
            if drawn:
                axes.set_xscale("log")
                plain_log(axes.xaxis, few=True)
            else:
                axes.set_xticks([])
                axes.text(0.5, 0.5, "not known", ha="center", transform=axes.transAxes, color=_OPEN)
            axes.set(xlabel=label)
            axes.grid(True, axis="x", linewidth=0.4, alpha=0.5)
        panels[0].set_yticks(range(len(rows)), [literal(name) for name in names], fontsize=8.5)
        panels[0].set_ylim(len(rows) - 0.5, -0.5)
        marks = [
            Line2D([], [], color=INK, marker="o", markersize=5, lw=1.4, label="value, 95 % interval"),
            Line2D([], [], color=_OPEN, marker="|", markersize=7, lw=1.4, label="no value, within (95 %)"),
            Line2D([], [], color=_OPEN, marker=9, ms=8, lw=0, label="no value, beyond this end (95 %)"),
        ]
        figure.legend(handles=marks, loc="outside lower center", ncols=3, fontsize=8.5)
    return figure


def _is_drawn(each: EstimateView | None) -> bool:
    return each is not None and bool(each.low or each.high or (each.is_sound and each.value))


def _draw(axes: Axes, k: int, each: EstimateView, name: str) -> None:
    plot, within = axes.plot, f"{name}, 95 %"
    if each.is_sound and each.value:
        if each.low and each.high:
            plot([each.low, each.high], [k, k], color=INK, lw=1.4, label=within)
        plot([each.value], [k], "o", color=INK, markersize=5, label=name)
    elif each.low and each.high:
        plot([each.low, each.high], [k, k], "|-", color=_OPEN, lw=1.4, markersize=7, label=within)
    elif each.low:
        plot([each.low], [k], marker=9, color=_OPEN, markersize=8, label=f"{name}, above")
    elif each.high:
        plot([each.high], [k], marker=8, color=_OPEN, markersize=8, label=f"{name}, below")
