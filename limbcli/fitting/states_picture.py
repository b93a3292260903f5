"""The figure of a fit of several states: speed at rest against stretch, and where it is lowest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from limbcli.drawing import save_figure
from limbcli.fitting.fitted_states import FittedStates
from limbcli.fitting.least_stiffness import LeastStiffness
from limbcli.fitting.state_plan import HIGH, LOW
from limbcli.reporting.figures.speed_over_stretch import StateReading, StatesPanel, states_figure
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
