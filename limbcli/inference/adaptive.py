"""Best fit and profile likelihoods of a costly model, from few simulations.

Everything is searched on surrogates; another simulation is made where they are not sure
enough: at the best fit, at the intervals' ends, and along the profiles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from limbcli.errors import SolveError
from limbcli.inference.levenberg_marquardt import Fit
from limbcli.inference.parameter import FitParameter
from limbcli.inference.profile import Profile, best_of, profile_likelihood
from limbcli.inference.residual import Objective
from limbcli.interval_limits import noise_scale, threshold_95
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

_PRECISE = 0.1  # allowed error of the surrogate, in standard deviations of the data
_NEAR = 0.05  # a point counts as solved within this distance in ln theta
_END_NEAR = 0.3  # an interval's end is trusted within this distance
_SETTLES = 4  # times that weights follow the best fit, at most


class EstimationProblem(Protocol):
    """What is to be estimated, on surrogates.

    parameters : on the log scale, the whole vector theta; `profiled`: indices; `simulated`: of those that a
        simulation is made with
    n_freedom : data minus parameters
    """

    parameters: list[FitParameter]
    profiled: tuple[int, ...]
    simulated: tuple[int, ...]
    n_freedom: int

    def objective(self) -> Objective:
        """Residuals in standard deviations, on the present surrogates."""
        ...

    def settle(self, theta: Array) -> bool:
        """Take the weights of the residuals as they are at this fit; whether that changes them."""
        ...

    def starts(self) -> list[Array]: ...

    def uncertainty(self, theta: Array) -> float:
        """Error of the surrogates there, in standard deviations of the data."""
        ...

    def distance(self, theta: Array) -> float:
        """To the nearest simulated point, in ln of the parameters that need a simulation."""
        ...

    def solve(self, theta: Array) -> None:
        """Simulate there and refresh the surrogates; SolveError where there is no answer."""
        ...

    def within_reach(self, theta: Array) -> Array:
        """The point, drawn in to where a simulation may be expected to converge."""
        ...

    def solved_at(self, theta: Array) -> Array:
        """The parameters that a simulation there is made with."""
        ...


@dataclass(frozen=True, eq=False)
class Intervals:
    """profiles by parameter name; `best`, the most likely theta, with its `fit`.

    scale : chi-square per degree of freedom where above 1 (deviances were divided by it)
    threshold : of the deviance at the ends of the intervals
    n_solves : simulations added; `unsolved`: parameter sets without an answer
    """

    profiles: dict[str, Profile]
    best: Array
    chi_square: float
    n_freedom: int
    scale: float
    threshold: float
    n_solves: int
    fit: Fit
    unsolved: tuple[Array, ...] = ()


def drawn_in(theta: Array, solved: Array, shape: Sequence[FitParameter]) -> Array:
    """theta (c, shape..., ...), its shape at most a step beyond that of the solved points (n, >= n_shape)."""
    near = theta.copy()
    for k, parameter in enumerate(shape):
        low, high = solved[:, k].min(), solved[:, k].max()
        near[1 + k] = np.clip(theta[1 + k], low / parameter.step_factor, high * parameter.step_factor)
    return near


def adaptive_profiles(
    problem: EstimationProblem, *, max_solves: int, estimate: Array | None = None, progress: Progress = SILENT
) -> Intervals:
    """Profiles with as few simulations as the accuracy of the intervals allows.

    Where chi-square exceeds its degrees of freedom the noise is taken to be larger by that
    factor; the surer that is, the more the intervals are those of a noise that is estimated (`threshold_95`).

    estimate : a theta found otherwise (the published fit); where given, no interval leaves it out
    """
    work = _Work(problem, estimate)
    for done in range(max_solves + 1):
        found = work.profiles()
        wanted = work.least_certain(found) if done < max_solves else None
        if wanted is None:
            return replace(found, n_solves=done, unsolved=tuple(work.unsolved))
        progress.event("task", name="simulations for intervals", done=done + 1, total=max_solves)
        work.solve(*wanted)
    raise AssertionError("the loop returns")


class _Work:
    def __init__(self, problem: EstimationProblem, estimate: Array | None):
        self.problem, self.estimate = problem, estimate
        self.unsolved: list[Array] = []
        self.refused: list[Array] = []

    def profiles(self) -> Intervals:
        problem, objective = self.problem, self.problem.objective()
        best = best_of(objective, problem.parameters, problem.starts())
        for _ in range(_SETTLES):
            if not problem.settle(best.theta):
                break
            objective = problem.objective()
            best = best_of(objective, problem.parameters, [best.theta])
        scale = noise_scale(best.cost, problem.n_freedom)
        threshold = threshold_95(best.cost, problem.n_freedom)
        found = {}
        for k in problem.profiled:
            profile = profile_likelihood(
                objective, problem.parameters, best, k, threshold=threshold, scale=scale
            )
            if self.estimate is not None:
                value = float(self.estimate[k])
                profile = replace(profile, low=min(profile.low, value), high=max(profile.high, value))
            found[profile.name] = profile
        return Intervals(found, best.theta, best.cost, problem.n_freedom, scale, threshold, 0, best)

    def least_certain(self, found: Intervals) -> tuple[Array, str, int] | None:
        """Where to simulate next: (theta, parameter whose profile asks, side), or None."""
        near = self.problem.within_reach
        candidates = [(near(found.best), "", 0)]
        for name, profile in found.profiles.items():
            inside = profile.deviance <= found.threshold
            candidates += [(near(theta), name, 0) for theta in profile.thetas[inside]]
            candidates += [(near(end), name, side) for side, end in zip((-1, 1), profile.ends, strict=True)]
        worth = [(self.problem.uncertainty(theta), theta, name, side) for theta, name, side in candidates]
        worth = [each for each in worth if each[0] > _PRECISE and self._is_new(each[1])]
        if worth:
            _, theta, name, side = max(worth, key=lambda each: each[0])
            return theta, name, side
        return self._unproved(candidates)

    def _unproved(self, candidates: Sequence[tuple[Array, str, int]]) -> tuple[Array, str, int] | None:
        for theta, name, side in candidates:
            limit = _NEAR if not name else _END_NEAR if side else np.inf
            if self.problem.distance(theta) > limit and self._is_new(theta):
                return theta, name, side
        return None

    def solve(self, theta: Array, name: str, side: int) -> None:
        try:
            self.problem.solve(theta)
        except SolveError:
            self.unsolved.append(self.problem.solved_at(theta))
            self.refused.append(theta)
            self._draw_in(theta, name, side)

    def _draw_in(self, theta: Array, name: str, side: int) -> None:
        """No answer there: search and profiles stop half-way between it and the starts, in what lies beyond.

        It is the parameter whose profile asked, where that does, else all that a simulation is made with.
        """
        parameters, starts = self.problem.parameters, np.array(self.problem.starts())
        least, most = starts.min(axis=0), starts.max(axis=0)
        beyond = [k for k in self.problem.simulated if not least[k] <= theta[k] <= most[k]]
        if not beyond:
            beyond, least, most = list(self.problem.simulated), starts[0], starts[0]
        own = [k for k in beyond if side != 0 and parameters[k].name == name]
        for k in own or beyond:
            if theta[k] > most[k]:
                high = float(np.sqrt(theta[k] * most[k]))
                parameters[k] = replace(parameters[k], high=min(parameters[k].high, high))
            elif theta[k] < least[k]:
                low = float(np.sqrt(theta[k] * least[k]))
                parameters[k] = replace(parameters[k], low=max(parameters[k].low, low))

    def _is_new(self, theta: Array) -> bool:
        near = [float(np.max(np.abs(np.log(theta / other)))) for other in self.refused]
        return min([*near, self.problem.distance(theta)]) > _NEAR
