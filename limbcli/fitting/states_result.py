"""The outputs of the fit of several states: fit-states.json, tables, figures, and each state for FEBio."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from limbcli.drawing import save_figure
from limbcli.effects.tissue import fibre_direction
from limbcli.feb.write import write_feb
from limbcli.fitting.exports import parameter_rows, write_exports
from limbcli.fitting.joint_picture import draw_joint
from limbcli.fitting.joint_result import parameter_table, report_fit, write_level_table, write_numbers
from limbcli.fitting.least_stiffness import FittedStates, LeastStiffness, least_stiffness
from limbcli.fitting.state_plan import HIGH, LOW, StretchPlan
from limbcli.model import Array, LimbModel
from limbcli.numbers.interval_limits import Flag
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
from limbcli.reporting.headline import headline
from limbcli.results import StageWriter
from limbcli.site_model.indentation_model import TISSUE
from limbcli.site_model.prestretch import WAYS, through_depths

_WIDE = 1.35  # ratio of the ends of a stretch's interval above which it is called weakly identified


def write_states(fit: FittedStates, model: LimbModel, writer: StageWriter) -> None:
    """Write fit-states.json, tables, exports, figures and a model of each state."""
    law, plan, problem, found = fit.law, fit.plan, fit.problem, fit.found
    parameters = _with_stretches_judged(parameter_table(problem, found), plan)
    c, shape = float(found.best[0]), found.best[1 : 1 + problem.n_shape]
    lowest = least_stiffness(fit)
    write_numbers(writer, "states", law, parameters, found, [model], problem.task.curves[0].n_solves)
    writer.data.update(
        states={each.name: _state(k, fit) for k, each in enumerate(fit.site.states)},
        least_stiffness={each.way: each.to_json() for each in lowest},
        taken_as_unloaded={way: plan.unloaded[way] for way in plan.taken},
        undetermined=_undetermined(parameters, plan, lowest),
        gain=problem.blocks[0].place(found.best)[1],
        gain_deviation_fraction=problem.task.data[0].gain_deviation,
    )  # fmt: skip
    fitted = model.with_material(TISSUE, law.along(fibre_direction(model)).material(c, shape))
    seen = [each.predict(found.best) for each in problem.blocks]
    write_level_table(writer, problem.task.data, seen)
    write_exports(writer, parameter_rows(fit.site.name, law.name, parameters), fitted)
    draw_joint(problem.task.data, seen, found, writer, file="fit-states.png", of="state")
    save_figure(states_figure([_panel(each, fit) for each in lowest]), writer.file("states", "states.png"))
    _write_models(fit, model, writer)
    notes = [each.words() for each in lowest]
    for way, stretch in writer.data["taken_as_unloaded"].items():
        notes.append(f"{way} the limb all states have a stretch of {stretch:g}: taken as unloaded there")
    writer.warnings += writer.data["undetermined"]
    report_fit(writer, law, parameters, found, notes)


def _with_stretches_judged(table: dict[str, dict[str, Any]], plan: StretchPlan) -> dict[str, dict[str, Any]]:
    """Flag stretches with wide intervals as weak: a useful stretch is known to a few hundredths, while the
    general limit, a factor of three, is as wide as all possible values."""
    for parameter in plan.parameters:
        each = table[parameter.name]
        low, high = each["low"], each["high"]
        if each["flag"] == Flag.IDENTIFIED and high / low > _WIDE:
            each["flag"] = Flag.WEAK
            each["headline"] = str(headline(each["value"], low, high, each["flag"]))
            each["words"] = f"{parameter.name} is only weakly identified: {low:.3g} to {high:.3g} (95 %)."
    return table


def _state(k: int, fit: FittedStates) -> dict[str, Any]:
    """One state: its given stretches, its elastic stretches with their intervals, its speed at rest."""
    data, seen = fit.problem.task.data[k], fit.problem.blocks[k].predict(fit.found.best)
    out = {}
    for way in WAYS:
        low, high = fit.stretch_ends(k, way)
        out[f"stretch_{way}"] = {
            "told": fit.given(way)[k], "value": fit.elastic(k, way), "low": low, "high": high,
            "known": fit.plan.is_known(k, way),
        }  # fmt: skip
    rest = int(np.argmin(data.speed_force))
    return {
        **out,
        "swe_at_rest_m_per_s": float(np.exp(data.log_speed[rest])),
        "swe_at_rest_fitted_m_per_s": float(np.exp(seen.log_speed[rest])),
        "n_levels": len(data.force),
        "depth_rms_mm": float(np.sqrt(np.mean((data.depth - seen.depth) ** 2))),
        "speed_rms_fraction": float(np.sqrt(np.mean((data.log_speed - seen.log_speed) ** 2))),
    }


def _undetermined(
    parameters: dict[str, dict[str, Any]], plan: StretchPlan, lowest: Sequence[LeastStiffness]
) -> list[str]:
    """One sentence for each quantity that these data do not determine."""
    stretches = [each.name for each in plan.parameters]
    found = [
        f"not determined by these data: {each['words'].rstrip('.')}"
        for name, each in parameters.items()
        if each["low"] is None
        or each["high"] is None
        or (name in stretches and each["flag"] != Flag.IDENTIFIED)
    ]
    return found + [each.words() for each in lowest if not each.is_determined]


def _write_models(fit: FittedStates, model: LimbModel, writer: StageWriter) -> None:
    """Write <state>.feb: the fitted law with the state's prestretch, driven through the simulated depths."""
    problem, best = fit.problem, fit.found.best
    c = problem.task.c0 * problem.blocks[0].place(best)[0]
    base = through_depths(model, [float(each) for each in fit.curve.depths], clear=False)
    for k, state in enumerate(fit.site.states):
        fitted = fit.curve.in_state(base, problem.place(k, best), c=c)
        write_feb(fitted, writer.file(f"feb_{state.name}", f"{state.name}.feb"))


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
    ratio = problem.blocks[0].place(best)[0]
    speed = np.exp(fit.curve.even_speeds(problem.curve_shape(best), stretches)) * np.sqrt(ratio)
    lowest = (float(by_law[0]), float(by_law[1]), float(by_law[2])) if each.is_determined else None
    return StatesPanel(
        way=way, counted=each.counted, readings=readings, stretch=grid, speed=speed, unloaded=zero,
        lowest=lowest,
    )  # fmt: skip


def _reading(k: int, way: str, zero: float, fit: FittedStates) -> StateReading:
    """A state's point in the figure; a given stretch has no interval, as it is exact on the case's scale."""
    data, given = fit.problem.task.data[k], fit.given(way)[k]
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
    """One direction of stretch, counted on the scale of the "case" or from "unloaded".

    stretch, speed : (n,) curve of the fitted law; unloaded : the stretch at which the tissue is unloaded
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
