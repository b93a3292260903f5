"""What a fit asks of a simulation: theta -> prediction, with a derivative where there is one.

Nothing here knows a solver. A model that cannot differentiate itself is wrapped in
`Differences`, which evaluates the shifted parameter sets side by side; `SolvedPoints` keeps
everything that was ever solved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from limbcli.errors import SolveError
from limbcli.inference.interpolation import pchip_sample
from limbcli.model import Array


@dataclass(frozen=True, eq=False)
class Prediction:
    """values (n,), and jacobian (n, n_parameters) d value / d theta, or None.

    A column of NaN is a derivative that was not asked for.
    """

    values: Array
    jacobian: Array | None = None

    def has(self, wrt: Sequence[int]) -> bool:
        """Whether the derivatives with respect to these parameters are there."""
        if not wrt:
            return True
        return self.jacobian is not None and bool(np.isfinite(self.jacobian[:, list(wrt)]).all())


class PredictedCurve(Protocol):
    """theta (n_parameters,) -> positive values (n,) at fixed places, say forces at depth levels.

    `wrt`: the parameters whose derivative is needed. Raises SolveError where there is no answer.
    """

    def __call__(self, theta: Array, wrt: Sequence[int] = ()) -> Prediction: ...


class Predictor(Protocol):
    """What an objective compares with data; without `derivative` the jacobian may be left out."""

    def __call__(self, theta: Array, *, derivative: bool = True) -> Prediction: ...


Evaluate = Callable[[Array], Array]
ParallelMap = Callable[[Callable[[Array], Any], Iterable[Array]], Iterable[Any]]


class Differences:
    """A curve without derivatives, made differentiable by forward differences.

    Parameters
    ----------
    evaluate : theta -> values (n,)
    upper : (n_parameters,) bounds; near one, or where there is no answer, the step goes down
    relative_step : of each parameter. It must drown the solver's own tolerance: FEBio's
        forces are good to about 1e-3, so the step is large and the derivative a secant.
    run_all : a `map`; one that works in parallel runs the shifted sets side by side.
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
    """A curve that never solves the same parameters twice, and remembers all of them.

    `solved` holds (theta, prediction) in the order first solved.
    """

    def __init__(self, curve: PredictedCurve):
        self._curve = curve
        self._known: dict[bytes, tuple[Array, Prediction]] = {}
        self.n_calls = 0

    def close(self) -> None:
        """End what the curve holds open; what is known stays."""
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
        """Simulations run: calls, or what the curve itself counts."""
        return int(getattr(self._curve, "n_solves", self.n_calls))

    def expect(self, more: int) -> None:
        """Tell a curve that announces its simulations how many more there are at most."""
        if hasattr(self._curve, "at_most"):
            self._curve.at_most = self.n_solves + more

    @property
    def solved(self) -> list[tuple[Array, Prediction]]:
        return list(self._known.values())


def sampled(
    curve: PredictedCurve, knots: Array, depths: Array, *, free: Sequence[int], fixed: Array
) -> Predictor:
    """Force at measured depths, as a function of some of the curve's parameters.

    The curve's forces at `knots` (increasing, > 0), with the origin added, are read at
    `depths` by PCHIP; before first touch (depth < 0) the force is 0.

    free : indices of the parameters that theta holds; `fixed` (n_parameters,) gives the others.
    """
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


def slopes_at(curve: PredictedCurve, knots: Array, depths: Array, theta: Array) -> Array:
    """dF/dd of the sampled curve at the measured depths (n,), N/mm."""
    values = curve(theta).values
    return pchip_sample(np.r_[0.0, knots], np.r_[0.0, values], np.maximum(depths, 0.0)).slopes
