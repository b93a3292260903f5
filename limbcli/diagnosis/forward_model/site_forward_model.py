"""The diagnosis' forward model: fits and sensitivities of one site, or of several that share the tissue.

Fits run on each site's surrogate. A likely explanation is simulated at its fit, the surrogate is corrected to
the result and the fit is repeated; the reported numbers come from this fit.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from limbcli.diagnosis.curves.curve_plan import FIRST_M, nearest_m, some_solved
from limbcli.diagnosis.data.noise_parts import BESIDE, IN_MAPS, LEAST_BESIDE, LEAST_IN_MAPS
from limbcli.diagnosis.explanations.forward_model import (
    Data,
    Direction,
    Explanation,
    Facts,
    Fitted,
    Proposal,
    Scalable,
)
from limbcli.diagnosis.explanations.laplace import posterior
from limbcli.diagnosis.forward_model.fits import Fits
from limbcli.diagnosis.forward_model.measurement_menu import menu
from limbcli.diagnosis.forward_model.predictions import NOTHING, Predictions, Slot, held_points
from limbcli.diagnosis.forward_model.surrogate import AtPoints, SiteCurves
from limbcli.effects.effect import Effect, Theta, point_name
from limbcli.errors import LimbError
from limbcli.model import Array

_SETTLED, _BEYOND = 0.1, 0.1  # largest distance in ln m from the nearest solved m, and beyond all of them
_MAX_NODES = 5  # largest number of solved values of m
_MOST_REPAIRS = 4  # largest number of corrections of the surrogate, for one effect
_STAYS = 0.1  # change of the prediction, in standard deviations, below which a fit has converged
_MOST_POINTS, _TRIED_FULLY = 60, 2  # combinations of grid points that are tried at all, and fitted fully


class SiteForwardModel:
    """
    turned : gives the curves with the probe turned by 90 degrees, where these can be simulated
    not_simulated : explanations whose fit was not simulated because the work budget was used up
    shares : by noise part, the estimated fraction of its assumed size (`settle_noise`)
    """

    def __init__(self, sites: Sequence[SiteCurves]):
        self.predictions = Predictions(sites)
        self.fits = Fits(self.predictions)
        self.turned: Callable[[], SiteCurves] | None = None
        self.not_simulated: set[Explanation] = set()
        self.shares: dict[str, float] = {}

    def settle_noise(self) -> None:
        """Take the error of all strains along the fit without effects, and start from the sizes of the model
        errors in maps that are most probable with that fit."""
        self.predictions.strain_along(self.fit((), {}))
        found = posterior(self.fit((), {}), self.data.y, self.data.noise, self.scalable)
        self.shares = dict(found.shares)
        self.predictions.allow_for(self.shares)

    @property
    def data(self) -> Data:
        return self.predictions.data

    @property
    def candidates(self) -> Sequence[Facts]:
        sizes = self.predictions.sizes
        return [
            Facts(
                e.name, e.sentence, e.kind, simulated=e.solves,
                typical={s.name: s.parameter.typical - s.parameter.null for s in sizes(e.name)},
            )
            for e in self.predictions.effects.values()
        ]  # fmt: skip

    @property
    def scalable(self) -> Sequence[Scalable]:
        """The model errors in maps, whose size a site's data tell; relative to the sizes that fits use."""
        return [
            Scalable(name, least / self.shares.get(name, 1.0), 1.0 / self.shares.get(name, 1.0))
            for name, least in ((BESIDE, LEAST_BESIDE), (IN_MAPS, LEAST_IN_MAPS))
        ]

    def fit(self, explanation: Explanation, start: Mapping[str, float]) -> Fitted:
        """Fit of c, m and the effects' parameters; the best over the effects' grid points."""
        if not explanation:
            return self._fit_base()
        self.predictions.check_channels(explanation)
        effects = [self.predictions.effects[name] for name in explanation]
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
            deviance, fitted = self.fits.best(model, start)
        deviances |= {each.point: value for value, _, each in found}
        likely = np.mean(np.exp(-0.5 * np.maximum(np.array(list(deviances.values())) - deviance, 0.0)))
        return replace(fitted, ln_points=float(np.log(likely)))

    def verified(self, fitted: Fitted) -> Fitted:
        """Simulate the fitted model, correct the surrogate there and fit again, until the fit converges.

        The fit is returned unchanged if the work budget is used up. A fit that does not converge moves to
        where the surrogate is wrong; the best simulated parameters are then returned.
        """
        explanation, predict = fitted.explanation, self.predictions
        if not any(predict.effects[name].solves for name in explanation):
            return fitted
        if any(each.simulations.spent for each in predict.sites):
            self.not_simulated.add(explanation)
            return fitted
        model, solved, ln_points = predict.model_of(fitted), [], fitted.ln_points
        for _ in range(_MOST_REPAIRS if len(explanation) == 1 else 2):
            x = predict.x_of(fitted)
            x[1] = np.log(round(fitted.values["m"], 4))
            for k, each in enumerate(predict.sites):
                each.repair(float(np.exp(x[1])), model, predict.theta(fitted.values, explanation, k))
            before = predict.predict(x, model)
            solved.append((float(np.sum(self.fits.off(x, model) ** 2)), x))
            best = min(solved, key=lambda each: each[0])
            _, fitted = self.fits.best(model, {}, besides=[best[1]])
            if np.max(np.abs(fitted.prediction - before) / self.data.deviation) < _STAYS:
                return replace(fitted, ln_points=ln_points)
        return replace(self.fits.fitted(best[1], model), ln_points=ln_points)

    def directions(self, fitted: Fitted, name: str) -> Sequence[Direction]:
        effect = self.predictions.effects[name]
        self.predictions.check_channels((name,))
        slots = self.predictions.sizes(name)

        def at(point: Theta) -> Direction:
            columns = [self._column(fitted, effect, slot, point) for slot in slots]
            priors = {slot.name: slot.prior for slot in slots}
            return Direction(np.stack(columns, axis=1), priors, point_name(point), effect.free(point))

        return some_solved(at, effect.grid)

    def proposals(self, fits: Sequence[Fitted]) -> Sequence[Proposal]:
        return menu(self.predictions, fits, self.turned)

    # ------------------------------------------------------------

    def _column(self, fitted: Fitted, effect: Effect, slot: Slot, point: Theta) -> Array:
        """Sensitivity at the effect's null value by finite differences of the surrogate about the fitted
        model."""
        predict, p, old = self.predictions, slot.parameter, self.predictions.model_of(fitted)
        new = old.added(effect.name, effect.held(point))
        slots = predict.slots(new.explanation)
        values = {s.name: s.parameter.null for s in slots} | effect.free(point) | dict(fitted.values)
        up = predict.x_of(replace(fitted, explanation=new.explanation, values=values))
        down, k = up.copy(), 2 + slots.index(slot)
        step = p.looked_at * (p.start - p.null)
        up[k] += step
        if not p.sign:
            down[k] -= step
        for each in predict.sites:
            each.inherit(old, new)
        return np.asarray((predict.predict(up, new) - predict.predict(down, new)) / (up[k] - down[k]))

    def _fit_base(self) -> Fitted:
        sites = self.predictions.sites
        for each in sites:
            each.solve_nodes(FIRST_M)
        for _ in range(_MAX_NODES):
            fitted = self.fits.best(NOTHING, {})[1]
            m, solved = fitted.values["m"], self._nodes()
            nearest = nearest_m(solved or FIRST_M[:1], m)
            if abs(np.log(nearest / m)) < _SETTLED or len(solved) >= _MAX_NODES:
                break
            if not self._solve_node(float(round(m, 3))):
                break
        for each in sites:
            each.changes.m = nearest_m(each.nodes, fitted.values["m"])
        self.fits.tissue = (fitted.values["c_kpa"] / 1e3, fitted.values["m"])
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
        for each in self.predictions.sites:
            each.solve_nodes([m])
        return m in self._nodes()

    def _nodes(self) -> set[float]:
        return set.intersection(*(set(each.nodes) for each in self.predictions.sites))

    def _each(
        self, several: Sequence[AtPoints], start: Mapping[str, float], *, thorough: bool
    ) -> list[tuple[float, AtPoints, Fitted]]:
        """Fits of these models, the best first; those without a solution are left out."""

        def best(model: AtPoints) -> tuple[float, AtPoints, Fitted]:
            cost, fitted = self.fits.best(model, start, thorough=thorough)
            return cost, model, fitted

        return sorted(some_solved(best, several, unless=LimbError), key=lambda each: each[0])
