"""Best fit and profile likelihoods of an expensive model from few simulations.

All searches run on surrogates. A simulation is added where the surrogates are not accurate enough: at the
best fit, at the ends of the intervals, and along the profiles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.errors import SolveError
from limbcli.inference.least_squares import Fit
from limbcli.inference.likelihood import Likelihood
from limbcli.inference.profile import Profile, best_of, profile_likelihood
from limbcli.model import Array
from limbcli.numbers.interval_limits import noise_scale, threshold_95
from limbcli.progress import SILENT, Progress

# Largest accepted error of the surrogate, in standard deviations of the data: at the best fit and the ends,
# and along the profiles, on which the intervals do not depend.
_PRECISE, _PRECISE_BETWEEN = 0.1, 0.3
_NEAR = 0.05  # distance in ln theta within which a point counts as solved
# Largest accepted distance in ln theta of an interval's end from a solved point, and as a share of the
# interval: an end that is decades away from the fit is not needed to 30 %.
_END_NEAR, _END_NEAR_SHARE = 0.3, 0.1
_CERTAIN = 0.02  # error of the surrogate, in standard deviations of the data, up to which no point is too far
_SETTLES = 4  # largest number of refits with updated weights


@dataclass(frozen=True, eq=False)
class Intervals:
    """Profile likelihoods by parameter name, and the most likely theta (`best`) with its fit.

    scale : chi-square per degree of freedom where it exceeds 1, else 1; the deviances are divided by it
    threshold : deviance at the ends of the intervals
    n_solves : number of simulations added; unsolved : parameter sets at which the model could not be solved
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


def adaptive_profiles(
    problem: Likelihood, *, max_solves: int, estimate: Array | None = None, progress: Progress = SILENT
) -> Intervals:
    """Profile likelihoods from as few simulations as the accuracy of the intervals allows.

    Where chi-square exceeds its degrees of freedom, the noise is taken as larger by that factor; the stronger
    the evidence for this, the closer the intervals are to those of a noise estimated from the data
    (`threshold_95`).

    estimate : a theta found by another method (the published fit), which every interval is widened to include
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


def _accepted(name: str, side: int) -> float:
    """Largest accepted error of the surrogate at a candidate; one along a profile has a name and no side."""
    return _PRECISE_BETWEEN if name and not side else _PRECISE


class _Work:
    def __init__(self, problem: Likelihood, estimate: Array | None):
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
        """Where to simulate next: (theta, parameter whose profile needs it, side), or None."""
        near = self.problem.within_reach
        candidates = [(near(found.best), "", 0)]
        widths = {}
        for name, profile in found.profiles.items():
            inside = profile.deviance <= found.threshold
            candidates += [(near(theta), name, 0) for theta in profile.thetas[inside]]
            candidates += [(near(end), name, side) for side, end in zip((-1, 1), profile.ends, strict=True)]
            widths[name] = float(np.log(profile.high / profile.low))
        worth = [(self.problem.uncertainty(theta), theta, name, side) for theta, name, side in candidates]
        worth = [each for each in worth if each[0] > _accepted(each[2], each[3]) and self._is_new(each[1])]
        if worth:
            _, theta, name, side = max(worth, key=lambda each: each[0])
            return theta, name, side
        return self._unproved(candidates, widths)

    def _unproved(
        self, candidates: Sequence[tuple[Array, str, int]], widths: Mapping[str, float]
    ) -> tuple[Array, str, int] | None:
        for theta, name, side in candidates:
            end_near = max(_END_NEAR, _END_NEAR_SHARE * widths.get(name, 0.0))
            limit = _NEAR if not name else end_near if side else np.inf
            far = self.problem.distance(theta) > limit and self.problem.uncertainty(theta) > _CERTAIN
            if far and self._is_new(theta):
                return theta, name, side
        return None

    def solve(self, theta: Array, name: str, side: int) -> None:
        try:
            self.problem.solve(theta)
        except SolveError:
            self.unsolved.append(self.problem.solved_at(theta))
            self.refused.append(theta)
            # The bounds are narrowed half-way (in ln) between theta and the starts, of parameters beyond the
            # starts only: the one whose profile requested the point if it is among them, else all that are
            # inputs of the simulation.
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
