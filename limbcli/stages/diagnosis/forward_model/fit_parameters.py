"""Parameters of an explanation in a fit: names, priors, bounds."""

from __future__ import annotations

from dataclasses import dataclass

from limbcli.diagnostics.model.priors import Prior
from limbcli.effects.base import Parameter

_ON_BOUND = 1e-3  # distance from a bound, as a fraction of the range, within which a parameter is on it
_ROOMY = 1.5  # standard deviation of the prior of a size, in plausible sizes


@dataclass(frozen=True)
class Slot:
    """A parameter of an explanation: its name in the fit, and the site it applies to (None: all).

    each_time : its size differs between measurements
    """

    name: str
    parameter: Parameter
    site: int | None = None
    each_time: bool = False

    @property
    def prior(self) -> Prior:
        """Normal about null, as wide as `_ROOMY` plausible sizes; uniform for a shape."""
        p = self.parameter
        if p.shape:
            return Prior.uniform(p.low, p.high)
        return Prior(p.null, _ROOMY * max(abs(p.typical - p.null), 1e-9), p.low, p.high)

    def on_bound(self, value: float) -> str:
        """Message where the value ended on a bound; empty elsewhere, and where it is null or a natural
        bound."""
        p = self.parameter
        near = _ON_BOUND * (p.high - p.low)
        if p.natural_bounds or (not p.shape and abs(value - p.null) <= near):
            return ""
        side = "lower" if value - p.low < near else "higher" if p.high - value < near else ""
        bound = p.low if side == "lower" else p.high
        return f"{self.name} ended on its {side} bound {bound:g}" if side else ""
