"""Least-squares fits of explanations to the data of one site, or of several measurements of one place.

c, m and the effects' parameters are fitted on each site's `surrogate`, at given points of the effects' grids.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from limbcli.diagnostics.model.forward_model import Explanation, Fitted
from limbcli.diagnostics.model.priors import Priors
from limbcli.effects.base import Theta
from limbcli.errors import FitError, SolveError
from limbcli.model import Array
from limbcli.stages.diagnosis.forward_model.predictions import Predictions, Slot
from limbcli.stages.diagnosis.forward_model.surrogate import label
from limbcli.units import kpa_from_mpa

_QUICK, _FULL = 12, 60  # largest number of evaluations of a quick and of a full fit
_BEHIND, _FAR_BEHIND = 0.5, 10.0  # relative, absolute excess over the lowest cost that drops a start
_FTOL, _XTOL = 1e-6, 1e-5  # tolerances of least squares: a deviance of some hundreds to 0.001
_NO_ANSWER = 1e3  # residual, in standard deviations, of trial parameters without a solution


def _guess(slot: Slot, start: Mapping[str, float]) -> float:
    p = slot.parameter
    if p.shape:
        return start.get(slot.name, p.start)
    return p.null + start.get(slot.name, 0.0) or p.start


class _Trials:
    """Residuals (n,) of a fit's trial parameters; large where there is no solution, so that fits avoid
    these."""

    def __init__(self, off: Callable[[Array], Array], n: int):
        self.off, self.n = off, n
        self.problems: list[SolveError] = []

    def __call__(self, x: Array) -> Array:
        try:
            return self.off(x)
        except SolveError as error:
            self.problems.append(error)
            return np.full(self.n, _NO_ANSWER)

    def has_answer(self, x: Array) -> bool:
        known = len(self.problems)
        self(x)
        return len(self.problems) == known


class Fits:
    """Fits by predictions.

    tissue : c (MPa) and m of the fit without effects, once known, from which others start
    """

    def __init__(self, predictions: Predictions):
        self.predictions = predictions
        self.tissue: tuple[float, float] | None = None
        self._ends: dict[tuple[Explanation, str], Array] = {}  # where fits ended: ln c, ln m, parameters

    def best(
        self, explanation: Explanation, points: Sequence[Theta], start: Mapping[str, float], *,
        thorough: bool = True, besides: Sequence[Array] = (),
    ) -> tuple[float, Fitted]:  # fmt: skip
        """The fit from several initial guesses; returns (deviance, fit).

        start : initial sizes as distances from null, and grid values; besides : further initial guesses, as x
        of `predict`

        Raises
        ------
        SolveError
            If no initial guess has a solution.
        FitError
            If the prediction is not finite.
        """
        predict = self.predictions
        slots, (low, high) = predict.slots(explanation), predict.bounds(explanation)
        scale = np.array([0.1, 0.3, *(slot.parameter.step for slot in slots)])
        for each in predict.sites:
            each.inherit_parts(explanation, points)
        n_far = sum(np.isfinite(each.deviation) for each in predict.priors(explanation))
        off = _Trials(lambda x: self.off(x, explanation, points), len(predict.data) + n_far)

        def descended(x0: Array, n_most: int) -> Any:
            inside = np.clip(x0, low + 1e-6, high - 1e-6)
            return least_squares(
                off, inside, bounds=(low, high), x_scale=scale, diff_step=1e-4, ftol=_FTOL, xtol=_XTOL,
                max_nfev=n_most,
            )  # fmt: skip

        known = self._ends_of_parts(explanation, points)
        guesses = [*besides, *known, *self._starts(explanation, points, start)]
        seeds = [x for x in guesses if off.has_answer(np.clip(x, low + 1e-6, high - 1e-6))]
        if not seeds:
            raise off.problems[0]
        best = _deepest(descended, seeds) if thorough else descended(seeds[0], _QUICK)
        if not np.isfinite(best.cost):
            raise FitError("the prediction is not a number", where="diagnose", fix="look at levels.csv")
        if thorough:
            self._ends[explanation, label(points)] = best.x
        return 2 * float(best.cost), self.fitted(best.x, explanation, points)

    def off(self, x: Array, explanation: Explanation, points: Sequence[Theta]) -> Array:
        """Residuals that a fit minimises: whitened residuals, and those of the normal priors."""
        predict = self.predictions
        far = [
            (value - each.mean) / each.deviation
            for value, each in zip(x, predict.priors(explanation), strict=True) if np.isfinite(each.deviation)
        ]  # fmt: skip
        return np.concatenate([predict.whiten(predict.data.y - predict.predict(x, explanation, points)), far])

    def fitted(self, x: Array, explanation: Explanation, points: Sequence[Theta]) -> Fitted:
        """The fit at these parameters: ln c, ln m, and the effects'."""
        predict = self.predictions
        slots, sizes = predict.slots(explanation), x[2:].tolist()
        values = {"c_kpa": float(kpa_from_mpa(float(np.exp(x[0])))), "m": float(np.exp(x[1]))}
        values |= {slot.name: size for slot, size in zip(slots, sizes, strict=True)}
        values |= {k: float(v) for point in points for k, v in point.items()}
        return Fitted(
            explanation, predict.predict(x, explanation, points), predict.jacobian(x, explanation, points),
            ("c", "m"), values, tuple(s.name for s in slots),
            at_bound=tuple(m for s, v in zip(slots, sizes, strict=True) if (m := s.on_bound(v))),
            points={"grid": label(points)}, without=self._without_approximate(x, explanation, points),
            priors=Priors.about(x, predict.priors(explanation)),
        )  # fmt: skip

    def _without_approximate(
        self, x: Array, explanation: Explanation, points: Sequence[Theta]
    ) -> Array | None:
        """Prediction without the effects of the tissue and those that are simulated, whose form is never
        exactly that of a limb; None without such effects. An instrument's zero or scale has no other form."""
        predict = self.predictions
        effects = [predict.effects[name] for name in explanation]
        kept = [k for k, each in enumerate(effects) if each.kind != "tissue" and not each.solves]
        if len(kept) == len(explanation):
            return None
        names = tuple(explanation[k] for k in kept)
        known = dict(zip([s.name for s in predict.slots(explanation)], x[2:].tolist(), strict=True))
        sizes = [known[s.name] for s in predict.slots(names)]
        return predict.predict(np.array([*x[:2], *sizes]), names, [points[k] for k in kept])

    def _starts(
        self, explanation: Explanation, points: Sequence[Theta], start: Mapping[str, float]
    ) -> list[Array]:
        """Usual initial guesses; none if these were tried before."""
        if (explanation, label(points)) in self._ends and not start:
            return []
        slots, tissues = self.predictions.slots(explanation), self._tissues()
        guesses = [[_guess(s, start) for s in slots]]
        if not any(s.parameter.shape and s.name in start for s in slots):
            guesses.append([s.parameter.start for s in slots])
        pairs = list(zip(guesses, tissues, strict=False)) if slots else [([], each) for each in tissues]
        return [np.array([np.log(c), np.log(m), *guess]) for guess, (c, m) in pairs]

    def _ends_of_parts(self, explanation: Explanation, points: Sequence[Theta]) -> list[Array]:
        """Initial guesses from earlier fits: of this explanation, and of those with one effect less.

        The fit must be at least as good as the latter; the missing effect starts at a tenth of the way from
        its null value to its start value.
        """
        own = self._ends.get((explanation, label(points)))
        found = [] if own is None else [own]
        for k in range(len(explanation)):
            rest = explanation[:k] + explanation[k + 1 :]
            end = self._ends.get((rest, label([*points[:k], *points[k + 1 :]])))
            if end is None:
                continue
            known = dict(zip([s.name for s in self.predictions.slots(rest)], end[2:], strict=True))
            sizes = [
                known.get(s.name, 0.9 * s.parameter.null + 0.1 * s.parameter.start)
                for s in self.predictions.slots(explanation)
            ]
            found.append(np.array([*end[:2], *sizes]))
        return found

    def _tissues(self) -> list[tuple[float, float]]:
        """Initial guesses of (c, m): the result of the fit without effects, and a usual tissue."""
        c = self.predictions.simulations.c
        usual = [(c, 2.0), (c, 6.0)]
        if self.tissue is None:
            return usual
        m = self.tissue[1]
        return [self.tissue, max(usual, key=lambda each: abs(np.log(each[1] / m)))]


def _deepest(descended: Callable[[Array, int], Any], starts: Sequence[Array]) -> Any:
    """Best of the fits from several initial guesses; starts far above the lowest cost are not continued."""
    tries = [descended(x0, _QUICK if len(starts) > 1 else _FULL) for x0 in starts]
    least = min(each.cost for each in tries)
    going_on = [
        each for each in tries
        if each.status == 0 and each.cost < (1.0 + _BEHIND) * least + _FAR_BEHIND
    ]  # fmt: skip
    return min([*tries, *(descended(each.x, _FULL) for each in going_on)], key=lambda each: each.cost)
