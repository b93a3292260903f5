"""A fit parameter: name, start value, bounds and normalisation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

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
    >>> f_kappa.normalised(650.0), f_kappa.natural(6.5)
    (6.5, 650.0)
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

    def normalised(self, theta: float) -> float:
        ratio = theta / self.start
        return float(np.log(ratio)) if self.scale == "log" else ratio

    def natural(self, x: float) -> float:
        theta = self.start * (float(np.exp(x)) if self.scale == "log" else x)
        return min(max(theta, self.low), self.high)

    def slope(self, theta: float) -> float:
        """d theta / d x."""
        return theta if self.scale == "log" else self.start

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
    return np.array([p.normalised(float(t)) for p, t in zip(parameters, theta, strict=True)])


def natural(parameters: Sequence[FitParameter], x: Array) -> Array:
    return np.array([p.natural(float(v)) for p, v in zip(parameters, x, strict=True)])


def slopes(parameters: Sequence[FitParameter], theta: Array) -> Array:
    return np.array([p.slope(float(t)) for p, t in zip(parameters, theta, strict=True)])
