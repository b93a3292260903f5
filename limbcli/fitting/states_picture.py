"""The figure of a fit of several states: speed at rest against stretch, and where it is lowest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from limbcli.drawing import save_figure
from limbcli.fitting.fitted_states import FittedStates
from limbcli.fitting.least_stiffness import LeastStiffness
from limbcli.fitting.state_plan import HIGH, LOW
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
from limbcli.results import StageWriter


def draw_states(fit: FittedStates, lowest: Sequence[LeastStiffness], writer: StageWriter) -> None:
    """Draw states.png: one panel for every direction in which states are stretched."""
    save_figure(states_figure([_panel(each, fit) for each in lowest]), writer.file("states", "states.png"))


def _panel(each: LeastStiffness, fit: FittedStates) -> StatesPanel:
    plan, problem, best = fit.plan, fit.problem, fit.found.best
    way, column = each.way, plan.ways.index(each.way)
    values = dict(zip([one.name for one in plan.parameters], fit.stretch_values, strict=True))
    searched = float(values.get(f"unloaded_stretch_{way}", plan.unloaded.get(way, 1.0)))
    zero = searched if each.counted == "case" else 1.0
    readings = [_reading(k, way, zero, fit) for k in range(len(fit.site.states))]
    by_law = np.exp([each.by_law.value, each.by_law.low, each.by_law.high])
    shown = [end for one in readings for end in (one.low, one.high)]
    shown += [zero, *(by_law if each.is_determined else ())]
    grid = np.geomspace(max(0.95 * min(shown), LOW * zero), min(1.05 * max(shown), HIGH * zero), 81)
    stretches = np.ones((len(grid), len(plan.ways)))
    stretches[:, column] = grid / zero
    ratio = problem.c_of_curve(best) / problem.task.c0
    speed = np.exp(fit.curve.even_speeds(problem.curve_shape(best), stretches)) * np.sqrt(ratio)
    lowest = (float(by_law[0]), float(by_law[1]), float(by_law[2])) if each.is_determined else None
    return StatesPanel(
        way=way, counted=each.counted, readings=readings, stretch=grid, speed=speed, unloaded=zero,
        lowest=lowest,
    )  # fmt: skip


def _reading(k: int, way: str, zero: float, fit: FittedStates) -> StateReading:
    """A state's point in the figure; a given stretch has no interval, as it is exact on the case's scale."""
    data, given = fit.problem.task.states[k].data, fit.given(way)[k]
    rest = int(np.argmin(data.speed_force))
    speed = float(np.exp(data.log_speed[rest]))
    if given is None:
        stretch = zero * fit.elastic(k, way)
        low, high = fit.stretch_ends(k, way)
        ends = (zero * (LOW if low is None else low), zero * (HIGH if high is None else high))
    else:
        stretch, ends = float(given), (float(given), float(given))
    name = fit.site.states[k].name
    return StateReading(name, stretch, *ends, speed, speed * float(data.speed_deviation[rest]))


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
