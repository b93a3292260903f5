"""Parameters of an explanation in a fit, and which of them ended on a bound."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limbcli.diagnostics.model.priors import Prior
from limbcli.effects.base import Effect, Parameter
from limbcli.model import Array

_ON_BOUND = 1e-3  # distance from a bound, as a fraction of the range, within which a parameter is on it
ROOMY = 1.5  # standard deviation of the prior of a size, in plausible sizes


@dataclass(frozen=True)
class Slot:
    """A parameter of an explanation: its name in the fit, and the site it applies to (None: all)."""

    name: str
    parameter: Parameter
    site: int | None = None

    @property
    def prior(self) -> Prior:
        """Normal about null, as wide as `ROOMY` plausible sizes; uniform for a shape."""
        p = self.parameter
        if p.shape:
            return Prior.uniform(p.low, p.high)
        return Prior(p.null, ROOMY * max(abs(p.typical - p.null), 1e-9), p.low, p.high)


def stuck(x: Array, slots: Sequence[Slot]) -> NDArray[np.bool_]:
    """Mask (n,) of effect parameters on a bound, which cannot follow the data."""
    low, high = (np.array([getattr(slot.parameter, side) for slot in slots]) for side in ("low", "high"))
    near = _ON_BOUND * (high - low)
    return np.asarray((x[2:] - low < near) | (high - x[2:] < near), dtype=bool)


@dataclass(frozen=True)
class BoundHit:
    """A parameter, by its name in the fit, that ended on a bound; is_absent : where its effect is absent."""

    name: str
    message: str
    is_absent: bool = False


def bound_hits(x: Array, slots: Sequence[Slot], effects: Collection[Effect]) -> list[BoundHit]:
    """Parameters that ended on a bound, as far as this is an objection to the fit.

    Some of an effect's parameters may be at their null value, but not all of them; positions may be anywhere.
    The largest extent is an objection, because it turns the effect into a different one: so large a ball is
    no longer local, and with all its parameters it fits a gradient or any other deficiency of the model.
    """
    found = []
    fixed = stuck(x, slots)
    for k, (value, slot) in enumerate(zip(x[2:], slots, strict=True)):
        p = slot.parameter
        if not fixed[k]:
            continue
        if p.shape:
            if p.extent and p.high - value < value - p.low:
                found.append(_beyond(slot, "higher", p.high))
            continue
        if any(
            not fixed[n] and not other.parameter.shape and _same_effect(slot, other, effects)
            for n, other in enumerate(slots)
        ):
            continue  # another size of the effect is off its bounds, so the effect is present
        if abs(value - p.null) > _ON_BOUND * (p.high - p.low):
            if p.natural_bounds:
                continue
            found.append(_beyond(slot, "higher", p.high) if value > p.null else _beyond(slot, "lower", p.low))
        elif all(
            abs(x[2 + n] - other.parameter.null) <= _ON_BOUND * (other.parameter.high - other.parameter.low)
            for n, other in enumerate(slots)
            if not other.parameter.shape and _same_effect(slot, other, effects)
        ):
            message = f"{slot.name} ended at {p.null:g}, where the effect is absent"
            found.append(BoundHit(slot.name, message, is_absent=True))
    return found


def _beyond(slot: Slot, side: str, bound: float) -> BoundHit:
    return BoundHit(slot.name, f"{slot.name} ended on its {side} bound {bound:g}")


def _same_effect(one: Slot, other: Slot, effects: Collection[Effect]) -> bool:
    return any(one.parameter in each.parameters and other.parameter in each.parameters for each in effects)
