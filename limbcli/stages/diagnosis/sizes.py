"""Sizes of effects as physical quantities: f0_n for a force offset, f_c_hz for a guided wave, ...

Converts intervals of the fitted parameters to intervals of the corresponding quantities, with units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from limbcli.diagnostics.conclusions.effect_sizes import RefittedSizes
from limbcli.effects import poroelasticity
from limbcli.stages.diagnosis.forward_model.fit_parameters import Slot

Interval = tuple[float | None, float | None]
Sizes = dict[str, dict[str, Interval]]
_Turn = Callable[[float, float], float]
_NONE: Mapping[str, RefittedSizes] = {}


def _same(value: float, c_kpa: float) -> float:
    return value


def _ratio(value: float, c_kpa: float) -> float:
    return float(np.exp(value))


def _permeability(value: float, c_kpa: float) -> float:
    return poroelasticity.permeability({poroelasticity.PERMEABILITY.name: value})


def _softer(value: float, c_kpa: float) -> float:
    return float(np.exp(-value))


def _of_c(value: float, c_kpa: float) -> float:
    return value * c_kpa


def _skin(value: float, c_kpa: float) -> float:
    return float(np.exp(value)) * c_kpa


def _inverse(value: float, c_kpa: float) -> float:
    return float("inf") if value <= 0 else 1.0 / value


def _cut_off(value: float, c_kpa: float) -> float:
    return float("inf") if value <= 0 else 100.0 / float(np.sqrt(value))


# Fitted parameter: name of the reported quantity, and conversion to it.
_REPORTED: Mapping[str, tuple[str, _Turn]] = {
    "force_zero_n": ("f0_n", _same),
    "depth_zero_mm": ("d0_mm", _same),
    "preload_n": ("f0_n", _same),
    "thickness_change": ("epsilon", _same),
    "tilt_about_short_axis_deg": ("about_short_axis_deg", _same),
    "tilt_about_long_axis_deg": ("about_long_axis_deg", _same),
    "log_inclusion_ratio": ("stiffness_ratio", _ratio),
    "log_fat_softness": ("stiffness_ratio", _softer),
    "log_skin_ratio": ("c_kpa", _skin),
    "weight_q": ("q", _same),
    "fibre_shear_per_c": ("mu_f_kpa", _of_c),
    "fibre_tension_per_c": ("ksi_kpa", _of_c),
    "active_stress_per_c": ("t0_kpa", _of_c),
    "relaxing_share": ("g1", _same),
    "second_relaxing_share": ("g2", _same),
    "friction_coefficient": ("coefficient", _same),
    "support_compliance_mm_per_n": ("k_n_per_mm", _inverse),
    "swe_modulus_scale": ("s_t", _same),
    "swe_loss_per_mm": ("beta_per_mm", _same),
    "log_permeability_ratio": ("permeability_mm4_per_n_s", _permeability),
    "guided_1e4_per_hz2": ("f_c_hz", _cut_off),
}


def value_ends(
    slot: Slot, found: Mapping[str, tuple[float, float]], refitted: RefittedSizes | None
) -> tuple[float, float]:
    """The interval of a parameter's value: the union of the first-order one and that of its effect's refit.

    The first-order interval reaches further from null if the effect saturates (`Parameter.saturates`); it is
    infinite where the parameter is not in `found`. An infinite end is replaced by that of the refit, if any.
    """
    low, high = found.get(slot.name, (-np.inf, np.inf))
    ends = slot.parameter.from_proportional(low), slot.parameter.from_proportional(high)
    if refitted is None or slot.name not in refitted.intervals:
        return ends
    low, high = refitted.intervals[slot.name]
    return (
        min(low, ends[0]) if np.isfinite(ends[0]) else low,
        max(high, ends[1]) if np.isfinite(ends[1]) else high,
    )


def reported_sizes(
    slots: Mapping[str, Sequence[Slot]], found: Mapping[str, Mapping[str, tuple[float, float]]], c_kpa: float,
    refitted: Mapping[str, RefittedSizes] = _NONE,
) -> Sizes:  # fmt: skip
    """Intervals with the names and units in which they are reported; None: open on that side.

    slots : for every effect, its size parameters
    found : by effect and parameter, the first-order interval of the distance from the null value; missing
        effects are open
    refitted : by effect, its refit with values and intervals; c_kpa : used for effects that were not refitted
    """
    sizes: Sizes = {}
    for name, mine in slots.items():
        row: dict[str, Interval] = {}
        again = refitted.get(name)
        c = c_kpa if again is None else again.values["c_kpa"]
        for slot in mine:
            p = slot.parameter
            ends = value_ends(slot, found.get(name, {}), again)
            open_ends = ends[0] <= p.low and p.null > p.low, ends[1] >= p.high and p.null < p.high
            inside = [float(np.clip(each, p.low, p.high)) for each in ends]
            label, turn = _REPORTED.get(p.name, (p.name, _same))
            values: list[float | None] = [
                None if is_open or not np.isfinite(turned := turn(each, c)) else turned
                for each, is_open in zip(inside, open_ends, strict=True)
            ]
            if turn(1.0, c) > turn(2.0, c):
                values.reverse()
            row[label] = (values[0], values[1])
        sizes[name] = row
    return sizes
