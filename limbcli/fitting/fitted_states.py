"""The fit of a site's states, as its outputs need it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.case import Site
from limbcli.fitting.laws import FitLaw
from limbcli.fitting.state_curve import StateCurve
from limbcli.fitting.state_plan import StretchPlan
from limbcli.inference.adaptive import Intervals
from limbcli.inference.states_fit import StatesProblem
from limbcli.model import Array


@dataclass(frozen=True, eq=False, kw_only=True)
class FittedStates:
    """A site's states: what they were fitted with, and what was found."""

    site: Site
    law: FitLaw
    plan: StretchPlan
    curve: StateCurve
    problem: StatesProblem
    found: Intervals

    @property
    def stretch_values(self) -> Array:
        """The plan's parameters (n,) at the best fit."""
        return self.found.best[1 + self.problem.n_shape : len(self.found.profiles)]

    def given(self, way: str) -> list[float | None]:
        """The stretches that the case gives for the states."""
        return [getattr(each.stretch, way) for each in self.site.states]

    def elastic(self, k: int, way: str) -> float:
        """Elastic stretch of a state at the best fit."""
        return self.plan.elastic(k, way, self.stretch_values)

    def stretch_ends(self, k: int, way: str) -> tuple[float | None, float | None]:
        """95 % interval of a state's elastic stretch, of at most one parameter; None where it is open."""
        plan = self.plan
        if way not in plan.ways:
            return 1.0, 1.0
        w = plan.ways.index(way)
        base, places = float(np.exp(plan.offsets[k, w])), np.flatnonzero(plan.factors[k, w])
        if not len(places):
            return base, base
        low, high = self.found.profiles[plan.parameters[int(places[0])].name].limits
        if plan.factors[k, w, int(places[0])] > 0:
            return low, high
        return None if high is None else base / high, None if low is None else base / low
