"""Fit of one tissue measured in several states that share a law but differ in their stretch before loading.

The likelihood is that of the joint fit: depth at given force, and the logarithm of each wave speed, at rest
and under load. All states share one simulated curve, which is a function of the law's shape parameters and of
the stretches. A state only selects a point in that parameter space: ln of its stretches is a constant plus a
linear combination of the stretch parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.errors import FitError, SolveError
from limbcli.inference.adaptive import Intervals, adaptive_profiles
from limbcli.inference.emulator import Emulator
from limbcli.inference.joint_fit import gain_of_mesh, start_c
from limbcli.inference.likelihood import EvenSpeed, Likelihood, Place, SiteBlock
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.profile import best_of
from limbcli.inference.site_depth import SiteMeasurement
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

_FOR_THE_BEST = 4  # largest number of rounds of simulations that refine the best fit before the intervals
_NEAR = 0.05  # largest distance from a solved point, in ln of the curve's parameters, of a simulated best fit


@dataclass(frozen=True, eq=False)
class StatesTask:
    """Input of the fit of several states.

    curve : (shape, stretches) -> forces and relative speeds at the knots, the relative speed at rest, and exp
        of the rise of the skin (mm), all for c0
    even_speed : the speed in evenly stretched tissue to which those speeds are relative
    data : of the states; their `knots` are probe depths on the common curve (mm)
    offsets (n_states, n_ways), factors (n_states, n_ways, n_stretches) : ln of a state's stretches is its
        offset plus its factors times ln of the stretch parameters
    shape, stretches : parameters of the law and of the states
    gain_deviation : standard deviation of the numerical error of ln force, common to all states because they
        share one mesh
    beside_layers : the curve is a function of (c / c0, shape, stretches), because layers with a fixed
        stiffness of their own are in the model
    """

    curve: SolvedPoints
    even_speed: EvenSpeed
    data: Sequence[SiteMeasurement]
    offsets: Array
    factors: Array
    shape: Sequence[FitParameter]
    stretches: Sequence[FitParameter]
    c0: float
    gain_deviation: float
    beside_layers: bool = False


class StatesProblem(Likelihood):
    """Likelihood of the states; theta = (c, shape..., stretches..., gain if it is uncertain)."""

    blocks: Sequence[SiteBlock]

    def __init__(self, task: StatesTask, starts: Sequence[Array]):
        self.task = task
        first = 1 + len(task.shape)
        last = first + len(task.stretches)
        gained = task.gain_deviation > 0.0
        parameters = [
            start_c(task.c0),
            *(each.in_logs() for each in (*task.shape, *task.stretches)),
            *([gain_of_mesh()] if gained else []),
        ]
        emulator, blocks = Emulator(task.curve), []
        for data, offset, own in zip(task.data, task.offsets, task.factors, strict=True):
            factors = np.zeros((len(offset), len(parameters)))
            factors[:, first:last] = own
            place = Place.of(
                len(parameters), c0=task.c0, shape=range(1, first), beside_layers=task.beside_layers,
                gain=last if gained else None, offset=offset, factors=factors,
            )  # fmt: skip
            blocks.append(SiteBlock(data, emulator, place, even_speed=task.even_speed))
        ones = np.ones(int(gained))
        super().__init__(
            parameters, blocks, [np.r_[each, ones] for each in starts], profiled=range(last),
            priors=[(last, 1.0, task.gain_deviation)] if gained else [], n_shape=first - 1,
        )  # fmt: skip

    def curve_shape(self, theta: Array) -> Array:
        """Shape parameters passed to the curve, preceded by c / c0 where layers have a fixed stiffness."""
        return self.place(0, theta)[: self.n_shape + int(self.task.beside_layers)]

    def c_of_curve(self, theta: Array) -> float:
        """The c (MPa) that, together with the curve's parameters, describes the tissue of theta."""
        return self.task.c0 * self.blocks[0].place(theta)[0]

    def gain(self, theta: Array) -> float:
        return self.blocks[0].place(theta)[1]


def states_fit(
    task: StatesTask, starts: Sequence[Array], *, max_rounds: int = 3, progress: Progress = SILENT
) -> tuple[StatesProblem, Intervals]:
    """Maximum-likelihood c, shape and stretches, with their profile likelihoods.

    starts : several initial guesses (c, shape..., stretches...); the curve must already hold some solved
        points
    max_rounds : largest number of rounds of simulations for the intervals; each round simulates every state
        that needs it. The rounds that refine the best fit come before and are not counted.

    Raises FitError if there are fewer data than parameters, or no start leads to a fit.
    """
    n_levels = sum(len(each.force) for each in task.data)
    n_speeds = sum(len(each.log_speed) for each in task.data)
    n_parameters = 1 + len(task.shape) + len(task.stretches)
    if n_levels + n_speeds < n_parameters:
        raise FitError(
            f"{n_levels} loaded levels and {n_speeds} speeds for {n_parameters} parameters",
            where=", ".join(each.name for each in task.data),
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
