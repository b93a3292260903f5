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
from limbcli.inference.likelihood import ForceBlock, Likelihood, Place
from limbcli.inference.parameter import FitParameter
from limbcli.inference.surrogate import Emulator
from limbcli.inference.two_step_fit import CurveMatch, search_parameters
from limbcli.model import Array
from limbcli.numbers.modes import at_depths
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

    def share_at_levels(self, match: CurveMatch) -> Array:
        """d ln force / d ln c (n,) at the loaded levels."""
        if self.share is None:
            return np.ones(len(match.data.loaded_depth))
        return at_depths(self.share[None], match.knots, match.data.loaded_depth)[:, 0]

    @property
    def force_deviation(self) -> float:
        """Standard deviation of ln force due to c and the mesh, where all forces are proportional to c."""
        return float(np.hypot(self.log_deviation, self.gain_deviation))

    def nuisances(self) -> list[tuple[FitParameter, float]]:
        """Nuisance parameters that scale the forces, each with the standard deviation of its logarithm: c,
        with the mesh error in it; where layers have a fixed stiffness, c and then the mesh's gain."""
        if self.share is None:
            return [_around("c", self.c, self.force_deviation)]
        return [_around("c", self.c, self.log_deviation), _around("gain", 1.0, self.gain_deviation)]


def _around(name: str, value: float, log_deviation: float) -> tuple[FitParameter, float]:
    deviation = max(log_deviation, _LEAST_LOG_DEVIATION)
    spread = float(np.exp(_REACH * deviation))
    return FitParameter(name, value, value / spread, value * spread, "log"), deviation


def force_intervals(
    match: CurveMatch, stiffness: Stiffness, theta: Array, *, free: Sequence[int] = (0, 1),
    max_solves: int = 12, shape_modes: Array | None = None, progress: Progress = SILENT,
) -> Intervals:  # fmt: skip
    """Profile likelihoods of f_kappa and m (those in `free`) about the fit's theta, with c varying within its
    own and the mesh's uncertainty.

    Chi-square = sum (F_exp - F_sim)^2 / (sigma_F^2 + (dF/dd sigma_d)^2) + (ln c/c0)^2 / sigma^2, with the
    slopes dF/dd of the fit. At most `max_solves` simulations are added. `best` of the result is (c, the free
    parameters), then the mesh's gain where layers have a fixed stiffness.

    shape_modes : (n_modes, n_knots) changes of ln force, one standard deviation each, by uncertain geometry
    """
    problem = _ForceProblem(match, stiffness, theta, tuple(free), shape_modes)
    estimate = problem.starts()[0]
    return adaptive_profiles(problem, max_solves=max_solves, estimate=estimate, progress=progress)


class _ForceProblem(Likelihood):
    """Likelihood of the force; theta = (c, the free ones of f_kappa and m, and a gain beside layers of fixed
    stiffness)."""

    def __init__(
        self, match: CurveMatch, stiffness: Stiffness, fitted: Array, free: tuple[int, ...],
        shape_modes: Array | None = None,
    ):  # fmt: skip
        curve, knots, data = match.curve, match.knots, match.data
        depth, force = data.loaded_depth, data.force[data.loaded]
        covariance = np.diag(match.variance(fitted))
        if shape_modes is not None and len(shape_modes):
            moved = match.moved(fitted, shape_modes)
            covariance = covariance + moved @ moved.T
        shape = [p.started_at(float(t)).in_logs() for p, t in zip(search_parameters(), fitted, strict=True)]
        (c, _), *others = nuisances = stiffness.nuisances()
        parameters = [c, *(shape[k] for k in free), *(each for each, _ in others)]
        last, factors = 1 + len(free), np.zeros((2, len(parameters)))
        factors[free, range(1, last)] = 1.0
        place = Place.of(
            len(parameters), c0=stiffness.c, shape=(), gain=last if others else None,
            offset=np.where(factors.any(axis=1), 0.0, np.log(fitted)), factors=factors,
        )  # fmt: skip
        share = stiffness.share_at_levels(match)
        block = ForceBlock(Emulator(curve), place, knots, depth, force, covariance, share)
        target = curve(fitted).values
        visited = sorted(curve.solved, key=lambda each: float(np.sum((each[1].values - target) ** 2)))
        starts = [fitted, *(theta for theta, _ in visited[1:4])]  # closest to the forces of the fit
        super().__init__(
            parameters, [block],
            [np.r_[stiffness.c, theta[list(free)], np.ones(len(others))] for theta in starts],
            profiled=range(1, last), n_shape=len(free),
            priors=[
                (k, each.start, deviation)
                for k, (each, deviation) in zip((0, last), nuisances, strict=False)
            ],
        )  # fmt: skip

    def solved_at(self, theta: Array) -> Array:
        """f_kappa and m."""
        return self.blocks[0].place(theta)[2]
