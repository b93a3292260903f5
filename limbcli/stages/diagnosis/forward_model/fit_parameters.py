"""The parameters of an explanation as a fit has them, and what of them ended on a bound."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limbcli.diagnostics import thresholds
from limbcli.effects.base import Effect, Parameter
from limbcli.model import Array


@dataclass(frozen=True)
class Slot:
    """A parameter of an explanation: its name in the fit, and the site it is for (None: all)."""

    name: str
    parameter: Parameter
    site: int | None = None


def stuck(x: Array, slots: Sequence[Slot]) -> NDArray[np.bool_]:
    """Effect parameters (n,) that a bound holds: they are not free to move with the data."""
    low, high = (np.array([getattr(slot.parameter, side) for slot in slots]) for side in ("low", "high"))
    near = thresholds.ON_BOUND * (high - low)
    return np.asarray((x[2:] - low < near) | (high - x[2:] < near), dtype=bool)


def on_bounds(x: Array, slots: Sequence[Slot], effects: Collection[Effect]) -> list[str]:
    """What ended on a bound. Null is fair for some of an effect's parameters, but not for all; any place is.

    An extent as large as can be makes another effect of it: such a ball is no spot, but a
    slope or what else the model lacks, of which it fits much with all its parameters.
    """
    found = []
    fixed = stuck(x, slots)
    for k, (value, slot) in enumerate(zip(x[2:], slots, strict=True)):
        p = slot.parameter
        if not fixed[k]:
            continue
        if p.shape:
            if p.extent and p.high - value < value - p.low:
                found.append(f"{slot.name} ended on its higher bound {p.high:g}")
            continue
        if any(
            not fixed[n] and not other.parameter.shape and _same_effect(slot, other, effects)
            for n, other in enumerate(slots)
        ):
            continue  # another size of the effect is free, and says that it is there
        if abs(value - p.null) > thresholds.ON_BOUND * (p.high - p.low):
            if p.natural_bounds:
                continue
            side = "higher" if value > p.null else "lower"
            found.append(f"{slot.name} ended on its {side} bound {p.high if value > p.null else p.low:g}")
        elif all(
            abs(x[2 + n] - other.parameter.null)
            <= thresholds.ON_BOUND * (other.parameter.high - other.parameter.low)
            for n, other in enumerate(slots)
            if not other.parameter.shape and _same_effect(slot, other, effects)
        ):
            found.append(f"{slot.name} ended at {p.null:g}, where the effect is absent")
    return found


def _same_effect(one: Slot, other: Slot, effects: Collection[Effect]) -> bool:
    return any(one.parameter in each.parameters and other.parameter in each.parameters for each in effects)
