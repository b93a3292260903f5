"""Fit of one tissue measured in several states that share a law but differ in their stretch before loading.

The likelihood is that of the joint fit: depth at given force, and the logarithm of each wave speed, at rest
and under load. All states share one simulated curve, which is a function of the law's shape parameters and of
the stretches. A state only selects a point in that parameter space: ln of its stretches is a constant plus a
linear combination of the stretch parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.errors import FitError, SolveError
from limbcli.inference.adaptive import Intervals, adaptive_profiles, drawn_in
from limbcli.inference.emulator import Emulator
from limbcli.inference.joint import C_SPAN, c_drawn_in
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import Prediction, SolvedPoints
from limbcli.inference.profile import best_of
from limbcli.inference.residual import Objective, Residual
from limbcli.inference.site_depth import (
    DepthWeights,
    SiteMeasurement,
    SitePrediction,
    predict_beside_layers,
    predict_site,
)
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

_LEAST = 1e-9  # lower limit of predicted forces (N) and relative speeds, before logarithms are taken
_FOR_THE_BEST = 4  # largest number of rounds of simulations that refine the best fit before the intervals
_NEAR = 0.05  # largest distance from a solved point, in ln of the curve's parameters, of a simulated best fit
_SURE = 0.05  # largest accepted surrogate error in a state, in standard deviations of its data
EvenSpeed = Callable[[Array], tuple[float, Array]]
"""Curve parameters -> ln of the speed in evenly stretched tissue at c0, and its derivatives by their ln."""


@dataclass(frozen=True, eq=False)
class StateMeasurement:
    """Data of one state, and ln of its stretches as an affine function of the stretch parameters.

    ln stretches (n_ways,) = offset (n_ways,) + factors (n_ways, n_stretches) times ln of the stretch
    parameters. `data.knots` are probe depths on the common curve (mm).
    """

    data: SiteMeasurement
    offset: Array
    factors: Array


@dataclass(frozen=True, eq=False)
class StatesTask:
    """Input of the fit of several states.

    curve : (shape, stretches) -> forces and relative speeds at the knots, the relative speed at rest, and exp
        of the rise of the skin (mm), all for c0
    even_speed : the speed in evenly stretched tissue to which those speeds are relative
    shape, stretches : parameters of the law and of the states
    gain_deviation : standard deviation of the numerical error of ln force, common to all states because they
        share one mesh
    beside_layers : the curve is a function of (c / c0, shape, stretches), because layers with a fixed
        stiffness of their own are in the model
    """

    curve: SolvedPoints
    even_speed: EvenSpeed
    states: Sequence[StateMeasurement]
    shape: Sequence[FitParameter]
    stretches: Sequence[FitParameter]
    c0: float
    gain_deviation: float
    beside_layers: bool = False


class StatesProblem:
    """Estimation problem for `adaptive_profiles`; theta = (c, shape..., stretches..., gain if it is
    uncertain)."""

    def __init__(self, task: StatesTask, starts: Sequence[Array]):
        self.task = task
        self.n_shape, self.n_stretches = len(task.shape), len(task.stretches)
        self.gained = task.gain_deviation > 0.0
        self.parameters = [
            FitParameter("c", task.c0, task.c0 / C_SPAN, task.c0 * C_SPAN, "log"),
            *(each.in_logs() for each in (*task.shape, *task.stretches)),
            *([FitParameter("gain", 1.0, 0.2, 5.0, "log")] if self.gained else []),
        ]
        self.profiled = tuple(range(1 + self.n_shape + self.n_stretches))
        self.simulated = self.profiled if task.beside_layers else self.profiled[1:]
        self.emulator = Emulator(task.curve)
        self._starts = list(starts)
        n_data = sum(len(each.data.force) + len(each.data.log_speed) for each in task.states)
        self.n_freedom = max(n_data - len(self.profiled), 1)
        self._weights = DepthWeights([each.data for each in task.states], self.predict, self.starts()[0])

    # ------------------------------------------------------------ parameters of a state

    def place(self, k: int, theta: Array) -> Array:
        """Parameters of the curve in state k: the law's shape, then the stretches of that state."""
        state = self.task.states[k]
        stretches = np.exp(state.offset + state.factors @ np.log(self.stretch_values(theta)))
        return np.r_[self.curve_shape(theta), stretches]

    def curve_shape(self, theta: Array) -> Array:
        """Shape parameters passed to the curve, preceded by c / c0 where layers have a fixed stiffness."""
        shape = np.asarray(theta[1 : 1 + self.n_shape])
        return np.r_[theta[0] / self.task.c0, shape] if self.task.beside_layers else shape

    def c_of_curve(self, theta: Array) -> float:
        """The c (MPa) that, together with the curve's parameters, describes the tissue of theta."""
        return self.task.c0 if self.task.beside_layers else float(theta[0])

    def stretch_values(self, theta: Array) -> Array:
        """Stretch parameters of theta."""
        first = 1 + self.n_shape
        return np.asarray(theta[first : first + self.n_stretches])

    # ------------------------------------------------------------ residuals

    def predict(self, k: int, theta: Array) -> SitePrediction:
        """Prediction of state k at theta by the surrogate, with derivatives by ln c, ln gain and ln of the
        curve's parameters."""
        x, data = self.place(k, theta), self.task.states[k].data
        n, answer = len(data.knots), self.emulator(x)
        assert answer.jacobian is not None
        known = np.maximum(answer.values, _LEAST)  # far from solved points it may be anything
        by_log = answer.jacobian * x / known[:, None]
        even, even_by = self.task.even_speed(x)
        relative = slice(n, 2 * n)
        speeds = known[relative] * np.exp(even)
        values = np.r_[known[:n], speeds]
        jacobian = np.vstack([answer.jacobian[:n], (by_log[relative] + even_by) * speeds[:, None] / x])

        def known_curve(theta: Array, wrt: Sequence[int] = ()) -> Prediction:
            return Prediction(values, jacobian)

        def rest(theta: Array) -> tuple[float, Array]:
            return even + float(np.log(known[2 * n])), even_by + by_log[2 * n]

        gain = self.gain(theta)
        if self.task.beside_layers:
            return predict_beside_layers(known_curve, data, x, gain=gain, log_speed_0=rest)
        ratio = float(theta[0]) / self.task.c0
        return predict_site(known_curve, data, x, c_ratio=ratio, gain=gain, log_speed_0=rest)

    def objective(self) -> Objective:
        def residual(theta: Array, derivative: bool = True) -> Residual:
            rows, slopes = [], []
            for k, state in enumerate(self.task.states):
                data, found, weights = state.data, self.predict(k, theta), self._weights[k]
                rows += [(data.depth - found.depth) / weights]
                slopes += [self._spread(-found.depth_slope / weights[:, None], k, theta)]
                rows += [(data.log_speed - found.log_speed) / data.speed_deviation]
                slopes += [self._spread(-found.log_speed_slope / data.speed_deviation[:, None], k, theta)]
            if self.gained:
                rows += [np.array([np.log(theta[-1]) / self.task.gain_deviation])]
                last = np.zeros((1, len(theta)))
                last[0, -1] = 1.0 / (theta[-1] * self.task.gain_deviation)
                slopes += [last]
            return Residual(np.concatenate(rows), np.vstack(slopes))

        return residual

    def _spread(self, slope: Array, k: int, theta: Array) -> Array:
        """Map derivatives by (ln c, ln gain, ln of the curve's parameters) to derivatives by theta."""
        by_log = np.zeros((len(slope), len(theta)))
        first = 1 + self.n_shape
        by_log[:, 0] = slope[:, 0]
        by_log[:, 1:first] = slope[:, 2 : 2 + self.n_shape]
        by_log[:, first : first + self.n_stretches] = (
            slope[:, 2 + self.n_shape :] @ self.task.states[k].factors
        )
        if self.gained:
            by_log[:, -1] = slope[:, 1]
        return by_log / theta

    def gain(self, theta: Array) -> float:
        return float(theta[-1]) if self.gained else 1.0

    # ------------------------------------------------------------ interface of adaptive_profiles

    def settle(self, theta: Array) -> bool:
        return self._weights.settle(theta)

    def starts(self) -> list[Array]:
        return [np.r_[each, np.ones(int(self.gained))] for each in self._starts]

    def uncertainty(self, theta: Array) -> float:
        return float(np.sqrt(sum(self._uncertainty_of(k, theta) ** 2 for k in range(len(self.task.states)))))

    def _uncertainty_of(self, k: int, theta: Array) -> float:
        """Error of the surrogate in state k, in standard deviations of its data."""
        data, found = self.task.states[k].data, self.predict(k, theta)
        deviation, n = self.emulator.deviation(self.place(k, theta)), len(data.knots)
        force = np.interp(found.depth, data.knots, deviation[:n]) * data.force / found.stiffness
        at = np.interp(data.speed_force, np.r_[0.0, data.force], np.r_[0.0, found.depth])
        speed = np.interp(at, np.r_[0.0, data.knots], np.r_[deviation[2 * n], deviation[n : 2 * n]])
        terms = np.r_[force / self._weights[k], speed / data.speed_deviation]
        return float(np.sqrt(np.sum(terms**2)))

    def distance(self, theta: Array) -> float:
        return max(self._distance_of(k, theta) for k in range(len(self.task.states)))

    def _distance_of(self, k: int, theta: Array) -> float:
        return self.emulator.distance(self.place(k, theta))

    def solve(self, theta: Array) -> None:
        """Simulate the states in which the surrogate is too uncertain, or else the state farthest from any
        solved point."""
        several = range(len(self.task.states))
        uncertain = [k for k in several if self._uncertainty_of(k, theta) > _SURE]
        uncertain = uncertain or [max(several, key=lambda each: self._distance_of(each, theta))]
        for x in [self.place(k, theta) for k in uncertain]:
            self.task.curve(x, tuple(range(len(x))))
        self.emulator.refresh()

    def within_reach(self, theta: Array) -> Array:
        solved = np.array([each for each, _ in self.task.curve.solved])
        beside = self.task.beside_layers
        near = drawn_in(theta, solved[:, int(beside) :], self.task.shape)
        if beside:
            near[0] = c_drawn_in(near[0], solved[:, 0], self.task.c0)
        return near

    def solved_at(self, theta: Array) -> Array:
        """The law's shape parameters and the stretch parameters."""
        return np.asarray(theta[1 : 1 + self.n_shape + self.n_stretches])


