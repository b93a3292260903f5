"""Sizes of effects as physical quantities: f0_n for a force offset, f_c_hz for a guided wave, ...

Converts intervals of the fitted parameters to intervals of the corresponding quantities, with units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from limbcli.diagnosis.forward_model.predictions import Slot
from limbcli.effects import poroelasticity

Interval = tuple[float | None, float | None]
Sizes = dict[str, dict[str, Interval]]
_Turn = Callable[[float, float], float]
_ON_BOUND = 0.01  # distance from a bound, as a fraction of the range, from which an interval is open there
# Fitted parameter: name of the reported quantity, and conversion to it from the value and c in kPa.
_SAME: _Turn = lambda value, c_kpa: value  # noqa: E731
_OF_C: _Turn = lambda value, c_kpa: value * c_kpa  # noqa: E731
_REPORTED: Mapping[str, tuple[str, _Turn]] = {
    "force_zero_n": ("f0_n", _SAME),
    "depth_zero_mm": ("d0_mm", _SAME),
    "preload_n": ("f0_n", _SAME),
    "thickness_change": ("epsilon", _SAME),
    "tilt_about_short_axis_deg": ("about_short_axis_deg", _SAME),
    "tilt_about_long_axis_deg": ("about_long_axis_deg", _SAME),
    "log_inclusion_ratio": ("stiffness_ratio", lambda value, c_kpa: float(np.exp(value))),
    "log_fat_softness": ("stiffness_ratio", lambda value, c_kpa: float(np.exp(-value))),
    "log_skin_ratio": ("c_kpa", lambda value, c_kpa: float(np.exp(value)) * c_kpa),
    "weight_q": ("q", _SAME),
    "fibre_shear_per_c": ("mu_f_kpa", _OF_C),
    "fibre_tension_per_c": ("ksi_kpa", _OF_C),
    "active_stress_per_c": ("t0_kpa", _OF_C),
    "relaxing_share": ("g1", _SAME),
    "second_relaxing_share": ("g2", _SAME),
    "friction_coefficient": ("coefficient", _SAME),
    "support_compliance_mm_per_n": ("k_n_per_mm", lambda value, c_kpa: _over(1.0, value)),
    "swe_modulus_scale": ("s_t", _SAME),
    "swe_loss_per_mm": ("beta_per_mm", _SAME),
    "log_permeability_ratio": (
        "permeability_mm4_per_n_s",
        lambda value, c_kpa: poroelasticity.permeability({poroelasticity.PERMEABILITY.name: value}),
    ),
    "guided_1e4_per_hz2": ("f_c_hz", lambda value, c_kpa: _over(100.0, np.sqrt(max(value, 0.0)))),
}


def _over(one: float, value: float) -> float:
    return one / float(value) if value > 0 else float("inf")


def reported_sizes(
    slots: Mapping[str, Sequence[Slot]], found: Mapping[str, Mapping[str, tuple[float, float]]], c_kpa: float
) -> Sizes:
    """Intervals with the names and units in which they are reported; None: open on that side.

    slots : for every effect, its size parameters; found : by effect and parameter, the interval of its value;
        missing effects are open
    c_kpa : of the tissue, for sizes relative to it
    """
    sizes: Sizes = {}
    for name, mine in slots.items():
        row: dict[str, Interval] = {}
        for slot in mine:
            p = slot.parameter
            ends = found.get(name, {}).get(slot.name, (p.low, p.high))
            near = _ON_BOUND * (p.high - p.low)
            open_ends = (
                ends[0] <= p.low + near and p.null > p.low,
                ends[1] >= p.high - near and p.null < p.high,
            )
            label, turn = _REPORTED.get(p.name, (p.name, _SAME))
            values: list[float | None] = [
                None if is_open or not np.isfinite(turned := turn(each, c_kpa)) else turned
                for each, is_open in zip(ends, open_ends, strict=True)
            ]
            if turn(1.0, c_kpa) > turn(2.0, c_kpa):
                values.reverse()
            row[label] = (values[0], values[1])
        sizes[name] = row
    return sizes
