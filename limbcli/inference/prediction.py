"""Interface between a fit and a simulation: theta -> prediction, with derivatives where available.

This module does not depend on any solver. A model without derivatives is wrapped in `Differences`, which
evaluates the shifted parameter sets in parallel; `SolvedPoints` caches all solved points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from limbcli.errors import SolveError
from limbcli.inference.monotone_interpolation import pchip_sample
from limbcli.model import Array


@dataclass(frozen=True, eq=False)
class Prediction:
    """values (n,), and jacobian (n, n_parameters) by theta, NaN where not requested, or None."""

    values: Array
    jacobian: Array | None = None

    @property
    def slopes(self) -> Array:
        """The jacobian, where there is one."""
        assert self.jacobian is not None
        return self.jacobian

    def has(self, wrt: Sequence[int]) -> bool:
        """Whether the derivatives with respect to these parameters are available."""
        if not wrt:
            return True
        return self.jacobian is not None and bool(np.isfinite(self.jacobian[:, list(wrt)]).all())


class PredictedCurve(Protocol):
    """theta (n_parameters,) -> positive values (n,) at fixed places, such as forces at depth levels.

    wrt : the parameters whose derivative is needed. Raises SolveError where the model cannot be solved.
    """

    def __call__(self, theta: Array, wrt: Sequence[int] = ()) -> Prediction: ...


class Predictor(Protocol):
    """Prediction that an objective compares with data; without `derivative` the jacobian may be None."""

    def __call__(self, theta: Array, *, derivative: bool = True) -> Prediction: ...


Evaluate = Callable[[Array], Array]
ParallelMap = Callable[[Callable[[Array], Any], Iterable[Array]], Iterable[Any]]


class Differences:
    """Adds forward-difference derivatives to a curve that has none.

    upper : (n_parameters,) bounds; where a step would cross one, or the shifted set cannot be solved, it is
        taken downwards
    relative_step : large compared with the solver's tolerance (FEBio's forces are accurate to about 1e-3)
    run_all : a `map` function; a parallel one evaluates the shifted sets at the same time
    """

    def __init__(
        self, evaluate: Evaluate, *, upper: Sequence[float], relative_step: float = 0.05,
        run_all: ParallelMap = map,
    ):  # fmt: skip
        self._evaluate, self._upper = evaluate, upper
        self._step, self._map = relative_step, run_all
        self._last: tuple[Array, Array] | None = None
        self.n_solves = 0

    def __call__(self, theta: Array, wrt: Sequence[int] = ()) -> Prediction:
        theta = np.asarray(theta, dtype=float)
        known = self._last is not None and np.array_equal(self._last[0], theta)
        shifted = [self._shifted(theta, k) for k in wrt]
        needed = [*([] if known else [theta]), *shifted]
        self.n_solves += len(needed)
        answers = list(self._map(self._attempt, needed))
        first = self._last[1] if known and self._last else answers.pop(0)
        if isinstance(first, SolveError):
            raise first
        base: Array = first
        self._last = (theta.copy(), base)
        if not wrt:
            return Prediction(base)
        jacobian = np.full((len(base), len(theta)), np.nan)
        for k, moved, answer in zip(wrt, shifted, answers, strict=True):
            if isinstance(answer, SolveError):
                moved[k] = theta[k] * (1.0 - self._step)
                self.n_solves += 1
                answer = self._evaluate(moved)
            jacobian[:, k] = (answer - base) / (moved[k] - theta[k])
        return Prediction(base, jacobian)

    def _attempt(self, theta: Array) -> Array | SolveError:
        try:
            return self._evaluate(theta)
        except SolveError as error:
            return error

    def _shifted(self, theta: Array, k: int) -> Array:
        moved = theta.copy()
        up = theta[k] * (1.0 + self._step)
        moved[k] = up if up <= self._upper[k] else theta[k] * (1.0 - self._step)
        return moved


class SolvedPoints:
    """Cache of a curve; `solved` holds (theta, prediction) in the order in which they were first solved."""

    def __init__(self, curve: PredictedCurve):
        self._curve = curve
        self._known: dict[bytes, tuple[Array, Prediction]] = {}
        self.n_calls = 0

    def close(self) -> None:
        """Release the resources of the curve; the cached points remain."""
        close = getattr(self._curve, "close", None)
        if close is not None:
            close()

    def __call__(self, theta: Array, wrt: Sequence[int] = ()) -> Prediction:
        theta = np.ascontiguousarray(theta, dtype=float)
        key = theta.tobytes()
        if key in self._known and self._known[key][1].has(wrt):
            return self._known[key][1]
        self.n_calls += 1
        prediction = self._curve(theta, wrt)
        self._known[key] = (theta.copy(), prediction)
        return prediction

    @property
    def n_solves(self) -> int:
        """Number of simulations run: the curve's own count if it has one, else the number of calls."""
        return int(getattr(self._curve, "n_solves", self.n_calls))

    def expect(self, more: int) -> None:
        """Tell a curve that reports progress the largest number of further simulations."""
        if hasattr(self._curve, "at_most"):
            self._curve.at_most = self.n_solves + more

    @property
    def solved(self) -> list[tuple[Array, Prediction]]:
        return list(self._known.values())


def sampled(
    curve: PredictedCurve, knots: Array, depths: Array, *, free: Sequence[int], fixed: Array
) -> Predictor:
    """Force at measured depths as a function of the `free` ones of the curve's parameters; fixed
    (n_parameters,) gives the others. The forces at `knots` and the origin are interpolated by PCHIP; before
    first touch they are 0."""
    places, columns = np.maximum(depths, 0.0), list(free)

    def predict(theta: Array, *, derivative: bool = True) -> Prediction:
        full = fixed.copy()
        full[columns] = theta
        at_knots = curve(full, columns if derivative else ())
        sample = pchip_sample(np.r_[0.0, knots], np.r_[0.0, at_knots.values], places)
        if not derivative or at_knots.jacobian is None:
            return Prediction(sample.values)
        return Prediction(sample.values, sample.weights[:, 1:] @ at_knots.jacobian[:, columns])

    return predict


class Residual(Prediction):
    """Predicted minus measured values, or the reverse."""

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.values @ self.values)


Objective = Callable[[Array, bool], Residual]


def force_residual(predict: Predictor, measured: Array) -> Objective:
    """F_exp - F_sim at the measured depths: the paper's objective, unweighted."""

    def objective(theta: Array, derivative: bool = True) -> Residual:
        prediction = predict(theta, derivative=derivative)
        jacobian = prediction.jacobian
        return Residual(measured - prediction.values, None if jacobian is None else -jacobian)

    return objective


def coefficient_of_determination(measured: Array, simulated: Array) -> float:
    """R2 = 1 - SS_residual / SS_total; NaN where the data do not vary.

    For a monotone curve R2 is near 1 for any monotone model, so it is no evidence of a good fit.

    >>> coefficient_of_determination(np.array([0.0, 2.0, 4.0]), np.array([0.0, 2.0, 4.0]))
    1.0
    >>> coefficient_of_determination(np.array([0.0, 2.0, 4.0]), np.array([0.0, 2.0, 2.0]))
    0.5
    """
    total = float(np.sum((measured - measured.mean()) ** 2))
    return 1.0 - float(np.sum((measured - simulated) ** 2)) / total if total > 0.0 else float("nan")


def root_mean_square(residual: Array) -> float:
    """
    >>> root_mean_square(np.array([0.0, -10.0, 0.0, 0.0]))
    5.0
    """
    return float(np.sqrt(np.mean(residual**2)))
