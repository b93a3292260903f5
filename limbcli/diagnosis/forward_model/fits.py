"""Least-squares fits of explanations to the data of one site, or of several measurements of one place.

c, m and the effects' parameters are fitted on each site's `surrogate`, at given points of the effects' grids.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from limbcli.diagnosis.explanations.forward_model import Explanation, Fitted, Priors
from limbcli.diagnosis.forward_model.predictions import Predictions, Slot
from limbcli.diagnosis.forward_model.surrogate import AtPoints
from limbcli.errors import FitError, SolveError
from limbcli.model import Array
from limbcli.numbers.units import kpa_from_mpa

_QUICK, _FULL = 12, 60  # largest number of evaluations of a quick and of a full fit
_BEHIND, _FAR_BEHIND = 0.5, 10.0  # relative, absolute excess over the lowest cost that drops a start
_FTOL, _XTOL = 1e-6, 1e-5  # tolerances of least squares: a deviance of some hundreds to 0.001
_NO_ANSWER = 1e3  # residual, in standard deviations, of trial parameters without a solution


def _guess(slot: Slot, start: Mapping[str, float]) -> float:
    p = slot.parameter
    if p.shape:
        return start.get(slot.name, p.start)
    return p.null + start.get(slot.name, 0.0) or p.start


class Fits:
    """
    tissue : c (MPa) and m of the fit without effects, once known, from which others start
    """

    def __init__(self, predictions: Predictions):
        self.predictions = predictions
        self.tissue: tuple[float, float] | None = None
        self._ends: dict[tuple[Explanation, str], Array] = {}  # where fits ended: ln c, ln m, parameters

    def best(
        self, model: AtPoints, start: Mapping[str, float], *, thorough: bool = True,
        besides: Sequence[Array] = (),
    ) -> tuple[float, Fitted]:  # fmt: skip
        """The fit from several initial guesses; returns (deviance, fit). Trial parameters without a solution
        have large residuals, so that fits avoid these.

        start : initial sizes as distances from null, and grid values; besides : further initial guesses, as x
        of `predict`

        Raises SolveError or FitError if no initial guess has a solution; if the prediction is not finite.
        """
        predict = self.predictions
        slots, (low, high) = predict.slots(model.explanation), predict.bounds(model.explanation)
        scale = np.array([0.1, 0.3, *(slot.parameter.step for slot in slots)])
        for each in predict.sites:
            each.inherit_parts(model)
        n_far = sum(np.isfinite(each.deviation) for each in predict.priors(model.explanation))
        problems: list[SolveError] = []

        def off(x: Array) -> Array:
            try:
                return self.off(x, model)
            except SolveError as error:
                problems.append(error)
                return np.full(len(predict.data) + n_far, _NO_ANSWER)

        def has_answer(x: Array) -> bool:
            known = len(problems)
            off(np.clip(x, low + 1e-6, high - 1e-6))
            return len(problems) == known

        def descended(x0: Array, n_most: int) -> Any:
            inside = np.clip(x0, low + 1e-6, high - 1e-6)
            return least_squares(
                off, inside, bounds=(low, high), x_scale=scale, diff_step=1e-4, ftol=_FTOL, xtol=_XTOL,
                max_nfev=n_most,
            )  # fmt: skip

        guesses = [*besides, *self._ends_of_parts(model), *self._starts(model, start)]
        seeds = [x for x in guesses if has_answer(x)]
        if not seeds:
            raise problems[0]
        best = _deepest(descended, seeds) if thorough else descended(seeds[0], _QUICK)
        if not np.isfinite(best.cost):
            raise FitError("the prediction is not a number", where="diagnose", fix="look at levels.csv")
        if thorough:
            self._ends[model.key] = best.x
        return 2 * float(best.cost), self.fitted(best.x, model)

    def off(self, x: Array, model: AtPoints) -> Array:
        """Residuals that a fit minimises: whitened residuals, and those of the normal priors."""
        predict = self.predictions
        far = [
            (value - each.mean) / each.deviation
            for value, each in zip(x, predict.priors(model.explanation), strict=True)
            if np.isfinite(each.deviation)
        ]
        return np.concatenate([predict.whiten(predict.data.y - predict.predict(x, model)), far])

    def fitted(self, x: Array, model: AtPoints) -> Fitted:
        """The fit at these parameters: ln c, ln m, and the effects'."""
        predict, (explanation, label) = self.predictions, model.key
        slots, sizes = predict.slots(explanation), predict.named(x, explanation)
        values = {"c_kpa": float(kpa_from_mpa(float(np.exp(x[0])))), "m": float(np.exp(x[1])), **sizes}
        values |= {k: float(v) for point in model.points for k, v in point.items()}
        return Fitted(
            explanation, predict.predict(x, model), predict.jacobian(x, model), base_names=("c", "m"),
            values=values, effect_names=tuple(sizes),
            at_bound={each.name: words for each in slots if (words := each.on_bound(sizes[each.name]))},
            point=label, without=self._without_approximate(x, model),
            priors=Priors.about(x, predict.priors(explanation)),
            amplification=predict.amplification(x, model),
        )  # fmt: skip

    def _without_approximate(self, x: Array, model: AtPoints) -> Array | None:
        """Prediction without the effects of the tissue and those that are simulated, whose form is never
        exactly that of a limb; None without such effects. An instrument's zero or scale has no other form."""
        predict = self.predictions
        effects = [predict.effects[name] for name in model.explanation]
        kept = model.only(k for k, each in enumerate(effects) if each.kind != "tissue" and not each.solves)
        if len(kept.explanation) == len(effects):
            return None
        known = predict.named(x, model.explanation)
        sizes = [known[slot.name] for slot in predict.slots(kept.explanation)]
        return predict.predict(np.array([*x[:2], *sizes]), kept)

    def _starts(self, model: AtPoints, start: Mapping[str, float]) -> list[Array]:
        """Usual initial guesses; none if these were tried before."""
        if model.key in self._ends and not start:
            return []
        slots, tissues = self.predictions.slots(model.explanation), self._tissues()
        guesses = [[_guess(s, start) for s in slots]]
        if not any(s.parameter.shape and s.name in start for s in slots):
            guesses.append([s.parameter.start for s in slots])
        pairs = list(zip(guesses, tissues, strict=False)) if slots else [([], each) for each in tissues]
        return [np.array([np.log(c), np.log(m), *guess]) for guess, (c, m) in pairs]

    def _ends_of_parts(self, model: AtPoints) -> list[Array]:
        """Initial guesses from earlier fits: of this model, and of those with one effect less.

        The fit must be at least as good as the latter; the missing effect starts at a tenth of the way from
        its null value to its start value.
        """
        found = [self._ends[model.key]] if model.key in self._ends else []
        for k in range(len(model.explanation)):
            rest = model.without(k)
            if (end := self._ends.get(rest.key)) is None:
                continue
            known = self.predictions.named(end, rest.explanation)
            slots = self.predictions.slots(model.explanation)
            sizes = [known.get(s.name, 0.9 * s.parameter.null + 0.1 * s.parameter.start) for s in slots]
            found.append(np.array([*end[:2], *sizes]))
        return found

    def _tissues(self) -> list[tuple[float, float]]:
        """Initial guesses of (c, m): the result of the fit without effects, and a usual tissue."""
        c = self.predictions.sites[0].simulations.c
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
