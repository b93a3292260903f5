"""Joint fit of one or several sites by depth at given force, shear-wave speed and layers.

Force is controlled and depth is the noisy reading, so the residual is a depth: the measured depth minus the
depth at which the simulation reaches the measured force. The wave speed of a level enters by its logarithm,
and the thickness of its layers directly, both at the simulated depth of that force. All sites share c and the
other parameters of the law ("shape"); each site has its own gain for the numerical error of its mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.errors import FitError
from limbcli.inference.adaptive import Intervals, adaptive_profiles
from limbcli.inference.emulator import Emulator
from limbcli.inference.likelihood import Likelihood, Place, SiteBlock
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.profile import best_of
from limbcli.inference.site_depth import RestSpeed, SiteMeasurement, rest_speed_by_c
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

C_SPAN = 10.0  # factor from the start value of c to either of its bounds
_FOLDS = 3
_LEAST = 1e-4  # lower limit of the standard deviation of the prior on ln c


def start_c(c0: float) -> FitParameter:
    """The parameter c (MPa)."""
    return FitParameter("c", c0, c0 / C_SPAN, c0 * C_SPAN, "log")


def gain_of_mesh(name: str = "gain") -> FitParameter:
    """The parameter by which the mesh's error multiplies forces."""
    return FitParameter(name, 1.0, 0.2, 5.0, "log")


@dataclass(frozen=True, eq=False)
class JointTask:
    """Input of the joint fit: curves and data by site, the shape parameters, the start value of c and the
    unloaded speed.

    c0 : MPa, the c of the curves
    log_speed_0 : ln sqrt(c0 / (2 rho)) in m/s, by site, or as `RestSpeed`
    c_deviation : standard deviation of a prior on ln c around c0; None where the speeds themselves determine
        c
    beside_layers : by site, whether its curve is a function of (c / c0, shape...), because its layers have a
        fixed stiffness
    """

    curves: Sequence[SolvedPoints]
    data: Sequence[SiteMeasurement]
    shape: Sequence[FitParameter]
    c0: float
    log_speed_0: Sequence[RestSpeed]
    c_deviation: float | None = None
    beside_layers: Sequence[bool] = ()


class JointProblem(Likelihood):
    """Likelihood of the sites; theta = (c, shape..., a gain for each site whose gain is uncertain)."""

    blocks: Sequence[SiteBlock]

    def __init__(self, task: JointTask, starts: Sequence[Array]):
        self.task = task
        n = 1 + len(task.shape)
        self.gained = [k for k, each in enumerate(task.data) if each.gain_deviation > 0.0]
        parameters = [
            start_c(task.c0),
            *(each.in_logs() for each in task.shape),
            *(gain_of_mesh(f"gain {task.data[k].name}") for k in self.gained),
        ]
        priors = [(n + j, 1.0, task.data[k].gain_deviation) for j, k in enumerate(self.gained)]
        if task.c_deviation is not None:
            priors.append((0, task.c0, max(task.c_deviation, _LEAST)))
        blocks = []
        for k, (data, curve, rest) in enumerate(zip(task.data, task.curves, task.log_speed_0, strict=True)):
            beside = bool(task.beside_layers) and task.beside_layers[k]
            gain = n + self.gained.index(k) if k in self.gained else None
            place = Place.of(len(parameters), c0=task.c0, shape=range(1, n), beside_layers=beside, gain=gain)
            blocks.append(SiteBlock(data, Emulator(curve), place, rest_speed_by_c(rest) if beside else rest))
        ones = np.ones(len(self.gained))
        super().__init__(
            parameters, blocks, [np.r_[each, ones] for each in starts],
            profiled=range(n), priors=priors, n_shape=n - 1,
        )  # fmt: skip


def joint_fit(
    task: JointTask, starts: Sequence[Array], *, max_solves: int = 16, progress: Progress = SILENT
) -> tuple[JointProblem, Intervals]:
    """Maximum-likelihood c and shape, with their profile likelihoods.

    starts : several initial guesses (c, shape...); each curve must hold at least two solved points

    Raises FitError if there are fewer levels than parameters, or no start leads to a fit.
    """
    n_levels, n_parameters = sum(len(each.force) for each in task.data), 1 + len(task.shape)
    if n_levels < n_parameters:
        raise FitError(
            f"{n_levels} loaded levels for {n_parameters} parameters",
            where=", ".join(each.name for each in task.data),
            fix="measure more levels, or choose a law with fewer parameters (--law mooney-rivlin)",
        )
    problem = JointProblem(task, starts)
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
