"""Joint likelihood of depth at given force and of shear-wave speed, for one or several sites.

Force is controlled and depth is the noisy reading, so the residual is a depth: the measured depth minus the
depth at which the simulation reaches the measured force. The wave speed of a level enters by its logarithm,
and the thickness of its layers directly, both at the simulated depth of that force. All sites share c and the
other parameters of the law ("shape"); each site has its own gain for the numerical error of its mesh. At
fixed shape every stress is proportional to c, so forces scale with c and speeds with its square root, and
only changes of the shape need simulations. This does not hold where layers with a fixed stiffness of their
own are in the model; there the curves have c as an additional parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.errors import FitError
from limbcli.inference.adaptive import Intervals, adaptive_profiles, drawn_in
from limbcli.inference.emulator import Emulator
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.residual import Objective, Residual
from limbcli.inference.site_depth import (
    DepthWeights,
    RestSpeed,
    SiteMeasurement,
    SitePrediction,
    invert,
    predict_beside_layers,
    predict_site,
    rest_speed_by_c,
)
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

__all__ = [
    "C_SPAN",
    "C_STEP_FACTOR",
    "JointProblem",
    "JointTask",
    "SiteMeasurement",
    "SitePrediction",
    "held_out_error",
    "invert",
    "joint_fit",
    "predict_site",
]

C_SPAN = 10.0  # factor from the start value of c to either of its bounds
C_STEP_FACTOR = 2.0  # largest factor of c from the solved points to a new one, where c is simulated
_LEAST = 1e-4  # lower limit of the standard deviation of the prior on ln c


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

    def is_beside_layers(self, k: int) -> bool:
        return bool(self.beside_layers) and self.beside_layers[k]


class JointProblem:
    """Estimation problem for `adaptive_profiles`; theta = (c, shape..., a gain for each site whose gain is
    uncertain)."""

    def __init__(self, task: JointTask, starts: Sequence[Array]):
        self.task = task
        self.n_shape = len(task.shape)
        self.gained = [k for k, each in enumerate(task.data) if each.gain_deviation > 0.0]
        self.parameters = [
            FitParameter("c", task.c0, task.c0 / C_SPAN, task.c0 * C_SPAN, "log"),
            *(each.in_logs() for each in task.shape),
            *(FitParameter(f"gain {task.data[k].name}", 1.0, 0.2, 5.0, "log") for k in self.gained),
        ]
        self.profiled = tuple(range(1 + self.n_shape))
        self.simulated = self.profiled if any(task.beside_layers) else self.profiled[1:]
        self.emulators = [Emulator(each) for each in task.curves]
        self._starts = list(starts)
        n_data = sum(len(each.force) + len(each.log_speed) + len(each.layers) for each in task.data)
        self.n_freedom = max(n_data - 1 - self.n_shape + (task.c_deviation is not None), 1)
        self._weights = DepthWeights(task.data, self.predict, self.starts()[0])

    # ------------------------------------------------------------ residuals

    def predict(self, k: int, theta: Array, *, data: SiteMeasurement | None = None) -> SitePrediction:
        """Prediction of site k at theta by the surrogates."""
        data, gain, rest = data or self.task.data[k], self._gain(k, theta), self.task.log_speed_0[k]
        place = self.place(k, theta)
        if self.task.is_beside_layers(k):
            rest = rest_speed_by_c(rest)
            return predict_beside_layers(self.emulators[k], data, place, gain=gain, log_speed_0=rest)
        ratio = float(theta[0]) / self.task.c0
        return predict_site(self.emulators[k], data, place, c_ratio=ratio, gain=gain, log_speed_0=rest)

    def place(self, k: int, theta: Array) -> Array:
        """Parameters of the curve of site k: the law's shape, preceded by c / c0 where layers have a fixed
        stiffness."""
        shape = self.solved_at(theta)
        return np.r_[theta[0] / self.task.c0, shape] if self.task.is_beside_layers(k) else shape

    def objective(self) -> Objective:
        def residual(theta: Array, derivative: bool = True) -> Residual:
            rows, slopes = [], []
            for k, data in enumerate(self.task.data):
                found = self.predict(k, theta)
                rows += [(data.depth - found.depth) / self._weights[k]]
                slopes += [self._spread(-found.depth_slope / self._weights[k][:, None], k, theta)]
                rows += [(data.log_speed - found.log_speed) / data.speed_deviation]
                slopes += [self._spread(-found.log_speed_slope / data.speed_deviation[:, None], k, theta)]
                rows += [data.layers.whitened(data.layers.thickness - found.layers)]
                slopes += [self._spread(-data.layers.whitened(found.layers_slope), k, theta)]
            priors, prior_slopes = self._priors(theta)
            return Residual(np.concatenate([*rows, priors]), np.vstack([*slopes, prior_slopes]))

        return residual

    def _spread(self, slope: Array, k: int, theta: Array) -> Array:
        """Map derivatives of a site by (ln c, ln gain, ln shape) to derivatives by theta."""
        wide = np.zeros((len(slope), len(theta)))
        wide[:, 0] = slope[:, 0] / theta[0]
        wide[:, 1 : 1 + self.n_shape] = slope[:, 2:] / theta[1 : 1 + self.n_shape]
        if k in self.gained:
            place = 1 + self.n_shape + self.gained.index(k)
            wide[:, place] = slope[:, 1] / theta[place]
        return wide

    def _priors(self, theta: Array) -> tuple[Array, Array]:
        places = [1 + self.n_shape + j for j in range(len(self.gained))]
        deviations = [self.task.data[k].gain_deviation for k in self.gained]
        centres = [1.0] * len(places)
        if self.task.c_deviation is not None:
            places, deviations = [0, *places], [max(self.task.c_deviation, _LEAST), *deviations]
            centres = [self.task.c0, *centres]
        values = np.array(
            [np.log(theta[p] / m) / s for p, m, s in zip(places, centres, deviations, strict=True)]
        )
        slopes = np.zeros((len(places), len(theta)))
        for row, (place, deviation) in enumerate(zip(places, deviations, strict=True)):
            slopes[row, place] = 1.0 / (theta[place] * deviation)
        return values, slopes

    def _gain(self, k: int, theta: Array) -> float:
        return float(theta[1 + self.n_shape + self.gained.index(k)]) if k in self.gained else 1.0

    # ------------------------------------------------------------ interface of adaptive_profiles

    def settle(self, theta: Array) -> bool:
        return self._weights.settle(theta)

    def starts(self) -> list[Array]:
        return [np.r_[each, np.ones(len(self.gained))] for each in self._starts]

    def uncertainty(self, theta: Array) -> float:
        total = 0.0
        for k, data in enumerate(self.task.data):
            n, deviation = len(data.knots), self.emulators[k].deviation(self.place(k, theta))
            found = self.predict(k, theta)
            force = np.interp(found.depth, data.knots, deviation[:n]) * data.force / found.stiffness
            total += float(np.sum((force / self._weights[k]) ** 2))
            if len(data.log_speed):
                at = np.interp(data.speed_force, data.force, found.depth)
                speed = np.interp(at, data.knots, deviation[n : 2 * n]) * (data.speed_force > 0.0)
                total += float(np.sum((speed / data.speed_deviation) ** 2))
            if len(data.layers):
                borders = deviation[-n * len(data.layers.rest) :].max() * data.layers.rest
                total += float(np.sum(data.layers.whitened(borders[data.layers.layer]) ** 2))
        return float(np.sqrt(total))

    def distance(self, theta: Array) -> float:
        return max(each.distance(self.place(k, theta)) for k, each in enumerate(self.emulators))

    def solve(self, theta: Array) -> None:
        for k, (curve, emulator) in enumerate(zip(self.task.curves, self.emulators, strict=True)):
            place = self.place(k, theta)
            curve(place, tuple(range(len(place))))
            emulator.refresh()

    def within_reach(self, theta: Array) -> Array:
        near = theta
        for k, curve in enumerate(self.task.curves):
            beside = self.task.is_beside_layers(k)
            solved = np.array([each for each, _ in curve.solved])
            near = drawn_in(near, solved[:, int(beside) :], self.task.shape)
            if beside:
                near[0] = c_drawn_in(near[0], solved[:, 0], self.task.c0)
        return near

    def solved_at(self, theta: Array) -> Array:
        """The law's shape parameters."""
        return np.asarray(theta[1 : 1 + self.n_shape])


