"""A fit parameter: name, start value, bounds and normalisation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import FitError
from limbcli.model import Array

F_KAPPA_BOUNDS = (0.01, 1000.0)
M_BOUNDS = (1.0, 100.0)
_ON_BOUND = 1e-3  # relative distance within which a value lies on a bound


@dataclass(frozen=True)
class FitParameter:
    """A positive parameter with start value and bounds.

    The search runs in the normalised coordinate x: theta / start (scale "ratio", the published method) or
    ln(theta / start) (scale "log"). Both make tolerances and steps independent of the parameter's unit. No
    search changes the parameter by more than the factor `step_factor` in one step.

    >>> f_kappa = FitParameter("f_kappa", start=100.0, low=0.01, high=1000.0)
    >>> normalised([f_kappa, f_kappa.in_logs()], np.array([650.0, 100.0])).tolist()
    [6.5, 0.0]
    >>> natural([f_kappa], np.array([6.5])).tolist(), natural([f_kappa.in_logs()], np.array([8.0])).tolist()
    ([650.0], [1000.0])
    """

    name: str
    start: float
    low: float
    high: float
    scale: Literal["ratio", "log"] = "ratio"
    step_factor: float = 10.0

    def __post_init__(self) -> None:
        if not 0.0 < self.low <= self.start <= self.high:
            raise FitError(
                f"the start value {self.start:g} of {self.name} is outside {self.low:g} to {self.high:g}",
                where=f"parameter {self.name}",
                fix="choose a start value between the bounds; bounds must be positive",
                start=self.start, low=self.low, high=self.high,
            )  # fmt: skip

    def at_bound(self, theta: float) -> Literal["low", "high"] | None:
        """The bound that a value lies on (within 0.1 % of it), if any."""
        if theta <= self.low * (1.0 + _ON_BOUND):
            return "low"
        return "high" if theta >= self.high * (1.0 - _ON_BOUND) else None

    def started_at(self, theta: float) -> FitParameter:
        return replace(self, start=min(max(theta, self.low), self.high))

    def within_step(self, theta: float) -> FitParameter:
        """The parameter started at theta, with bounds that one step can reach."""
        low, high = max(self.low, theta / self.step_factor), min(self.high, theta * self.step_factor)
        return replace(self.started_at(theta), low=low, high=high)

    def in_logs(self) -> FitParameter:
        return replace(self, scale="log")


def normalised(parameters: Sequence[FitParameter], theta: Array) -> Array:
    """x (n,) of theta (n,)."""
    in_logs, ratio = _in_logs(parameters), theta / [p.start for p in parameters]
    return np.log(ratio, out=ratio, where=in_logs)


def natural(parameters: Sequence[FitParameter], x: Array) -> Array:
    """theta (n,) of x (n,), within the bounds."""
    factor = np.exp(x, out=np.array(x, dtype=float), where=_in_logs(parameters))
    start, low, high = np.array([(p.start, p.low, p.high) for p in parameters]).T
    return np.clip(start * factor, low, high)


def slopes(parameters: Sequence[FitParameter], theta: Array) -> Array:
    """d theta / d x (n,)."""
    return np.where(_in_logs(parameters), theta, [p.start for p in parameters])


def _in_logs(parameters: Sequence[FitParameter]) -> NDArray[np.bool_]:
    return np.array([p.scale == "log" for p in parameters])
