"""Fits of explanations to the data of one site, or of several measurements of one place.

Least-squares fits of c, m and the effects' parameters on each site's `surrogate`, at given points of the
effects' grids.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.estimates import Conditional
from limbcli.diagnostics.model.forward_model import Explanation, Fitted
from limbcli.diagnostics.model.linear import LinearFit, Whitener
from limbcli.effects.base import Theta
from limbcli.errors import FitError, SolveError
from limbcli.model import Array
from limbcli.stages.diagnosis.forward_model.fit_parameters import Slot, bound_hits, stuck
from limbcli.stages.diagnosis.forward_model.predictions import Predictions
from limbcli.stages.diagnosis.forward_model.surrogate import SiteCurves, label
from limbcli.units import kpa_from_mpa

_QUICK, _FULL = 12, 60  # largest number of evaluations of a quick and of a full fit
_BEHIND, _FAR_BEHIND = 0.5, 10.0  # relative, absolute excess over the lowest cost that drops a start
_FTOL, _XTOL = 1e-6, 1e-5  # tolerances of least squares: a deviance of some hundreds to 0.001
_ROOMY = 1.5  # std. deviation of the weak prior on sizes, in typical sizes: keeps flat fits off the bounds
_NO_ANSWER = 1e3  # residual, in standard deviations, of trial parameters without a solution
_NONE: Mapping[str, float] = {}


def _deepest(descended: Callable[[Array, int], Any], starts: Sequence[Array]) -> Any:
    """Best of the fits from several initial guesses; starts far above the lowest cost are not continued."""
    tries = [descended(x0, _QUICK if len(starts) > 1 else _FULL) for x0 in starts]
    least = min(each.cost for each in tries)
    going_on = [
        each for each in tries
        if each.status == 0 and each.cost < (1.0 + _BEHIND) * least + _FAR_BEHIND
    ]  # fmt: skip
    return min([*tries, *(descended(each.x, _FULL) for each in going_on)], key=lambda each: each.cost)


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


class Fits(Predictions):
    """Fits to sites that share the tissue and the candidate effects.

    turned : gives the curves with the probe turned by 90 degrees, where these can be simulated
    """

    def __init__(self, sites: Sequence[SiteCurves]):
        super().__init__(sites)
        self.turned: Callable[[], SiteCurves] | None = None
        self.base_end: tuple[float, float] | None = None  # c (MPa), m of the fit without effects
        self._ends: dict[tuple[Explanation, str], Array] = {}  # where fits ended: ln c, ln m, parameters

    def best_fit(
        self, explanation: Explanation, points: Sequence[Theta], start: Mapping[str, float], *,
        thorough: bool = True, held: Mapping[str, float] = _NONE, besides: Sequence[Array] = (),
    ) -> tuple[float, Fitted]:  # fmt: skip
        """Least-squares fit from several initial guesses; returns (deviance, fit).

        held : parameters fixed at a value; besides : further initial guesses, as x of `predict`
        """
        slots = self.slots(explanation)
        parameters = [slot.parameter for slot in slots]
        low, high = self._around(held, explanation)
        scale = np.array([0.1, 0.3, *(p.step for p in parameters)])
        guesses = [[_guess(s, start) for s in slots]]
        if not any(p.shape and s.name in start for p, s in zip(parameters, slots, strict=True)):
            guesses.append([p.start for p in parameters])
        for each in self.sites:
            each.inherit_parts(explanation, points)
        tissues = self._tissue_starts()
        pairs = list(zip(guesses, tissues, strict=False)) if parameters else [([], each) for each in tissues]
        starts = [np.array([np.log(c), np.log(m), *guess]) for guess, (c, m) in pairs]
        ends = self._ends_of_parts(explanation, points)
        if (explanation, label(points)) in self._ends and not start:
            starts = []  # already fitted from all initial guesses

        n_far = sum(not p.shape and p.typical != p.null for p in parameters)
        off = _Trials(lambda x: self._off(x, explanation, points), len(self.data) + n_far)

        def descended(x0: Array, n_most: int) -> Any:
            inside = np.clip(x0, low + 1e-6, high - 1e-6)
            return least_squares(
                off, inside, bounds=(low, high), x_scale=scale, diff_step=1e-4, ftol=_FTOL, xtol=_XTOL,
                max_nfev=n_most,
            )  # fmt: skip

        seeds = [x for x in (*besides, *ends, *starts) if off.has_answer(np.clip(x, low + 1e-6, high - 1e-6))]
        if not seeds:
            raise off.problems[0]
        best = _deepest(descended, seeds) if thorough else descended(seeds[0], _QUICK)
        if not np.isfinite(best.cost):
            raise FitError("the prediction is not a number", where="diagnose", fix="look at levels.csv")
        if thorough and not held:
            self._ends[explanation, label(points)] = best.x
        return 2 * float(best.cost), self._fitted(best.x, explanation, points)

    def _off(self, x: Array, explanation: Explanation, points: Sequence[Theta]) -> Array:
        """Residuals that a fit minimises: whitened residuals, and the weak prior on effect sizes."""
        far = [
            (x[2 + k] - p.null) / (_ROOMY * abs(p.typical - p.null))
            for k, p in enumerate(slot.parameter for slot in self.slots(explanation))
            if not p.shape and p.typical != p.null
        ]
        return np.concatenate([self.whiten(self.data.y - self.predict(x, explanation, points)), far])

    def _ends_of_parts(self, explanation: Explanation, points: Sequence[Theta]) -> list[Array]:
        """Initial guesses from earlier fits: of this explanation, and of those with one effect less.

        The fit must be at least as good as the latter; the missing effect starts at a tenth of the way from
        its null value to its start value.
        """
        own = self._ends.get((explanation, label(points)))
        found = [] if own is None else [own]
        for k in range(len(explanation)):
            others = [n for n in range(len(explanation)) if n != k]
            end = self._ends.get((tuple(explanation[n] for n in others), label([points[n] for n in others])))
            if end is None:
                continue
            known = dict(
                zip([s.name for s in self.slots(tuple(explanation[n] for n in others))], end[2:], strict=True)
            )
            rest = [
                known.get(s.name, 0.9 * s.parameter.null + 0.1 * s.parameter.start)
                for s in self.slots(explanation)
            ]
            found.append(np.array([*end[:2], *rest]))
        return found

    def plausible(self, fitted: Fitted, deviance: float, points: Sequence[Theta]) -> Fitted:
        """The fit with a plausible size, if a size ended on its bound and a plausible one is in its interval.

        A flat least-squares fit reaches a bound by chance, which is no evidence against the effect. It is
        flat if, to first order, no size of any magnitude would fit much better.
        """
        for share in (0.0, 0.5):
            sizes = self._plausible_sizes(fitted, share)
            if not sizes:
                break
            again, other = self.best_fit(fitted.explanation, points, {}, held=sizes)
            shapes = [slot.parameter.shape for slot in self.slots(fitted.explanation)]
            columns = other.jacobian[:, np.r_[np.ones(len(other.base_names), bool), ~np.array(shapes)]]
            left = LinearFit.of(self.whiten(self.data.y - other.prediction), self.whiten(columns)).chi2
            if not other.at_bound and again < min(deviance, left) + thresholds.WITHIN:
                return other
        return fitted

    def _plausible_sizes(self, fitted: Fitted, share: float) -> dict[str, float]:
        """For parameters on a bound: the typical value on that side, moved towards the bound by `share`."""
        sizes, slots = {}, self.slots(fitted.explanation)
        x = np.array([0.0, 0.0, *(fitted.values[slot.name] for slot in slots)])
        beyond = {hit.name for hit in bound_hits(x, slots, self.effects.values()) if not hit.is_absent}
        for slot in slots:
            p, value = slot.parameter, fitted.values[slot.name]
            if slot.name in beyond:
                usual = np.clip(p.null + np.sign(value - p.null) * abs(p.typical - p.null), p.low, p.high)
                sizes[slot.name] = float(usual + share * (value - usual))
        return sizes

    def _around(self, held: Mapping[str, float], explanation: Explanation) -> tuple[Array, Array]:
        """The bounds of the fit, narrowed to the values of held parameters."""
        low, high = self.bounds(explanation)
        for k, slot in enumerate(self.slots(explanation)):
            if slot.name in held:
                margin = 1e-4 * (slot.parameter.high - slot.parameter.low)
                low[2 + k], high[2 + k] = held[slot.name] - margin, held[slot.name] + margin
        return low, high

    def at(self, fitted: Fitted, m: float, start: Mapping[str, float], whiten: Whitener) -> Conditional:
        """The best fit of the same explanation, at the same grid points, with m fixed."""
        explanation, points = fitted.explanation, self.points(fitted)
        slots = self.slots(explanation)
        free = [0, *range(2, 2 + len(slots))]
        low, high = (each[free] for each in self.bounds(explanation))
        x0 = np.array([np.log(start["c_kpa"] / 1e3), *(start[s.name] for s in slots)])

        def full(z: Array) -> Array:
            return np.array([z[0], np.log(m), *z[1:]])

        off = _Trials(
            lambda z: whiten(self.data.y - self.predict(full(z), explanation, points)), len(self.data)
        )
        found = least_squares(
            off, np.clip(x0, low + 1e-6, high - 1e-6), bounds=(low, high), diff_step=1e-4, max_nfev=15,
            ftol=1e-5, xtol=1e-4,
            x_scale=np.array([0.1, *(s.parameter.step for s in slots)]),
        )  # fmt: skip
        names = ["c_kpa", *(s.name for s in slots)]
        spread = np.zeros(len(free))
        if off.has_answer(found.x):
            J = whiten(self._jacobian(full(found.x), explanation, points))[:, free]
            spread = np.sqrt(np.maximum(np.diag(np.linalg.pinv(J.T @ J)), 0.0))
        values = {**fitted.values, **dict(zip(names, found.x.tolist(), strict=True)), "m": m}
        values["c_kpa"] = float(kpa_from_mpa(float(np.exp(found.x[0]))))
        return Conditional(2 * float(found.cost), values, dict(zip(names, spread.tolist(), strict=True)))

    def _tissue_starts(self) -> list[tuple[float, float]]:
        """Initial guesses of (c, m): the result of the fit without effects, and a usual tissue."""
        usual = [(self.simulations.c, 2.0), (self.simulations.c, 6.0)]
        if self.base_end is None:
            return usual
        m = self.base_end[1]
        return [self.base_end, max(usual, key=lambda each: abs(np.log(each[1] / m)))]

    def _fitted(self, x: Array, explanation: Explanation, points: Sequence[Theta]) -> Fitted:
        slots = self.slots(explanation)
        low, high = self.bounds(explanation)
        free = np.ones(len(x), dtype=bool)
        near = thresholds.ON_BOUND * (high[1] - low[1])
        free[1] = low[1] + near < x[1] < high[1] - near
        notes = () if free[1] else (f"m ended on its bound {np.exp(x[1]):g} and is held there",)
        jacobian = self._jacobian(x, explanation, points)
        jacobian[:, 2:][:, stuck(x, slots)] = 0.0
        values = {"c_kpa": float(kpa_from_mpa(float(np.exp(x[0])))), "m": float(np.exp(x[1]))}
        values |= dict(zip([s.name for s in slots], x[2:].tolist(), strict=True))
        values |= {k: float(v) for point in points for k, v in point.items()}
        return Fitted(
            explanation, self.predict(x, explanation, points), jacobian[:, free],
            ("c", "m") if free[1] else ("c",), values, tuple(s.name for s in slots),
            tuple(hit.message for hit in bound_hits(x, slots, self.effects.values())), notes,
            {"grid": label(points)}, self.predict(x[:2], (), ()) if explanation else None,
        )  # fmt: skip
