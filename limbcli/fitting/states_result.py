"""The outputs of the fit of several states: fit-states.json, tables, figures, and each state for FEBio."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from limbcli.effects.tissue import fibre_direction
from limbcli.feb.write import write_feb
from limbcli.fitting.exports import parameter_rows, write_exports
from limbcli.fitting.fitted_states import FittedStates
from limbcli.fitting.joint_picture import draw_joint
from limbcli.fitting.joint_result import parameter_table, report_fit, write_level_table, write_numbers
from limbcli.fitting.least_stiffness import LeastStiffness, least_stiffness
from limbcli.fitting.state_plan import StretchPlan
from limbcli.fitting.states_picture import draw_states
from limbcli.model import LimbModel
from limbcli.numbers.interval_limits import Flag
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
    write_numbers(writer, "states", law, parameters, found, [model], problem.task.curve.n_solves)
    writer.data.update(
        states={each.name: _state(k, fit) for k, each in enumerate(fit.site.states)},
        least_stiffness={each.way: each.to_json() for each in lowest},
        taken_as_unloaded={way: plan.unloaded[way] for way in plan.taken},
        undetermined=_undetermined(parameters, plan, lowest),
        gain=problem.gain(found.best), gain_deviation_fraction=problem.task.gain_deviation,
    )  # fmt: skip
    fitted = model.with_material(TISSUE, law.along(fibre_direction(model)).material(c, shape))
    several = [each.data for each in problem.task.states]
    write_level_table(writer, several, lambda k: problem.predict(k, found.best))
    write_exports(writer, parameter_rows(fit.site.name, law.name, parameters), fitted)
    draw_joint(
        several, lambda k: problem.predict(k, found.best), found, writer, file="fit-states.png", of="state"
    )
    draw_states(fit, lowest, writer)
    _write_models(fit, model, writer)
    notes = [each.words() for each in lowest]
    for way, stretch in writer.data["taken_as_unloaded"].items():
        notes.append(
            f"{way} the limb all states that give it have a stretch of {stretch:g}: taken as unloaded there"
        )
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
    data, seen = fit.problem.task.states[k].data, fit.problem.predict(k, fit.found.best)
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
    base = through_depths(model, [float(each) for each in fit.curve.depths], clear=False)
    for k, state in enumerate(fit.site.states):
        fitted = fit.curve.in_state(base, problem.place(k, best), c=problem.c_of_curve(best))
        write_feb(fitted, writer.file(f"feb_{state.name}", f"{state.name}.feb"))