def states_fit(
    task: StatesTask, starts: Sequence[Array], *, max_rounds: int = 3, progress: Progress = SILENT
) -> tuple[StatesProblem, Intervals]:
    """Maximum-likelihood c, shape and stretches, with their profile likelihoods.

    starts : several initial guesses (c, shape..., stretches...); the curve must already hold some solved
        points
    max_rounds : largest number of rounds of simulations for the intervals; each round simulates every state
        that needs it. The rounds that refine the best fit come before and are not counted.

    Raises
    ------
    FitError
        If there are fewer data than parameters, or no start leads to a fit.
    """
    n_levels = sum(len(each.data.force) for each in task.states)
    n_speeds = sum(len(each.data.log_speed) for each in task.states)
    n_parameters = 1 + len(task.shape) + len(task.stretches)
    if n_levels + n_speeds < n_parameters:
        raise FitError(
            f"{n_levels} loaded levels and {n_speeds} speeds for {n_parameters} parameters",
            where=", ".join(each.data.name for each in task.states),
            fix="measure more levels, or give more of the states' stretches",
        )
    problem = StatesProblem(task, starts)
    for _ in range(_FOR_THE_BEST):
        best = best_of(problem.objective(), problem.parameters, problem.starts()).theta
        problem.settle(best)
        if problem.distance(best) < _NEAR:
            break
        try:
            problem.solve(problem.within_reach(best))
        except SolveError:  # adaptive_profiles narrows the bounds instead
            break
    return problem, adaptive_profiles(problem, max_solves=max_rounds, progress=progress)
