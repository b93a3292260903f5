"""95 % intervals by profile likelihood, from few simulations.

The likelihood knows what the paper's objective does not: that depth is the noisy
quantity, and that c, held fixed in the fit, is only known to the precision of the
shear-wave reading. At fixed f_kappa and m every stress, hence every force, is
proportional to c, so c costs no simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.errors import SolveError
from limbcli.inference.identify import ForceDepth, search_parameters
from limbcli.inference.parameter import Parameter
from limbcli.inference.prediction import Memory, Prediction, Predictor, sampled, slopes_at
from limbcli.inference.profile import THRESHOLD_95, Profile, best_of, profile_likelihood
from limbcli.inference.residual import Objective, force_residual, with_prior
from limbcli.inference.surrogate import Node, Surrogate
from limbcli.inference.uncertainty import force_variance
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

_PRECISE = 0.1  # allowed error of the stand-in, in standard deviations of the data
_NEAR = 0.05  # an interval's end counts as solved within this distance in ln theta
_NARROW = 1e-4


@dataclass(frozen=True, eq=False)
class Intervals:
    """profiles by parameter name; `best` (c, f_kappa, m) of greatest likelihood.

    scale : chi-square per degree of freedom where above 1 (deviances were divided by it)
    n_solves : simulations added; `unsolved`: parameter sets without an answer
    """

    profiles: dict[str, Profile]
    best: Array
    chi_square: float
    n_freedom: int
    scale: float
    n_solves: int
    unsolved: tuple[Array, ...] = ()


@dataclass(frozen=True, eq=False)
class Stiffness:
    """c (MPa) and the standard deviation of its logarithm."""

    c: float
    log_deviation: float


def force_intervals(
    curve: Memory,
    knots: Array,
    data: ForceDepth,
    stiffness: Stiffness,
    theta: Array,
    *,
    free: Sequence[int] = (0, 1),
    max_solves: int = 12,
    progress: Progress = SILENT,
) -> Intervals:
    """Profiles of f_kappa and m (those in `free`), with c moving within its own uncertainty.

    Chi-square = sum (F_exp - F_sim)^2 / (sigma_F^2 + (dF/dd sigma_d)^2) + (ln c/c0)^2 / sigma^2,
    slopes dF/dd those of the fit. Where it exceeds its degrees of freedom the noise is taken
    to be larger by that factor. Simulations are replaced by a stand-in built from those
    already made; more are added (at most `max_solves`) at the interval's ends and wherever
    along the profiles the stand-in is not sure to a tenth of a standard deviation.

    theta : (f_kappa, m) of the fit
    """
    task = _Task(curve, knots, data, stiffness, theta, tuple(free))
    before, calls = curve.n_solves, curve.n_calls
    while True:
        found = task.profiles()
        wanted = task.doubtful(found) if curve.n_calls - calls < max_solves else None
        if wanted is None:
            return replace(found, n_solves=curve.n_solves - before, unsolved=tuple(task.unsolved))
        done = curve.n_calls - calls
        progress.event("task", name="intervals: simulations", done=done, total=max_solves)
        task.solve(*wanted)


class _Task:
    def __init__(
        self, curve: Memory, knots: Array, data: ForceDepth, stiffness: Stiffness, theta: Array,
        free: tuple[int, ...],
    ):  # fmt: skip
        self.curve, self.knots, self.stiffness, self.theta, self.free = curve, knots, stiffness, theta, free
        self.depth, self.force = data.depth[data.loaded], data.force[data.loaded]
        slope = slopes_at(curve, knots, self.depth, theta)
        self.deviation = np.sqrt(
            force_variance(slope, force_deviation=data.force_deviation, depth_deviation=data.depth_deviation)
        )
        spread = float(np.exp(6 * max(stiffness.log_deviation, _NARROW)))
        shape = [p.started_at(float(t)).in_logs() for p, t in zip(search_parameters(), theta, strict=True)]
        c = Parameter("c", stiffness.c, stiffness.c / spread, stiffness.c * spread, "log")
        self.parameters = [c, *(shape[k] for k in free)]
        self.unsolved: list[Array] = []

    # ------------------------------------------------------------ profiles on the stand-in

    def profiles(self) -> Intervals:
        self.surrogate = Surrogate(self.nodes())
        objective = self.objective()
        best = best_of(objective, self.parameters, self.starts())
        n_freedom = max(len(self.force) - len(self.free), 1)
        scale = max(1.0, best.cost / n_freedom)
        found = {
            self.parameters[k].name: self._including_estimate(
                profile_likelihood(objective, self.parameters, best, k, scale=scale), k
            )
            for k in range(1, len(self.parameters))
        }
        return Intervals(found, best.theta, best.cost, n_freedom, scale, 0)

    def nodes(self) -> list[Node]:
        nodes = []
        for theta, answer in self.curve.solved:
            graded = answer.has((0, 1)) and answer.jacobian is not None
            slope = answer.jacobian * theta / answer.values[:, None] if graded else None  # type: ignore[operator]
            nodes.append(Node(np.log(theta), np.log(np.maximum(answer.values, 1e-12)), slope))
        return nodes

    def objective(self) -> Objective:
        predict = sampled(self.stand_in, self.knots, self.depth, free=(0, 1), fixed=self.theta)
        force = force_residual(_times_c(predict, self.stiffness.c, self.theta, self.free),
                               self.force, deviation=self.deviation)  # fmt: skip
        return with_prior(
            force, 0, mean=self.stiffness.c, log_deviation=max(self.stiffness.log_deviation, _NARROW)
        )

    def stand_in(self, theta: Array, wrt: Sequence[int] = ()) -> Prediction:
        y, slope = self.surrogate(np.log(theta))
        values = np.exp(np.minimum(y, 50.0))
        return Prediction(values, values[:, None] * slope / theta)

    def starts(self) -> list[Array]:
        c = self.stiffness.c
        starts = [np.r_[c, self.theta[list(self.free)]]]
        target = self.curve(self.theta).values
        visited = sorted(self.curve.solved, key=lambda each: float(np.sum((each[1].values - target) ** 2)))
        starts += [np.r_[c, theta[list(self.free)]] for theta, _ in visited[1:4]]
        return starts

    def _including_estimate(self, profile: Profile, k: int) -> Profile:
        """The published estimate weighs residuals otherwise; the interval never leaves it out."""
        value = float(self.theta[self.free[k - 1]])
        return replace(profile, low=min(profile.low, value), high=max(profile.high, value))

    # ------------------------------------------------------------ where another solve is due

    def doubtful(self, found: Intervals) -> tuple[Array, str, int] | None:
        """The parameter set to solve next: (theta, parameter, side), or None."""
        asked: list[tuple[float, Array, str, int]] = []
        for name, profile in found.profiles.items():
            for side, end in zip((-1, 1), profile.ends, strict=True):
                asked.append((self._doubt(end) + 1e-6, self.shape(end), name, side))
            inside = profile.deviance <= THRESHOLD_95
            for theta in profile.thetas[inside]:
                asked.append((self._doubt(theta), self.shape(theta), name, 0))
        asked = [each for each in asked if each[0] > _PRECISE and self._is_new(each[1])]
        if not asked:
            return self._unproved_end(found)
        _, theta, name, side = max(asked, key=lambda each: each[0])
        return theta, name, side

    def _unproved_end(self, found: Intervals) -> tuple[Array, str, int] | None:
        for name, profile in found.profiles.items():
            for side, end in zip((-1, 1), profile.ends, strict=True):
                theta = self.shape(end)
                if self._distance(theta) > 6 * _NEAR and self._is_new(theta):
                    return theta, name, side
        return None

    def solve(self, theta: Array, name: str, side: int) -> None:
        try:
            self.curve(theta, (0, 1))
        except SolveError:
            self.unsolved.append(theta)
            self._draw_in(theta, name, side)

    def _draw_in(self, theta: Array, name: str, side: int) -> None:
        """No answer there: the profiles stop half-way."""
        for k, parameter in enumerate(self.parameters):
            if k == 0 or (side != 0 and parameter.name != name):
                continue
            index = self.free[k - 1]
            middle = float(np.sqrt(theta[index] * self.theta[index]))
            if theta[index] > self.theta[index]:
                self.parameters[k] = replace(parameter, high=min(parameter.high, middle))
            elif theta[index] < self.theta[index]:
                self.parameters[k] = replace(parameter, low=max(parameter.low, middle))

    def shape(self, theta: Array) -> Array:
        """(f_kappa, m) of a point (c, free parameters)."""
        full = self.theta.copy()
        full[list(self.free)] = theta[1:]
        return full

    def _doubt(self, theta: Array) -> float:
        """Error of the stand-in's forces, in standard deviations of the data."""
        shape = self.shape(theta)
        error = self.surrogate.deviation(np.log(shape)) * self.stand_in(shape).values
        at_depths = np.interp(self.depth, self.knots, error)
        return float(np.linalg.norm(at_depths / self.deviation)) * theta[0] / self.stiffness.c

    def _distance(self, theta: Array) -> float:
        return min(float(np.max(np.abs(np.log(theta / other)))) for other, _ in self.curve.solved)

    def _is_new(self, theta: Array) -> bool:
        known = [other for other, _ in self.curve.solved] + self.unsolved
        return min(float(np.max(np.abs(np.log(theta / other)))) for other in known) > _NEAR


def _times_c(predict: Predictor, c0: float, fixed: Array, free: tuple[int, ...]) -> Predictor:
    """Force as a function of (c, free shape parameters): proportional to c."""

    def scaled(theta: Array, *, derivative: bool = True) -> Prediction:
        shape = fixed.copy()
        shape[list(free)] = theta[1:]
        base = predict(shape, derivative=derivative)
        factor = theta[0] / c0
        if base.jacobian is None:
            return Prediction(factor * base.values)
        columns = [base.values / c0, *(factor * base.jacobian[:, k] for k in free)]
        return Prediction(factor * base.values, np.column_stack(columns))

    return scaled
