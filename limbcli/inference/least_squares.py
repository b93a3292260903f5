"""Bounded least squares: scipy's dogleg method in boxes, which a surrogate's minima may precede."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from limbcli.errors import FitError, SolveError
from limbcli.inference.parameter import FitParameter, natural, normalised, slopes
from limbcli.inference.prediction import Objective, Residual
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

Guide = Callable[[Array], Array]
_TRIALS = 40  # largest number of trial steps for one iteration
_GTOL = 1e-14  # of the gradient's largest component: there is no descent direction
_SHARES = (1.0, 0.3, 0.1)  # of a Gauss-Newton step that are tried
_SLACK = 1.0 + 1e-9  # on the largest factor of a parameter in one step
_REASONS = {
    1: "no direction leads down", 2: "the cost settled", 3: "the step was within tolerance",
    4: "the cost settled, and the step was within tolerance",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of the search.

    theta : (n_parameters,)
    residual, jacobian : (n,) and (n, n_parameters) d residual / d theta at theta
    cost : sum of squares
    reason : the termination test that was met; history : theta and cost of every accepted iterate
    """

    parameters: tuple[FitParameter, ...]
    theta: Array
    residual: Array
    jacobian: Array
    cost: float
    n_iterations: int
    reason: str
    history: tuple[tuple[Array, float], ...] = ()


def least_squares_fit(
    objective: Objective, parameters: Sequence[FitParameter], *, tolerance: float = 1e-3,
    max_iterations: int = 50, must_settle: bool = True, guide: Guide | None = None,
    progress: Progress = SILENT,
) -> Fit:  # fmt: skip
    """Bounded least squares in the normalised parameters.

    A trial at which the model cannot be solved (SolveError) counts as worse, and so does, without a solve,
    one that changes a parameter by more than its step factor. The search ends when a step lowers the cost by
    at most `tolerance` relative to it, or is within `tolerance` relative to the parameters, or nothing leads
    down.

    guide : theta -> a better guess from what is known of the model so far, at no cost, tried first while the
        cost decreases. Then no step may lower the linearised cost by more than `tolerance`.

    Raises SolveError if the model cannot be solved at the start values; FitError if the residual is not
    finite there, or the search has not converged after `max_iterations` and `must_settle` is set.

    Source: Voglis and Lagaris 2004, A rectangular trust region dogleg approach (`scipy.optimize`, "dogbox").
    """
    search = _Search(objective, tuple(parameters), progress, max_iterations)
    try:
        reason = search.guided(guide, tolerance) if guide is not None else ""
        while not reason:
            reason = search.descended(tolerance)
    except _UsedUp:
        if must_settle:
            raise FitError(
                f"the fit did not converge in {max_iterations} iterations (cost {search.now.cost:.4g})",
                where=", ".join(f"{p.name} {t:.4g}" for p, t in zip(parameters, search.theta, strict=True)),
                fix="check the measurement (force-depth.png of `limbcli run`); raise --max-iterations if the "
                "cost was still falling",
                cost=search.now.cost,
            ) from None
        reason = "iterations used up"
    return search.finish(reason)


class _UsedUp(Exception):
    """All iterations are made."""


