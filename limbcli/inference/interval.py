"""95 % intervals of the paper's fit by profile likelihood.

The likelihood includes what the paper's objective leaves out: depth is the noisy quantity; c, held fixed in
the fit, is known only to the precision of the shear-wave measurement; and the mesh biases the force. At fixed
f_kappa and m every stress, and hence every force, is proportional to c, so varying c needs no simulation.
Where layers with a fixed stiffness of their own are in the model, ln force changes by only a fraction of ln
c, and the mesh error is a separate parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.inference.adaptive import Intervals, adaptive_profiles
from limbcli.inference.emulator import Emulator
from limbcli.inference.geometry_uncertainty import at_depths, whitened
from limbcli.inference.identifiability import force_variance
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import Prediction, Predictor, SolvedPoints, sampled, slopes_at
from limbcli.inference.residual import Objective, force_residual, with_prior
from limbcli.inference.two_step_fit import ForceDepth, search_parameters
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

_LEAST_LOG_DEVIATION = 1e-4  # lower limit of the standard deviation of ln c or ln gain
_REACH = 6.0  # distance of the bounds of c or the gain from the start value, in standard deviations


@dataclass(frozen=True, eq=False)
class Stiffness:
    """c (MPa) and the standard deviation of ln c.

    gain_deviation : standard deviation of ln of the simulated force due to the mesh. Where all forces are
        proportional to c, an error common to them cannot be distinguished from an error of c.
    share : (n_knots,) d ln force / d ln c at the simulated depths, where layers have a fixed stiffness of
        their own; None: 1
    """

    c: float
    log_deviation: float
    gain_deviation: float = 0.0
    share: Array | None = None

    @property
    def force_deviation(self) -> float:
        """Standard deviation of ln force due to c and the mesh together, where all forces are proportional to
        c."""
        return float(np.hypot(self.log_deviation, self.gain_deviation))

    def nuisances(self) -> list[tuple[FitParameter, float]]:
        """Nuisance parameters that scale the forces, each with the standard deviation of its logarithm.

        This is c, with the mesh error included in it; where layers have a fixed stiffness, c and then the
        mesh's gain.
        """
        if self.share is None:
            return [_around("c", self.c, self.force_deviation)]
        return [_around("c", self.c, self.log_deviation), _around("gain", 1.0, self.gain_deviation)]


def _around(name: str, value: float, log_deviation: float) -> tuple[FitParameter, float]:
    deviation = max(log_deviation, _LEAST_LOG_DEVIATION)
    spread = float(np.exp(_REACH * deviation))
    return FitParameter(name, value, value / spread, value * spread, "log"), deviation


def force_intervals(
    curve: SolvedPoints,
    knots: Array,
    data: ForceDepth,
    stiffness: Stiffness,
    theta: Array,
    *,
    free: Sequence[int] = (0, 1),
    max_solves: int = 12,
    shape_modes: Array | None = None,
    progress: Progress = SILENT,
) -> Intervals:
    """Profile likelihoods of f_kappa and m (those in `free`), with c varying within its own and the mesh's
    uncertainty.

    Chi-square = sum (F_exp - F_sim)^2 / (sigma_F^2 + (dF/dd sigma_d)^2) + (ln c/c0)^2 / sigma^2, with the
    slopes dF/dd of the fit. At most `max_solves` simulations are added to those in `curve`. `best` of the
    result is (c, the parameters in `free`), followed by the mesh's gain where layers have a fixed stiffness.

    theta : (f_kappa, m) of the fit
    shape_modes : (n_modes, n_knots) changes of ln force, one standard deviation each, due to the uncertainty
        of the model's geometry
    """
    problem = _ForceProblem(curve, knots, data, stiffness, theta, tuple(free), shape_modes)
    estimate = problem.starts()[0]
    return adaptive_profiles(problem, max_solves=max_solves, estimate=estimate, progress=progress)


class _ForceProblem:
    """Estimation problem; theta = (c, the free ones of f_kappa and m, and a gain where layers have a fixed
    stiffness)."""

    def __init__(
        self, curve: SolvedPoints, knots: Array, data: ForceDepth, stiffness: Stiffness, fitted: Array,
        free: tuple[int, ...], shape_modes: Array | None = None,
    ):  # fmt: skip
        self.curve, self.knots, self.stiffness, self.fitted, self.free = curve, knots, stiffness, fitted, free
        self.depth, self.force = data.depth[data.loaded], data.force[data.loaded]
        slope = slopes_at(curve, knots, self.depth, fitted)
        self.deviation = np.sqrt(
            force_variance(slope, force_deviation=data.force_deviation, depth_deviation=data.depth_deviation)
        )
        shape = [p.started_at(float(t)).in_logs() for p, t in zip(search_parameters(), fitted, strict=True)]
        (c, _), *others = stiffness.nuisances()
        self.parameters = [c, *(shape[k] for k in free), *(each for each, _ in others)]
        self.share = np.ones(len(self.depth))
        if stiffness.share is not None:
            self.share = at_depths(stiffness.share[None], knots, self.depth)[:, 0]
        self.profiled = self.simulated = tuple(range(1, 1 + len(free)))
        self.n_freedom = max(len(self.force) - len(free), 1)
        self.emulator = Emulator(curve)
        self.spread: Array | None = None  # N (n, n_modes)
        if shape_modes is not None and len(shape_modes):
            known = sampled(curve, knots, self.depth, free=(0, 1), fixed=fitted)(fitted, derivative=False)
            self.spread = known.values[:, None] * at_depths(shape_modes, knots, self.depth)

    def objective(self) -> Objective:
        predict = sampled(self.emulator, self.knots, self.depth, free=(0, 1), fixed=self.fitted)
        scaled = _times_c(predict, self.stiffness.c, self.share, self.fitted, self.free)
        force = force_residual(scaled, self.force, deviation=self.deviation)
        if self.spread is not None:
            force = whitened(force, self.deviation, self.spread)
        for place, (each, deviation) in zip((0, -1), self.stiffness.nuisances(), strict=False):
            force = with_prior(force, place, mean=each.start, log_deviation=deviation)
        return force

    def settle(self, theta: Array) -> bool:
        """Always False: the weights are those of the published fit."""
        return False

    def starts(self) -> list[Array]:
        """The fit, and the three solved points whose forces are closest to those of the fit."""
        target = self.curve(self.fitted).values
        visited = sorted(self.curve.solved, key=lambda each: float(np.sum((each[1].values - target) ** 2)))
        thetas = [self.fitted, *(theta for theta, _ in visited[1:4])]
        gain = np.ones(len(self.parameters) - 1 - len(self.free))
        return [np.r_[self.stiffness.c, theta[list(self.free)], gain] for theta in thetas]

    def uncertainty(self, theta: Array) -> float:
        shape = self.solved_at(theta)
        error = self.emulator.deviation(shape) * self.emulator(shape).values
        factor = (theta[0] / self.stiffness.c) ** self.share
        return float(np.linalg.norm(factor * np.interp(self.depth, self.knots, error) / self.deviation))

    def distance(self, theta: Array) -> float:
        return self.emulator.distance(self.solved_at(theta))

    def solve(self, theta: Array) -> None:
        self.curve(self.solved_at(theta), (0, 1))
        self.emulator.refresh()

    def within_reach(self, theta: Array) -> Array:
        """theta, limited to one step factor beyond the solved points."""
        solved = np.array([each for each, _ in self.curve.solved])
        near = theta.copy()
        for k, (parameter, column) in enumerate(zip(self.parameters[1:], self.free, strict=False), 1):
            low, high = solved[:, column].min(), solved[:, column].max()
            near[k] = np.clip(theta[k], low / parameter.step_factor, high * parameter.step_factor)
        return near

    def solved_at(self, theta: Array) -> Array:
        full = self.fitted.copy()
        full[list(self.free)] = theta[1 : 1 + len(self.free)]
        return full


def _times_c(predict: Predictor, c0: float, share: Array, fixed: Array, free: tuple[int, ...]) -> Predictor:
    """Force as a function of (c, free shape parameters[, gain]).

    It is proportional to (c / c0) to the power of its share (n,), and to the gain.
    """
    last = 1 + len(free)

    def scaled(theta: Array, *, derivative: bool = True) -> Prediction:
        shape = fixed.copy()
        shape[list(free)] = theta[1:last]
        base = predict(shape, derivative=derivative)
        factor = (theta[0] / c0) ** share * np.prod(theta[last:])
        values = factor * base.values
        if base.jacobian is None:
            return Prediction(values)
        columns = [values * share / theta[0], *(factor * base.jacobian[:, k] for k in free)]
        columns += [values / gain for gain in theta[last:]]
        return Prediction(values, np.column_stack(columns))

    return scaled