def c_drawn_in(c: float, solved: Array, c0: float) -> float:
    """c limited to one step factor beyond the simulated values; solved : (n,) of c / c0.

    >>> c_drawn_in(0.05, np.array([0.5, 2.0]), 0.01)
    0.04
    """
    return float(np.clip(c, c0 * solved.min() / C_STEP_FACTOR, c0 * solved.max() * C_STEP_FACTOR))


def joint_fit(
    task: JointTask, starts: Sequence[Array], *, max_solves: int = 16, progress: Progress = SILENT
) -> tuple[JointProblem, Intervals]:
    """Maximum-likelihood c and shape, with their profile likelihoods.

    starts : several initial guesses (c, shape...); each curve must hold at least two solved points

    Raises
    ------
    FitError
        If there are fewer levels than parameters, or no start leads to a fit.
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


def held_out_error(problem: JointProblem, found: Intervals, *, n_folds: int = 3) -> tuple[float, float]:
    """Cross-validated root mean square errors of depth (mm) and of ln speed; every n-th level is left out in
    turn.

    The remaining levels are fitted again each time (on the surrogates), so a law with more parameters has no
    advantage. NaN where there are no speeds.
    """
    from limbcli.inference.profile import best_of

    depth_errors, speed_errors = [], []
    for fold in range(n_folds):
        left = [np.arange(len(each.force)) % n_folds == fold for each in problem.task.data]
        kept = [each.without(out) for each, out in zip(problem.task.data, left, strict=True)]
        task = replace(problem.task, data=kept)
        part = JointProblem(task, [found.best[: 1 + problem.n_shape]])
        best = best_of(part.objective(), part.parameters, [found.best, *part.starts()])
        for k, (data, out) in enumerate(zip(problem.task.data, left, strict=True)):
            seen = problem.predict(k, best.theta)
            depth_errors.append((data.depth - seen.depth)[out])
            gone = np.isin(data.speed_force, data.force[out])
            speed_errors.append((data.log_speed - seen.log_speed)[gone])
    depth, speed = np.concatenate(depth_errors), np.concatenate(speed_errors)
    return (
        float(np.sqrt(np.mean(depth**2))),
        float(np.sqrt(np.mean(speed**2))) if len(speed) else float("nan"),
    )
