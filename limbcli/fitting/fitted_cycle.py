"""The loading cycle that is fitted: the model driven through its depths, and comparison with other cycles."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from limbcli.case import Site
from limbcli.feb.settings import schedule
from limbcli.measurement.cycle_changes import change_text
from limbcli.measurement.indentation import Levels
from limbcli.measurement.repeated_loading import Difference
from limbcli.model import LimbModel
from limbcli.results import StageWriter
from limbcli.site_model.indentation_model import PROBE, start_at, starting_depth
from limbcli.site_model.site_levels import all_levels_of, cycles_of, simulated_depths

_SAME_TOUCH = 0.02  # mm, shift of first touch against cycle 1 below which it is not mentioned


def through_cycle(model: LimbModel, levels: Levels, site: Site) -> LimbModel:
    """The model that `build-feb` drives through the last cycle, driven through the depths of these levels."""
    usual = all_levels_of(site)
    if int(levels.cycle[0]) == usual.chosen_cycle():
        return model
    depths = simulated_depths(levels).tolist()
    plan = schedule(depths, start=starting_depth(model, depths[0]))
    drive = next(each for each in model.drives if (each.body, each.dof) == (PROBE, "z"))
    assert drive.curve is not None
    step = replace(model.steps[0], n_steps=plan.n_steps, must_points=plan.times, dt_max_curve=None)
    return replace(
        start_at(model, plan.start), curves={**model.curves, drive.curve: plan.curve()}, steps=(step,)
    )


def write_cycle(levels: Levels, site: Site, writer: StageWriter, *, label: str = "") -> None:
    """Write `cycle` of fit.json if there are several, for each site (`label`) where they are fitted together;
    warn if later cycles contradict the fitted one."""
    every = all_levels_of(site)
    if len(every.cycles) == 1:
        return
    number = int(levels.cycle[0])
    study = cycles_of(site, every)
    against, energy = study.contradicting(number), study.energy.get(number)
    content: dict[str, Any] = {
        "fitted": number,
        "of": len(every.cycles),
        "zero_depth_mm": levels.zero_depth,
        "repeats_from": study.repeats_from,
        "contradicted_by": against[0].later if against else None,
        "energy_lost_n_mm": energy.lost if energy else None,
        "energy_lost_fraction": energy.share if energy else None,
    }
    if label:
        writer.data.setdefault("cycle", {})[label] = content
    else:
        writer.data["cycle"] = content
    before = f"site {label}: " if label else ""
    text = f"{before}fitted: the loading of cycle {number} of {len(every.cycles)}"
    if abs(levels.zero_depth) > _SAME_TOUCH:
        text += (
            f"; its depths count from its own first touch, {levels.zero_depth:.2f} mm below that of cycle 1"
        )
    writer.summary.append(text)
    if against:
        writer.warnings.append(before + contradiction(against[0]))
    elif study.differences and number == study.differences[-1].later and study.repeats_from is None:
        writer.warnings.append(
            f"{before}cycle {number} does not repeat the previous one within noise: the tissue was "
            "still changing when the record ended; apply more loading cycles before measuring"
        )


def contradiction(difference: Difference) -> str:
    """A sentence on how a later loading differs from an earlier one."""
    k = difference.largest
    return (
        f"cycle {difference.later} contradicts the fitted cycle {difference.earlier}: at "
        f"{difference.force[k]:.3g} N its depth is {difference.depth[k]:+.2f} mm off (probability "
        f"under noise {difference.p_value:.1g}); {change_text(difference)}. The fit is of tissue that was "
        "not yet preconditioned: --cycle last"
    )
