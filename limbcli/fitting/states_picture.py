"""The figure of a fit of several states: speed at rest against stretch, and where it is lowest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from limbcli.case import Site
from limbcli.drawing import save_figure
from limbcli.fitting.least_stiffness import LeastStiffness
from limbcli.fitting.state_curve import StateCurve
from limbcli.fitting.state_plan import HIGH, LOW, StretchPlan
from limbcli.inference.adaptive import Intervals
from limbcli.inference.states_fit import StatesProblem
from limbcli.reporting.figures.speed_over_stretch import StateReading, StatesPanel, states_figure
from limbcli.results import StageWriter


def draw_states(
    writer: StageWriter, site: Site, plan: StretchPlan, curve: StateCurve, problem: StatesProblem,
    found: Intervals, lowest: Sequence[LeastStiffness],
) -> None:  # fmt: skip
    """Draw states.png: one panel for every direction in which states are stretched."""
    panels = [_panel(each, site, plan, curve, problem, found) for each in lowest]
    save_figure(states_figure(panels), writer.file("states", "states.png"))


def stretch_ends(k: int, way: str, plan: StretchPlan, found: Intervals) -> tuple[float | None, float | None]:
    """95 % interval of a state's elastic stretch, which depends on at most one parameter; None if open."""
    if way not in plan.ways:
        return 1.0, 1.0
    w = plan.ways.index(way)
    base, places = float(np.exp(plan.offsets[k, w])), np.flatnonzero(plan.factors[k, w])
    if not len(places):
        return base, base
    profile = found.profiles[plan.parameters[int(places[0])].name]
    low, high = profile.limits
    if plan.factors[k, w, int(places[0])] > 0:
        return low, high
    return None if high is None else base / high, None if low is None else base / low


def _panel(
    each: LeastStiffness, site: Site, plan: StretchPlan, curve: StateCurve, problem: StatesProblem,
    found: Intervals,
) -> StatesPanel:  # fmt: skip
    way, column = each.way, plan.ways.index(each.way)
    values = dict(zip([one.name for one in plan.parameters], problem.stretch_values(found.best), strict=True))
    searched = float(values.get(f"unloaded_stretch_{way}", plan.unloaded.get(way, 1.0)))
    zero = searched if each.counted == "case" else 1.0
    readings = [_reading(k, site, way, zero, plan, problem, found) for k in range(len(site.states))]
    by_law = np.exp([each.by_law.value, each.by_law.low, each.by_law.high])
    shown = [end for one in readings for end in (one.low, one.high)]
    shown += [zero, *(by_law if each.is_determined else ())]
    grid = np.geomspace(max(0.95 * min(shown), LOW * zero), min(1.05 * max(shown), HIGH * zero), 81)
    stretches = np.ones((len(grid), len(plan.ways)))
    stretches[:, column] = grid / zero
    ratio = problem.c_of_curve(found.best) / problem.task.c0
    speed = np.exp(curve.even_speeds(problem.curve_shape(found.best), stretches)) * np.sqrt(ratio)
    lowest = (float(by_law[0]), float(by_law[1]), float(by_law[2])) if each.is_determined else None
    return StatesPanel(
        way=way, counted=each.counted, readings=readings, stretch=grid, speed=speed, unloaded=zero,
        lowest=lowest,
    )  # fmt: skip


def _reading(
    k: int, site: Site, way: str, zero: float, plan: StretchPlan, problem: StatesProblem, found: Intervals
) -> StateReading:
    """A state's point in the figure; a given stretch has no interval, as it is exact on the case's scale."""
    state, data = site.states[k], problem.task.states[k].data
    rest = int(np.argmin(data.speed_force))
    speed = float(np.exp(data.log_speed[rest]))
    given = getattr(state.stretch, way)
    if given is None:
        stretch = zero * plan.elastic(k, way, problem.stretch_values(found.best))
        low, high = stretch_ends(k, way, plan, found)
        ends = (zero * (LOW if low is None else low), zero * (HIGH if high is None else high))
    else:
        stretch, ends = float(given), (float(given), float(given))
    return StateReading(state.name, stretch, *ends, speed, speed * float(data.speed_deviation[rest]))
