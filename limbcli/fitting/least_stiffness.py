"""The stretch at which the speed at rest is lowest, by the fitted law and by the measured states alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from limbcli.case import Site
from limbcli.fitting.laws import FitLaw
from limbcli.fitting.state_curve import StateCurve
from limbcli.fitting.state_plan import StretchPlan
from limbcli.inference.adaptive import Intervals
from limbcli.inference.derived import (
    DerivedInterval,
    LowestPoint,
    derived_interval,
    lowest_of_points,
    lowest_on_grid,
)
from limbcli.inference.joint_fit import JointProblem
from limbcli.model import Array


@dataclass(frozen=True, eq=False, kw_only=True)
class FittedStates:
    """A site's states: what they were fitted with, and what was found."""

    site: Site
    law: FitLaw
    plan: StretchPlan
    curve: StateCurve
    problem: JointProblem
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


# The minimum of the law's curve may lie outside the range of the states.
_GRID = np.linspace(np.log(0.35), np.log(1.8), 241)
_PACE = 0.04  # step in ln stretch of the search for the ends of an interval
_AT_END = 0.01


@dataclass(frozen=True, eq=False)
class LeastStiffness:
    """The minimum of the speed at rest in one direction (`way`), counted on the scale of the "case" or from
    "unloaded".

    by_law : ln stretch at the minimum of the law's curve, with its interval; of_states : the same by a
        parabola through the states that give stretches; measured : ln of the least and greatest of the
        states' stretches
    """

    way: str
    counted: str
    by_law: DerivedInterval
    of_states: LowestPoint
    measured: tuple[float, float]

    @property
    def is_beyond(self) -> bool:
        """Whether the minimum lies outside the measured states, and so is extrapolated by the law."""
        return not self.measured[0] <= self.by_law.value <= self.measured[1]

    @property
    def is_determined(self) -> bool:
        return not (self.by_law.open_low or self.by_law.open_high)

    def words(self) -> str:
        """The result in one sentence, including whether the data determine it."""
        in_case = self.counted == "case"
        frame = "on the stretch scale of the case" if in_case else "of the unloaded tissue's length"
        if not self.is_determined:
            return (
                f"{self.way} the limb, these data do not determine the state of least stiffness: "
                f"{self._excluded()}. The speeds at rest do not curve enough over the "
                "stretches measured; measure states "
                "further apart, especially shorter ones"
            )
        at, low, high = np.exp([self.by_law.value, self.by_law.low, self.by_law.high])
        return (
            f"{self.way} the limb, the speed at rest is lowest at a stretch of {at:.2f} (95 %: {low:.2f} to "
            f"{high:.2f}), {frame}"
            + ("; no state was measured beyond it, so it rests on the law's curve" if self.is_beyond else "")
        )

    def _excluded(self) -> str:
        low, high = np.exp([self.by_law.low, self.by_law.high])
        if self.by_law.open_low and self.by_law.open_high:
            return "no searched stretch is excluded"
        if self.by_law.open_low:
            return f"only stretches above {high:.2f} are excluded (95 %)"
        return f"only stretches below {low:.2f} are excluded (95 %)"

    def to_json(self) -> dict[str, Any]:
        """stretch, low, high (dimensionless); an open end of the interval is null."""
        law, states = self.by_law, self.of_states
        ends = {"stretch": states.at, "low": states.low, "high": states.high}
        of_states = {name: None if each is None else float(np.exp(each)) for name, each in ends.items()}
        return {
            "stretch": float(np.exp(law.value)),
            "low": None if law.open_low else float(np.exp(law.low)),
            "high": None if law.open_high else float(np.exp(law.high)),
            "told": self.is_determined, "beyond_measured_states": self.is_beyond,
            "counted_from": self.counted, "words": self.words(),
            "by_parabola_through_states": {**of_states, "told": states.has_curvature},
        }  # fmt: skip


def least_stiffness(fit: FittedStates) -> list[LeastStiffness]:
    """One result for every direction (way) in which states are stretched."""
    return [_of_way(fit, way, fit.given(way)) for way in fit.plan.ways]


def _of_way(fit: FittedStates, way: str, given: Sequence[float | None]) -> LeastStiffness:
    plan, problem, found = fit.plan, fit.problem, fit.found
    column, names = plan.ways.index(way), [each.name for each in problem.parameters]
    searched = f"unloaded_stretch_{way}"
    place = names.index(searched) if searched in names else None
    zero = plan.unloaded.get(way, 1.0)
    in_case = any(each is not None for each in given)
    grid = np.ones((len(_GRID), len(plan.ways)))
    grid[:, column] = np.exp(_GRID)

    def counted(theta: Array) -> float:
        """ln of the stretch, on the case's scale, at which the tissue is unloaded."""
        return float(np.log(theta[place] if place is not None else zero)) if in_case else 0.0

    def quantity(theta: Array) -> float:
        return counted(theta) + lowest_on_grid(_GRID, fit.curve.even_speeds(problem.curve_shape(theta), grid))

    low, high = _GRID[0] + _AT_END, _GRID[-1] - _AT_END
    if place is not None:
        parameter = problem.parameters[place]
        low, high = low + np.log(parameter.low), high + np.log(parameter.high)
    elif in_case:
        low, high = low + np.log(zero), high + np.log(zero)
    by_law = derived_interval(
        problem.objective(), problem.parameters, found.fit, quantity, low, high, _PACE,
        scale=found.scale, threshold=found.threshold,
    )  # fmt: skip
    logs = [counted(found.best) + np.log(fit.elastic(k, way)) for k in range(len(given))]
    measured = (float(min(logs)), float(max(logs)))
    return LeastStiffness(
        way, "case" if in_case else "unloaded", by_law, _of_states(problem, given), measured
    )


def _of_states(problem: JointProblem, given: Sequence[float | None]) -> LowestPoint:
    told = [(each, data) for each, data in zip(given, problem.task.data, strict=True) if each is not None]
    at_rest = [(data, int(np.argmin(data.speed_force))) for _, data in told]
    return lowest_of_points(
        np.log([each for each, _ in told]),
        np.array([data.log_speed[j] for data, j in at_rest]),
        np.array([data.speed_deviation[j] for data, j in at_rest]),
    )
