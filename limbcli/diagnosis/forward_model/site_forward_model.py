"""The diagnosis' forward model: fits and sensitivities of one site, or of several that share the tissue.

c, m and the effects' parameters are fitted on each site's surrogate. A likely explanation is simulated at its
fit, the surrogate is corrected to the result and the fit is repeated; the reported numbers come from this
fit.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from limbcli.diagnosis.curves.curve_plan import FIRST_M, nearest_m, some_solved
from limbcli.diagnosis.data.noise_parts import IN_MAPS, LEAST_IN_MAPS
from limbcli.diagnosis.explanations.forward_model import (
    Direction,
    Explanation,
    Facts,
    Fitted,
    Priors,
    Proposal,
    Scalable,
)
from limbcli.diagnosis.explanations.laplace import posterior
from limbcli.diagnosis.forward_model.measurement_menu import menu
from limbcli.diagnosis.forward_model.predictions import NOTHING, Predictions, Slot, held_points
from limbcli.diagnosis.forward_model.surrogate import AtPoints, SiteCurves
from limbcli.effects.effect import Effect, Theta, point_name
from limbcli.errors import FitError, LimbError, SolveError
from limbcli.model import Array
from limbcli.numbers.units import kpa_from_mpa

_SETTLED, _BEYOND = 0.1, 0.1  # largest distance in ln m from the nearest solved m, and beyond all of them
_MAX_NODES = 5  # largest number of solved values of m
_MOST_REPAIRS = 4  # largest number of corrections of the surrogate, for one effect
_STAYS = 0.1  # change of the prediction, in standard deviations, below which a fit has converged
_MOST_POINTS, _TRIED_FULLY = 60, 2  # combinations of grid points that are tried at all, and fitted fully
_QUICK, _FULL = 12, 60  # largest number of evaluations of a quick and of a full fit
_BEHIND, _FAR_BEHIND = 0.5, 10.0  # relative, absolute excess over the lowest cost that drops a start
_FTOL, _XTOL = 1e-6, 1e-5  # tolerances of least squares: a deviance of some hundreds to 0.001
_NO_ANSWER = 1e3  # residual, in standard deviations, of trial parameters without a solution


def _guess(slot: Slot, start: Mapping[str, float]) -> float:
    p = slot.parameter
    if p.shape:
        return start.get(slot.name, p.start)
    return p.null + start.get(slot.name, 0.0) or p.start


class SiteForwardModel(Predictions):
    """
    tissue : c (MPa) and m of the fit without effects, once known, from which others start
    turned : gives the curves with the probe turned by 90 degrees, where these can be simulated
    not_simulated : explanations whose fit was not simulated because the work budget was used up
    shares : by noise part, the estimated fraction of its assumed size (`settle_noise`)
    """

    def __init__(self, sites: Sequence[SiteCurves]):
        super().__init__(sites)
        self.tissue: tuple[float, float] | None = None
        self._ends: dict[tuple[Explanation, str], Array] = {}  # where fits ended: ln c, ln m, parameters
        self.turned: Callable[[], SiteCurves] | None = None
        self.not_simulated: set[Explanation] = set()
        self.shares: dict[str, float] = {}

    def settle_noise(self) -> None:
        """Take the error of all strains along the fit without effects, and start from the sizes of the model
        errors in maps that are most probable with that fit."""
        self.strain_along(self.fit((), {}))
        found = posterior(self.fit((), {}), self.data.y, self.data.noise, self.scalable)
        self.shares = dict(found.shares)
        self.allow_for(self.shares)

    @property
    def candidates(self) -> Sequence[Facts]:
        sizes = self.sizes
        return [
            Facts(
                e.name, e.sentence, e.kind, simulated=e.solves,
                typical={s.name: s.parameter.typical - s.parameter.null for s in sizes(e.name)},
            )
            for e in self.effects.values()
        ]  # fmt: skip

    @property
    def scalable(self) -> Sequence[Scalable]:
        """The model error in maps, whose size a site's data tell; relative to the size that fits use."""
        taken = self.shares.get(IN_MAPS, 1.0)
        return [Scalable(IN_MAPS, LEAST_IN_MAPS / taken, 1.0 / taken)]

    def fit(self, explanation: Explanation, start: Mapping[str, float]) -> Fitted:
        """Fit of c, m and the effects' parameters; the best over the effects' grid points."""
        if not explanation:
            return self._fit_base()
        self.check_channels(explanation)
        effects = [self.effects[name] for name in explanation]
        # With several effects none has a late onset: a free step and another effect can fit almost any
        # residual.
        grids = [held_points(e)[:1] if e.onset and len(effects) > 1 else held_points(e) for e in effects]
        several = [
            AtPoints(explanation, points)
            for points in itertools.islice(itertools.product(*grids), _MOST_POINTS)
        ]
        deviances: dict[str, float] = {}
        if len(several) > _TRIED_FULLY:
            quick = self._each(several, start, thorough=False)
            deviances = {fitted.point: deviance for deviance, _, fitted in quick}
            several = [model for _, model, _ in quick[:_TRIED_FULLY]]
        found = self._each(several, start, thorough=True)
        deviance, model, fitted = found[0]
        if self._reaches(fitted.values["m"]):
            deviance, fitted = self.best(model, start)
        deviances |= {each.point: value for value, _, each in found}
        likely = np.mean(np.exp(-0.5 * np.maximum(np.array(list(deviances.values())) - deviance, 0.0)))
        return replace(fitted, ln_points=float(np.log(likely)))

    def verified(self, fitted: Fitted) -> Fitted | None:
        """Simulate the fitted model, correct the surrogate there and fit again, until the fit converges; one
        that moves to where the surrogate is wrong gives the best simulated parameters. None if the work
        budget is used up."""
        explanation = fitted.explanation
        if not any(self.effects[name].solves for name in explanation):
            return fitted
        if any(each.simulations.spent for each in self.sites):
            self.not_simulated.add(explanation)
            return None
        model, solved, ln_points = self.model_of(fitted), [], fitted.ln_points
        for _ in range(_MOST_REPAIRS if len(explanation) == 1 else 2):
            x = self.x_of(fitted)
            x[1] = np.log(round(fitted.values["m"], 4))
            for k, each in enumerate(self.sites):
                each.repair(float(np.exp(x[1])), model, self.theta(fitted.values, explanation, k))
            before = self.predict(x, model)
            solved.append((float(np.sum(self.off(x, model) ** 2)), x))
            best = min(solved, key=lambda each: each[0])
            _, fitted = self.best(model, {}, besides=[best[1]])
            if np.max(np.abs(fitted.prediction - before) / self.data.deviation) < _STAYS:
                return replace(fitted, ln_points=ln_points)
        return replace(self.fitted(best[1], model), ln_points=ln_points)

    def directions(self, fitted: Fitted, name: str) -> Sequence[Direction]:
        effect = self.effects[name]
        self.check_channels((name,))
        slots = self.sizes(name)

        def at(point: Theta) -> Direction:
            columns = [self._column(fitted, effect, slot, point) for slot in slots]
            priors = {slot.name: slot.prior for slot in slots}
            return Direction(np.stack(columns, axis=1), priors, point_name(point), effect.free(point))

        return some_solved(at, effect.grid)

    def proposals(self, fits: Sequence[Fitted]) -> Sequence[Proposal]:
        return menu(self, fits, self.turned)

    def best(
        self, model: AtPoints, start: Mapping[str, float], *, thorough: bool = True,
        besides: Sequence[Array] = (),
    ) -> tuple[float, Fitted]:  # fmt: skip
        """The fit from several initial guesses: (deviance, fit). Trial parameters without a solution have
        large residuals, so that fits avoid these.

        start : initial sizes as distances from null, and grid values; besides : further initial guesses, as x
            of `predict`

        Raises SolveError or FitError if no initial guess has a solution, or the prediction is not finite.
        """
        slots, (low, high) = self.slots(model.explanation), self.bounds(model.explanation)
        scale = np.array([0.1, 0.3, *(slot.parameter.step for slot in slots)])
        for each in self.sites:
            each.inherit_parts(model)
        n_far = sum(np.isfinite(each.deviation) for each in self.priors(model.explanation))
        problems: list[SolveError] = []

        def off(x: Array) -> Array:
            try:
                return self.off(x, model)
            except SolveError as error:
                problems.append(error)
                return np.full(len(self.data) + n_far, _NO_ANSWER)

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
        far = [
            (value - each.mean) / each.deviation
            for value, each in zip(x, self.priors(model.explanation), strict=True)
            if np.isfinite(each.deviation)
        ]
        return np.concatenate([self.whiten(self.data.y - self.predict(x, model)), far])

    def fitted(self, x: Array, model: AtPoints) -> Fitted:
        """The fit at these parameters: ln c, ln m, and the effects'."""
        explanation, label = model.key
        slots, sizes = self.slots(explanation), self.named(x, explanation)
        values = {"c_kpa": float(kpa_from_mpa(float(np.exp(x[0])))), "m": float(np.exp(x[1])), **sizes}
        values |= {k: float(v) for point in model.points for k, v in point.items()}
        return Fitted(
            explanation, self.predict(x, model), self.jacobian(x, model), base_names=("c", "m"),
            values=values, effect_names=tuple(sizes),
            at_bound={each.name: words for each in slots if (words := each.on_bound(sizes[each.name]))},
            point=label, without=self._without_approximate(x, model),
            priors=Priors.about(x, self.priors(explanation)),
            amplification=self.amplification(x, model),
        )  # fmt: skip

    def _without_approximate(self, x: Array, model: AtPoints) -> Array | None:
        """Prediction without the effects whose form is never exactly that of a limb, of the tissue and
        simulated ones; None without such. An instrument's zero or scale has no other form."""
        effects = [self.effects[name] for name in model.explanation]
        kept = model.only(k for k, each in enumerate(effects) if each.kind != "tissue" and not each.solves)
        if len(kept.explanation) == len(effects):
            return None
        known = self.named(x, model.explanation)
        sizes = [known[slot.name] for slot in self.slots(kept.explanation)]
        return self.predict(np.array([*x[:2], *sizes]), kept)

    def _starts(self, model: AtPoints, start: Mapping[str, float]) -> list[Array]:
        """Usual initial guesses; none if these were tried before."""
        if model.key in self._ends and not start:
            return []
        slots, tissues = self.slots(model.explanation), self._tissues()
        guesses = [[_guess(s, start) for s in slots]]
        if not any(s.parameter.shape and s.name in start for s in slots):
            guesses.append([s.parameter.start for s in slots])
        pairs = list(zip(guesses, tissues, strict=False)) if slots else [([], each) for each in tissues]
        return [np.array([np.log(c), np.log(m), *guess]) for guess, (c, m) in pairs]

    def _ends_of_parts(self, model: AtPoints) -> list[Array]:
        """Initial guesses from earlier fits of this model, and of those with one effect less, which begins at
        a tenth of the way from its null value to its start value: the fit must be at least as good."""
        found = [self._ends[model.key]] if model.key in self._ends else []
        for k in range(len(model.explanation)):
            rest = model.without(k)
            if (end := self._ends.get(rest.key)) is None:
                continue
            known = self.named(end, rest.explanation)
            slots = self.slots(model.explanation)
            sizes = [known.get(s.name, 0.9 * s.parameter.null + 0.1 * s.parameter.start) for s in slots]
            found.append(np.array([*end[:2], *sizes]))
        return found

    def _tissues(self) -> list[tuple[float, float]]:
        """Initial guesses of (c, m): the result of the fit without effects, and a usual tissue."""
        c = self.sites[0].simulations.c
        usual = [(c, 2.0), (c, 6.0)]
        if self.tissue is None:
            return usual
        m = self.tissue[1]
        return [self.tissue, max(usual, key=lambda each: abs(np.log(each[1] / m)))]

    # ------------------------------------------------------------

    def _column(self, fitted: Fitted, effect: Effect, slot: Slot, point: Theta) -> Array:
        """Sensitivity at the effect's null value by finite differences of the surrogate about the fit."""
        p, old = slot.parameter, self.model_of(fitted)
        new = old.added(effect.name, effect.held(point))
        slots = self.slots(new.explanation)
        values = {s.name: s.parameter.null for s in slots} | effect.free(point) | dict(fitted.values)
        up = self.x_of(replace(fitted, explanation=new.explanation, values=values))
        down, k = up.copy(), 2 + slots.index(slot)
        step = p.looked_at * (p.start - p.null)
        up[k] += step
        if not p.sign:
            down[k] -= step
        for each in self.sites:
            each.inherit(old, new)
        return np.asarray((self.predict(up, new) - self.predict(down, new)) / (up[k] - down[k]))

    def _fit_base(self) -> Fitted:
        sites = self.sites
        for each in sites:
            each.solve_nodes(FIRST_M)
        for _ in range(_MAX_NODES):
            fitted = self.best(NOTHING, {})[1]
            m, solved = fitted.values["m"], self._nodes()
            nearest = nearest_m(solved or FIRST_M[:1], m)
            if abs(np.log(nearest / m)) < _SETTLED or len(solved) >= _MAX_NODES:
                break
            if not self._solve_node(float(round(m, 3))):
                break
        for each in sites:
            each.changes.m = nearest_m(each.nodes, fitted.values["m"])
        self.tissue = (fitted.values["c_kpa"] / 1e3, fitted.values["m"])
        return fitted

    def _reaches(self, m: float) -> bool:
        """Solve at m if it is beyond all solved values; returns whether this was needed and succeeded."""
        nodes = self._nodes()
        beyond = max(np.log(m / max(nodes)), np.log(min(nodes) / m))
        if beyond < _BEYOND or len(nodes) >= _MAX_NODES:
            return False
        return self._solve_node(float(round(m, 3)))

    def _solve_node(self, m: float) -> bool:
        """Solve at one further m; returns whether this succeeded at every site."""
        for each in self.sites:
            each.solve_nodes([m])
        return m in self._nodes()

    def _nodes(self) -> set[float]:
        return set.intersection(*(set(each.nodes) for each in self.sites))

    def _each(
        self, several: Sequence[AtPoints], start: Mapping[str, float], *, thorough: bool
    ) -> list[tuple[float, AtPoints, Fitted]]:
        """Fits of these models, the best first; those without a solution are left out."""

        def best(model: AtPoints) -> tuple[float, AtPoints, Fitted]:
            cost, fitted = self.best(model, start, thorough=thorough)
            return cost, model, fitted

        return sorted(some_solved(best, several, unless=LimbError), key=lambda each: each[0])


def _deepest(descended: Callable[[Array, int], Any], starts: Sequence[Array]) -> Any:
    """Best of the fits from several initial guesses; starts far above the lowest cost are not continued."""
    tries = [descended(x0, _QUICK if len(starts) > 1 else _FULL) for x0 in starts]
    least = min(each.cost for each in tries)
    going_on = [
        each for each in tries
        if each.status == 0 and each.cost < (1.0 + _BEHIND) * least + _FAR_BEHIND
    ]  # fmt: skip
    return min([*tries, *(descended(each.x, _FULL) for each in going_on)], key=lambda each: each.cost)
