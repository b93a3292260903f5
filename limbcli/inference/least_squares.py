"""Levenberg-Marquardt least squares with bounds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import FitError, SolveError
from limbcli.inference.parameter import FitParameter, natural, normalised, slopes
from limbcli.inference.residual import Objective, Residual
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

Mask = NDArray[np.bool_]
Guide = Callable[[Array], Array]
_MOST_TRIALS = 40  # trial steps in one iteration
_LEAST_GAIN = 1e-4  # actual over predicted decrease of the cost above which a step is accepted
_SMALLEST_DAMPING = 1e-14
_LARGEST_DAMPING = 1e14
_TOUCHING = 1.0 + 1e-12  # factor within which a parameter counts as on its bound


@dataclass(frozen=True, eq=False)
class Iterate:
    """One accepted iterate of the search."""

    theta: Array
    cost: float


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of the search.

    theta : (n_parameters,)
    residual, jacobian : (n,) and (n, n_parameters) d residual / d theta at theta
    cost : sum of squares
    reason : the termination test that was met
    """

    parameters: tuple[FitParameter, ...]
    theta: Array
    residual: Array
    jacobian: Array
    cost: float
    n_iterations: int
    reason: str
    history: tuple[Iterate, ...] = field(default=())

    def value(self, name: str) -> float:
        return float(self.theta[[p.name for p in self.parameters].index(name)])


def least_squares_fit(
    objective: Objective,
    parameters: Sequence[FitParameter],
    *,
    tolerance: float = 1e-3,
    max_iterations: int = 50,
    must_settle: bool = True,
    guide: Guide | None = None,
    progress: Progress = SILENT,
) -> Fit:
    """Bounded least squares.

    Damped Gauss-Newton steps in the normalised parameters; the damping is chosen to meet a trust radius in
    More's scaling. A parameter that is on a bound and would be pushed beyond it is held there for that step;
    a step that crosses a bound is clipped at it and solved again for the remaining parameters. A trial at
    which the model cannot be solved (SolveError) counts as worse.

    guide : theta -> a better guess from what is known of the model so far (at no cost). It is tried before
        the step and accepted only if the cost decreases there. Convergence is decided by the same tests with
        the model's own derivatives.

    The search ends when the actual and the predicted relative decrease of the cost are both at most
    `tolerance`, or no parameter changes by more than `tolerance` relative to itself, or there is no descent
    direction.

    Raises
    ------
    SolveError
        If the model cannot be solved at the start values.
    FitError
        If the residual is not finite there, or the search has not converged after `max_iterations` and
        `must_settle` is set.

    Source: Marquardt 1963; More 1978, The Levenberg-Marquardt algorithm, Lect. Notes Math. 630:105.
    """
    search = _Search(objective, tuple(parameters), progress, guide)
    for iteration in range(1, max_iterations + 1):
        reason = search.iterate(tolerance)
        progress.event(
            "fit", iteration=iteration, cost=search.now.cost,
            parameters={p.name: float(t) for p, t in zip(parameters, search.theta, strict=True)},
        )  # fmt: skip
        if reason:
            return search.finish(iteration, reason)
    if not must_settle:
        return search.finish(max_iterations, "iterations used up")
    raise FitError(
        f"the fit did not converge in {max_iterations} iterations (cost {search.now.cost:.4g})",
        where=", ".join(f"{p.name} {t:.4g}" for p, t in zip(parameters, search.theta, strict=True)),
        fix="check the measurement (force-depth.png of `limbcli run`); raise --max-iterations if the cost "
        "was still falling",
        cost=search.now.cost,
    )


