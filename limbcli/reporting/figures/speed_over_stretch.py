"""Speed at rest over stretch: the states, the curve of the fitted law, and its minimum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from limbcli.model import Array
from limbcli.reporting.figures.style import (
    BLUE,
    GREEN,
    INK,
    MARKERS,
    QUIET,
    VERMILION,
    literal,
    new_figure,
    style,
)


@dataclass(frozen=True)
class StateReading:
    """A state: its stretch (-) with 95 % ends, and its speed at rest with one standard deviation (m/s)."""

    name: str
    stretch: float
    low: float
    high: float
    speed: float
    deviation: float


@dataclass(frozen=True, eq=False, kw_only=True)
class StatesPanel:
    """One direction of stretch.

    counted : scale of the stretch: "case", that of the case, or "unloaded"
    stretch, speed : (n,) curve of the fitted law
    unloaded : the stretch at which the tissue is unloaded
    lowest : stretch of minimum speed with its 95 % ends; None if the data do not determine it
    """

    way: str
    counted: str
    readings: Sequence[StateReading]
    stretch: Array
    speed: Array
    unloaded: float
    lowest: tuple[float, float, float] | None


def states_figure(panels: Sequence[StatesPanel]) -> Figure:
    """One panel per direction; the interval of the minimum is shaded, or its absence stated."""
    with style():
        rows = max(len(each.readings) for each in panels)
        figure = new_figure(7.2 if len(panels) == 1 else 9.6, 4.0 + 0.2 * rows)
        for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
            _draw(axes, panel, 2 if len(panels) == 1 else 1)
    return figure


def _draw(axes: Axes, panel: StatesPanel, columns: int) -> None:
    axes.plot(panel.stretch, panel.speed, color=BLUE, label="fitted law, evenly stretched", zorder=3)
    for k, each in enumerate(panel.readings):
        axes.errorbar(
            [each.stretch], [each.speed], xerr=[[each.stretch - each.low], [each.high - each.stretch]],
            yerr=[each.deviation], fmt=MARKERS[k % len(MARKERS)], ms=5.5, color=INK, ecolor=QUIET, capsize=3,
            zorder=4, label=f"at rest (±1 SD): {literal(each.name).strip()}",
        )  # fmt: skip
    axes.axvline(panel.unloaded, color=GREEN, lw=1.2, ls=":", label="unloaded")
    if panel.lowest is not None:
        at, low, high = panel.lowest
        axes.axvspan(low, high, color=VERMILION, alpha=0.15, lw=0)
        axes.axvline(at, color=VERMILION, lw=1.2, ls="--", label="lowest speed (95 % shaded)")
    else:
        axes.set_title(
            "these data do not determine the state of least stiffness", fontsize=9, color=VERMILION
        )
    counted = "on the scale of the case" if panel.counted == "case" else "of the unloaded length"
    axes.set(
        xlabel=f"stretch {panel.way} the limb, {counted} [–]", ylabel="shear-wave speed at rest [m/s]",
    )  # fmt: skip
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), fontsize=8.5, ncols=columns)