class _Search:
    """Current point with its linearisation, and how it was reached."""

    def __init__(
        self, objective: Objective, parameters: tuple[FitParameter, ...], progress: Progress, most: int
    ):
        self.objective, self.parameters, self.progress, self.most = objective, parameters, progress, most
        self.low = np.array([p.low for p in parameters])
        self.high = np.array([p.high for p in parameters])
        self.factor = np.array([p.step_factor for p in parameters])
        self.box = tuple(normalised(parameters, each) for each in (self.low, self.high))
        self.history: list[tuple[Array, float]] = []
        self.trial: tuple[Array, Residual] | None = None
        start = np.array([p.start for p in parameters])
        first = objective(start, True)
        if not np.isfinite(first.cost):
            raise FitError(
                "the prediction at the start values is not a number",
                where=", ".join(f"{p.name} {p.start:g}" for p in parameters),
                fix="check levels.csv and the model's run at these values: limbcli run",
            )
        self.accept(start, first)

    def accept(self, theta: Array, residual: Residual) -> None:
        if len(self.history) > self.most:
            raise _UsedUp
        self.theta = theta
        self.now = residual if residual.jacobian is not None else self.objective(theta, True)
        self.history.append((theta.copy(), residual.cost))
        self.progress.event(
            "fit", iteration=len(self.history), cost=residual.cost,
            parameters={p.name: float(t) for p, t in zip(self.parameters, theta, strict=True)},
        )  # fmt: skip

    def guided(self, guide: Guide, tolerance: float) -> str:
        """Accept guesses, else Gauss-Newton steps, while they lower the cost; why it ended, "" if they do
        not."""
        while True:
            step, fall = self._linear()
            if self._is_small(step, tolerance) and fall <= tolerance**2 * self.now.cost:
                return "the next step is within tolerance"
            if len(self.history) > 1 and fall <= tolerance * self.now.cost:
                return "the next step would not lower the cost by more than the tolerance"
            shorter = (self.theta + share * (step - self.theta) for share in _SHARES)
            for wished in (guide(self.theta), *shorter):
                theta = np.clip(wished, *self._reach())
                trial = None if np.array_equal(theta, self.theta) else self._try(theta)
                if trial is not None and trial.cost < self.now.cost:
                    break
            else:
                return ""
            small = self._is_small(theta, tolerance)
            self.accept(theta, trial)
            if small:
                return "the step was within tolerance"

    def _linear(self) -> tuple[Array, float]:
        """Theta of the least linearised cost within the bounds, and the decrease of the cost there."""
        x = normalised(self.parameters, self.theta)
        low, high = (end - x for end in self.box)
        step = optimize.lsq_linear(self._jacobian(), -self.now.values, (low, high), method="bvls").x
        left = self.now.values + self._jacobian() @ step
        return natural(self.parameters, x + step), self.now.cost - float(left @ left)

    def _is_small(self, theta: Array, tolerance: float) -> bool:
        return bool(np.all(np.abs(theta - self.theta) <= tolerance * self.theta))

    def descended(self, tolerance: float) -> str:
        """Search by scipy's method from the current point; the termination reason, or "" where it ended on
        a small region of trust although a longer step promises more."""

        def residual(x: Array) -> Array:
            theta = natural(self.parameters, x)
            if np.array_equal(theta, self.theta):
                return self.now.values
            low, high = self._reach()
            allowed = np.all(theta >= low / _SLACK) and np.all(theta <= high * _SLACK)
            found = self._try(theta) if allowed else None
            self.trial = None if found is None else (theta, found)
            return np.full(len(self.now.values), np.nan) if found is None else found.values

        def jacobian(x: Array) -> Array:
            theta = natural(self.parameters, x)
            if self.trial is not None and np.allclose(theta, self.trial[0], rtol=1e-9, atol=0.0):
                self.accept(*self.trial)
                self.trial = None
            return self._jacobian()

        start = np.clip(normalised(self.parameters, self.theta), *self.box)
        before = len(self.history)
        found = optimize.least_squares(
            residual, start, jacobian, self.box, "dogbox", ftol=tolerance, xtol=tolerance, gtol=_GTOL,
            max_nfev=_TRIALS * self.most,
        )  # fmt: skip
        if len(self.history) > before and self._linear()[1] > tolerance * self.now.cost:
            return ""
        return _REASONS.get(int(found.status), "no step lowers the cost")

    def finish(self, reason: str) -> Fit:
        return Fit(
            self.parameters, self.theta, self.now.values, self.now.slopes, self.now.cost,
            len(self.history), reason, tuple(self.history),
        )  # fmt: skip

    def _jacobian(self) -> Array:
        return self.now.slopes * slopes(self.parameters, self.theta)

    def _reach(self) -> tuple[Array, Array]:
        """The values that one step may reach."""
        low, high = self.theta / self.factor, self.theta * self.factor
        return np.maximum(low, self.low), np.minimum(high, self.high)

    def _try(self, theta: Array) -> Residual | None:
        try:
            trial = self.objective(theta, False)
        except SolveError as error:
            self.progress.event("note", text=f"no solution at a trial point, stepping back: {error.what}")
            return None
        return trial if np.isfinite(trial.cost) else None
