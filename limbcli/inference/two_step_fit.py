"""The paper's identification: f_kappa with m = 2 first, then f_kappa and m starting from that result."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import FitError
from limbcli.inference.identifiability import force_variance
from limbcli.inference.least_squares import Fit, Guide, least_squares_fit
from limbcli.inference.monotone_interpolation import Sample, pchip_sample
from limbcli.inference.parameter import F_KAPPA_BOUNDS, M_BOUNDS, FitParameter
from limbcli.inference.prediction import (
    Prediction,
    SolvedPoints,
    coefficient_of_determination,
    force_residual,
    root_mean_square,
    sampled,
)
from limbcli.inference.surrogate import Emulator
from limbcli.model import Array
from limbcli.numbers.modes import at_depths
from limbcli.progress import SILENT, Progress

F_KAPPA, M = 0, 1
START_F_KAPPA = 100.0
M_MOONEY_RIVLIN = 2.0
# Largest factor of m in one step. Stresses depend on stretches to the power of m, so a larger step may lead
# to models that cannot be solved.
M_STEP_FACTOR = 2.5
MOONEY_RIVLIN, OGDEN = "mooney-rivlin", "ogden"


@dataclass(frozen=True, eq=False)
class ForceDepth:
    """Data of a force fit: force (n,) N at depth (n,) mm, first touch included.

    force_deviation, depth_deviation : one standard deviation each
    """

    force: Array
    depth: Array
    force_deviation: float
    depth_deviation: float

    @property
    def loaded(self) -> NDArray[np.bool_]:
        """(n,) bool: the levels past first touch, the only ones that carry information."""
        return self.depth > 0.0

    @property
    def loaded_depth(self) -> Array:
        """Depths (n_loaded,) in mm of these levels."""
        return self.depth[self.loaded]


@dataclass(frozen=True, eq=False)
class CurveMatch:
    """A simulated curve, and the readings that it is fitted to.

    curve : (f_kappa, m) -> force (n_knots,) N at depths `knots` mm
    """

    curve: SolvedPoints
    knots: Array
    data: ForceDepth

    def sample(self, theta: Array, depths: Array) -> Sample:
        """The curve (N) at depths (n,) mm, with its slopes; 0 before first touch."""
        forces = np.r_[0.0, self.curve(theta).values]
        return pchip_sample(np.r_[0.0, self.knots], forces, np.maximum(depths, 0.0))

    def variance(self, theta: Array) -> Array:
        """Variance (n,), N^2, of the force residuals at the loaded levels."""
        data = self.data
        slopes = self.sample(theta, data.loaded_depth).slopes
        return force_variance(
            slopes, force_deviation=data.force_deviation, depth_deviation=data.depth_deviation
        )

    def moved(self, theta: Array, modes: Array) -> Array:
        """Change of force (n, n_modes), N, at the loaded levels by changes of ln force (n_modes, n_knots)."""
        depth = self.data.loaded_depth
        return self.sample(theta, depth).values[:, None] * at_depths(modes, self.knots, depth)


@dataclass(frozen=True, eq=False)
class FittedStep:
    """One step of the identification: free parameters, result and goodness of fit."""

    name: str
    fit: Fit
    free: tuple[int, ...]
    theta: Array
    simulated: Array
    r2: float
    rmse: float
    n_solves: int
    seconds: float


def search_parameters(
    start_f_kappa: float = START_F_KAPPA, start_m: float = M_MOONEY_RIVLIN
) -> tuple[FitParameter, FitParameter]:
    """f_kappa and m with the paper's bounds."""
    return (
        FitParameter("f_kappa", start_f_kappa, *F_KAPPA_BOUNDS),
        FitParameter("m", start_m, *M_BOUNDS, step_factor=M_STEP_FACTOR),
    )


def two_step(
    match: CurveMatch, *, tolerance: float = 1e-3, max_iterations: int = 50, progress: Progress = SILENT,
) -> tuple[FittedStep, FittedStep]:  # fmt: skip
    """Identify (f_kappa, m) from a force-depth curve, with c held fixed.

    Minimises the sum of squared F_exp - F_sim at the measured depths: first over f_kappa from 100 with m = 2
    (Mooney-Rivlin type), then over both from that result (Ogden type), each normalised by its start value.
    The minimum on a surrogate of the solved points is tried first; the end point passes the same tests as
    without.

    Raises FitError with fewer than three loaded levels, or if a step does not converge.
    """
    n_loaded = int(match.data.loaded.sum())
    if n_loaded < 3:
        raise FitError(
            f"{n_loaded} levels are deeper than first touch; a fit needs at least three",
            where="levels.csv, column depth_mm",
            fix="measure more force levels, or mark loading rows `load` in the column phase",
        )
    search: dict[str, Any] = {
        "tolerance": tolerance, "max_iterations": max_iterations, "progress": progress,
    }  # fmt: skip
    start = np.array([START_F_KAPPA, M_MOONEY_RIVLIN])
    first = _step(MOONEY_RIVLIN, (F_KAPPA,), start, match, **search)
    return first, _step(OGDEN, (F_KAPPA, M), first.theta, match, **search)


def _step(name: str, free: tuple[int, ...], start: Array, match: CurveMatch, **search: Any) -> FittedStep:
    """One step; `search` : options of `least_squares_fit`."""
    curve, data = match.curve, match.data
    parameters = [search_parameters(*start)[k] for k in free]
    predict = sampled(curve, match.knots, data.depth, free=free, fixed=start)
    before, clock = curve.n_solves, time.perf_counter()
    guide = _guide(parameters, free, start, match)
    fit = least_squares_fit(force_residual(predict, data.force), parameters, guide=guide, **search)
    theta = start.copy()
    theta[list(free)] = fit.theta
    simulated = data.force - fit.residual
    return FittedStep(
        name, fit, free, theta, simulated,
        coefficient_of_determination(data.force, simulated), root_mean_square(fit.residual),
        curve.n_solves - before, time.perf_counter() - clock,
    )  # fmt: skip


def _guide(
    parameters: Sequence[FitParameter], free: tuple[int, ...], start: Array, match: CurveMatch
) -> Guide:
    """Minimum of the objective on a surrogate of the solved points; within one step, as far off it has
    others."""

    def guess(theta: Array) -> Array:
        predict = sampled(Emulator(match.curve), match.knots, match.data.depth, free=free, fixed=start)
        near = [p.within_step(float(t)).in_logs() for p, t in zip(parameters, theta, strict=True)]
        objective = force_residual(predict, match.data.force)
        return least_squares_fit(objective, near, tolerance=1e-5, must_settle=False).theta

    return guess


def sensitivities(match: CurveMatch, theta: Array) -> Prediction:
    """Force at the loaded levels and its derivative with respect to ln f_kappa and ln m."""
    predict = sampled(match.curve, match.knots, match.data.loaded_depth, free=(F_KAPPA, M), fixed=theta)
    answer = predict(theta)
    return Prediction(answer.values, answer.slopes * theta)