class _Search:
    """State of a search: current point, its linearisation, trust radius and scaling."""

    def __init__(
        self,
        objective: Objective,
        parameters: tuple[FitParameter, ...],
        progress: Progress,
        guide: Guide | None,
    ):
        self.objective, self.parameters, self.progress = objective, parameters, progress
        self.guide = guide
        self.low = np.array([p.low for p in parameters])
        self.high = np.array([p.high for p in parameters])
        self.step_factor = np.array([p.step_factor for p in parameters])
        self.theta = np.array([p.start for p in parameters])
        self.now = self._linearised(objective(self.theta, True))
        if not np.isfinite(self.now.cost):
            raise FitError(
                "the prediction at the start values is not a number",
                where=", ".join(f"{p.name} {p.start:g}" for p in parameters),
                fix="check levels.csv and the model's run at these values: limbcli run",
            )
        self.scale = np.zeros(len(parameters))
        self.radius = np.inf
        self.history = [Iterate(self.theta.copy(), self.now.cost)]

    def iterate(self, tolerance: float) -> str:
        """Make one accepted step; returns the termination reason, or "" if the search goes on."""
        line = self._line()
        self.scale = np.maximum(self.scale, np.sqrt(np.diag(line.curvature)))
        if self.now.cost == 0.0 or not line.free.any():
            return "no direction leads down"
        if not np.isfinite(self.radius):
            self.radius = max(float(np.linalg.norm(self.scale)), 1e-300)
        for trials in range(_MOST_TRIALS):
            step = self._step(line)
            theta = natural(self.parameters, line.x + step)
            predicted = line.fall(step)
            small = bool(np.all(np.abs(theta - self.theta) <= tolerance * self.theta))
            if predicted <= 0.0 or (small and predicted <= tolerance**2 * self.now.cost):
                return "the next step is within tolerance"
            if self.guide is not None and trials == 0:
                if len(self.history) > 1 and predicted <= tolerance * self.now.cost:
                    return "the next step would not lower the cost by more than the tolerance"
                if self._guided(line):
                    return ""
            trial = self._try(theta)
            actual = self.now.cost - trial.cost if trial is not None else -np.inf
            cost = self.now.cost
            self._resize(step, line, actual / predicted, actual)
            if trial is not None and actual > _LEAST_GAIN * predicted:
                self._accept(theta, trial)
                if small:
                    return "the step was within tolerance"
                return "the cost settled" if max(actual, predicted) <= tolerance * cost else ""
            if small:
                return "the next step is within tolerance"
        return "no step lowers the cost"

    def finish(self, n_iterations: int, reason: str) -> Fit:
        assert self.now.jacobian is not None
        return Fit(
            self.parameters, self.theta, self.now.values, self.now.jacobian, self.now.cost,
            n_iterations, reason, tuple(self.history),
        )  # fmt: skip

    def _line(self) -> _Line:
        """The linear model at the current point, in normalised coordinates."""
        assert self.now.jacobian is not None
        jacobian = self.now.jacobian * slopes(self.parameters, self.theta)
        gradient = jacobian.T @ self.now.values
        held_low = (self.theta <= self.low * _TOUCHING) & (gradient > 0)
        held_high = (self.theta * _TOUCHING >= self.high) & (gradient < 0)
        free = ~(held_low | held_high) & (gradient != 0.0)
        x = normalised(self.parameters, self.theta)
        least = normalised(self.parameters, np.maximum(self.theta / self.step_factor, self.low))
        most = normalised(self.parameters, np.minimum(self.theta * self.step_factor, self.high))
        return _Line(x, gradient, jacobian.T @ jacobian, free, least - x, most - x)

    def _step(self, line: _Line) -> Array:
        """The step within the trust radius; its damping is found by bisection."""
        scale = np.maximum(self.scale, 1e-8 * float(self.scale.max()))
        step = line.step(_SMALLEST_DAMPING, scale)
        if np.linalg.norm(scale * step) <= 1.1 * self.radius:
            return step
        low, high = np.log(_SMALLEST_DAMPING), np.log(_LARGEST_DAMPING)
        while high - low > 0.05:
            middle = 0.5 * (low + high)
            step = line.step(float(np.exp(middle)), scale)
            if np.linalg.norm(scale * step) > self.radius:
                low = middle
            else:
                high = middle
        return line.step(float(np.exp(high)), scale)

    def _guided(self, line: _Line) -> bool:
        """Try the guide's guess, clipped to the allowed step; returns whether it lowered the cost and was
        accepted."""
        assert self.guide is not None
        wished = normalised(self.parameters, np.clip(self.guide(self.theta), self.low, self.high))
        theta = natural(self.parameters, line.x + np.clip(wished - line.x, line.low, line.high))
        if np.array_equal(theta, self.theta):
            return False
        trial = self._try(theta)
        if trial is None or not trial.cost < self.now.cost:
            return False
        self._accept(theta, trial)
        return True

    def _resize(self, step: Array, line: _Line, gain: float, actual: float) -> None:
        """Update the trust radius by More's rule: shrink it along the parabola through the trial, enlarge it
        after a good step."""
        size = float(np.linalg.norm(self.scale * step))
        if gain <= 0.25:
            slope = float(2 * line.gradient @ step)
            shrink = 0.5 * slope / (slope + actual) if np.isfinite(actual) and actual < 0 else 0.25
            self.radius = min(max(shrink, 0.1), 0.5) * min(self.radius, size)
        elif gain >= 0.75 or size < 0.5 * self.radius:
            self.radius = max(self.radius, 2.0 * size)

    def _try(self, theta: Array) -> Residual | None:
        try:
            trial = self.objective(theta, False)
        except SolveError as error:
            self.progress.event("note", text=f"no solution at a trial point, stepping back: {error.what}")
            return None
        return trial if np.isfinite(trial.cost) else None

    def _accept(self, theta: Array, trial: Residual) -> None:
        self.theta = theta
        self.now = self._linearised(trial)
        self.history.append(Iterate(theta.copy(), trial.cost))

    def _linearised(self, residual: Residual) -> Residual:
        return residual if residual.jacobian is not None else self.objective(self.theta, True)


@dataclass(frozen=True, eq=False)
class _Line:
    """Linear model r + J s at a point x: gradient J'r, curvature J'J, the free parameters, and the limits of
    the step."""

    x: Array
    gradient: Array
    curvature: Array
    free: Mask
    low: Array
    high: Array

    def step(self, damping: float, scale: Array) -> Array:
        """Damped step; bounds that it would cross are met exactly, and the remaining parameters are solved
        again."""
        step, free = np.zeros(len(self.x)), self.free.copy()
        for _ in range(len(self.x)):
            damped = self.curvature[np.ix_(free, free)] + damping * np.diag(scale[free] ** 2)
            right = -self.gradient[free] - self.curvature[np.ix_(free, ~free)] @ step[~free]
            step[free] = np.linalg.lstsq(damped, right, rcond=None)[0]
            limit = np.where(step < 0.0, self.low, self.high)
            beyond = np.where(free, np.abs(step) - np.abs(limit), 0.0)
            if not (beyond > 0.0).any():
                break
            # one at a time, the first that is met: nearly collinear parameters cross together, and the corner
            # where all are held may lie higher
            with np.errstate(divide="ignore", invalid="ignore"):
                first = int(np.argmax(np.where(beyond > 0.0, np.abs(step) / np.abs(limit), 0.0)))
            step[first], free[first] = limit[first], False
            if not free.any():
                break
        return step

    def fall(self, step: Array) -> float:
        """Decrease of the cost predicted by the linear model."""
        return -float(2 * self.gradient @ step + step @ self.curvature @ step)
