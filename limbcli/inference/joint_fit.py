"""Joint fit of sites, or of the states of one, by depth at given force, shear-wave speed and layers.

Force is controlled and depth is the noisy reading, so the residual is a depth: the measured depth minus the
depth at which the simulation reaches the measured force. The wave speed of a level enters by its logarithm,
and the thickness of its layers directly, both at the simulated depth of that force. All share c and the other
parameters of the law ("shape"); each mesh has its own gain for its numerical error.

States of one site differ in their stretch before loading. They share one simulated curve, a function of the
shape and of the stretches, of which a state selects a point: ln of its stretches is a constant plus a linear
combination of the stretch parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.errors import FitError, SolveError
from limbcli.inference.adaptive import Intervals, adaptive_profiles
from limbcli.inference.likelihood import EvenSpeed, Likelihood, Place, SiteBlock
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.profile import best_of
from limbcli.inference.site_depth import RestSpeed, SiteMeasurement, rest_speed_by_c
from limbcli.inference.surrogate import Emulator
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

C_SPAN = 10.0  # factor from the start value of c to either of its bounds
_FOLDS = 3
_LEAST = 1e-4  # lower limit of the standard deviation of the prior on ln c
_FOR_THE_BEST = 4  # largest number of rounds of simulations that refine the best fit of states
_NEAR = 0.05  # largest distance from a solved point, in ln of the curve's parameters, of a simulated best fit


@dataclass(frozen=True, eq=False)
class States:
    """What distinguishes the states of one site: ln of a state's stretches is its offset (n_states, n_ways)
    plus its factors (n_states, n_ways, n_parameters) times ln of the `parameters`."""

    parameters: Sequence[FitParameter]
    offsets: Array
    factors: Array


@dataclass(frozen=True, eq=False)
class JointTask:
    """Input of the joint fit: curves and data by site or state, and the parameters of the law.

    curves : by site; the same one for all states, of (shape, stretches)
    c0 : MPa, the c of the curves; even_speed : of states, the speed in evenly stretched tissue, to which the
        speeds of the curve and, as its last value, that at rest are relative
    log_speed_0 : ln sqrt(c0 / (2 rho)) in m/s, by site, or as `RestSpeed`; of states none
    c_deviation : standard deviation of a prior on ln c around c0; None where the speeds determine c
    beside_layers : by site, whether its curve is a function of (c / c0, shape...), because its layers have a
        fixed stiffness
    """

    curves: Sequence[SolvedPoints]
    data: Sequence[SiteMeasurement]
    shape: Sequence[FitParameter]
    c0: float
    log_speed_0: Sequence[RestSpeed] = ()
    c_deviation: float | None = None
    beside_layers: Sequence[bool] = ()
    states: States | None = None
    even_speed: EvenSpeed | None = None

    @property
    def stretches(self) -> Sequence[FitParameter]:
        return () if self.states is None else self.states.parameters


class JointProblem(Likelihood):
    """Likelihood of the sites or states; theta = (c, shape..., stretches..., the uncertain gains)."""

    blocks: Sequence[SiteBlock]

    def __init__(self, task: JointTask, starts: Sequence[Array]):
        self.task, states = task, task.states
        first, last = 1 + len(task.shape), 1 + len(task.shape) + len(task.stretches)
        # site of each gain; all states share one mesh, and so the gain of the first
        meshes = range(len(task.data)) if states is None else range(1)
        self.gained = [k for k in meshes if task.data[k].gain_deviation > 0.0]
        names = [f"gain {task.data[k].name}" if states is None else "gain" for k in self.gained]
        parameters = [
            FitParameter("c", task.c0, task.c0 / C_SPAN, task.c0 * C_SPAN, "log"),
            *(each.in_logs() for each in (*task.shape, *task.stretches)),
            *(FitParameter(name, 1.0, 0.2, 5.0, "log") for name in names),
        ]
        priors = [(last + j, 1.0, task.data[k].gain_deviation) for j, k in enumerate(self.gained)]
        if task.c_deviation is not None:
            priors.append((0, task.c0, max(task.c_deviation, _LEAST)))
        blocks: list[SiteBlock] = []
        for k, (data, curve) in enumerate(zip(task.data, task.curves, strict=True)):
            beside, mesh = bool(task.beside_layers) and task.beside_layers[k], k if states is None else 0
            gain = last + self.gained.index(mesh) if mesh in self.gained else None
            own: dict[str, Array] = {}
            if states is not None:
                factors = np.zeros((len(states.offsets[k]), len(parameters)))
                factors[:, first:last] = states.factors[k]
                own = {"offset": states.offsets[k], "factors": factors}
            place = Place.of(
                len(parameters), c0=task.c0, shape=range(1, first), beside_layers=beside, gain=gain, **own
            )
            emulator = Emulator(curve) if states is None or not blocks else blocks[0].emulator
            rest = task.log_speed_0[k] if task.log_speed_0 else 0.0
            rest = rest_speed_by_c(rest) if beside else rest
            blocks.append(SiteBlock(data, emulator, place, rest, even_speed=task.even_speed))
        ones = np.ones(len(self.gained))
        super().__init__(
            parameters, blocks, [np.r_[each, ones] for each in starts],
            profiled=range(last), priors=priors, n_shape=first - 1,
        )  # fmt: skip

    def curve_shape(self, theta: Array) -> Array:
        """Shape parameters passed to the curve, preceded by c / c0 where layers have a fixed stiffness."""
        return self.place(0, theta)[: self.n_shape + any(self.task.beside_layers)]


def joint_fit(
    task: JointTask, starts: Sequence[Array], *, max_solves: int = 16, progress: Progress = SILENT
) -> tuple[JointProblem, Intervals]:
    """Maximum-likelihood c, shape and stretches, with their profile likelihoods.

    starts : several initial guesses (c, shape..., stretches...); each curve must hold solved points
    max_solves : largest number of rounds of simulations for the intervals, each of all curves, or of all
        states that need it. Of states, rounds that refine the best fit come before and are not counted

    Raises FitError if there are fewer data than parameters, or no start leads to a fit.
    """
    n_parameters = 1 + len(task.shape) + len(task.stretches)
    n_data = n_levels = sum(len(each.force) for each in task.data)
    what, fix = f"{n_levels} loaded levels", "choose a law with fewer parameters (--law mooney-rivlin)"
    if task.states is not None:
        n_speeds = sum(len(each.log_speed) for each in task.data)
        n_data, what = n_levels + n_speeds, f"{what} and {n_speeds} speeds"
        fix = "give more of the states' stretches"
    if n_data < n_parameters:
        raise FitError(
            f"{what} for {n_parameters} parameters",
            where=", ".join(each.name for each in task.data),
            fix=f"measure more levels, or {fix}",
        )
    problem = JointProblem(task, starts)
    for _ in range(_FOR_THE_BEST if task.states is not None else 0):
        best = best_of(problem.objective(), problem.parameters, problem.starts()).theta
        problem.settle(best)
        if problem.distance(best) < _NEAR:
            break
        try:
            problem.solve(problem.within_reach(best))
        except SolveError:  # adaptive_profiles narrows the bounds instead
            break
    return problem, adaptive_profiles(problem, max_solves=max_solves, progress=progress)


def held_out_error(problem: JointProblem, found: Intervals) -> tuple[float, float]:
    """Cross-validated root mean square errors of depth (mm) and of ln speed; every third level is left out in
    turn.

    The remaining levels are fitted again each time (on the surrogates), so a law with more parameters has no
    advantage. NaN where there are no speeds.
    """
    depth_errors, speed_errors = [], []
    for fold in range(_FOLDS):
        left = [np.arange(len(each.force)) % _FOLDS == fold for each in problem.task.data]
        kept = [each.without(out) for each, out in zip(problem.task.data, left, strict=True)]
        task = replace(problem.task, data=kept)
        part = JointProblem(task, [found.best[: 1 + problem.n_shape]])
        best = best_of(part.objective(), part.parameters, [found.best, *part.starts()])
        for k, (data, out) in enumerate(zip(problem.task.data, left, strict=True)):
            seen = problem.blocks[k].predict(best.theta)
            depth_errors.append((data.depth - seen.depth)[out])
            gone = np.isin(data.speed_force, data.force[out])
            speed_errors.append((data.log_speed - seen.log_speed)[gone])
    depth, speed = np.concatenate(depth_errors), np.concatenate(speed_errors)
    return (
        float(np.sqrt(np.mean(depth**2))),
        float(np.sqrt(np.mean(speed**2))) if len(speed) else float("nan"),
    )
