"""The diagnosis' forward model: fits and sensitivities of one site, or of several measurements of one place.

Fits run on each site's surrogate. After a refit, the model with the fitted effect is simulated, the surrogate
is corrected to the result and the fit is repeated; the reported numbers come from this fit.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.estimates import Conditional, Reported, reported
from limbcli.diagnostics.model.forward_model import Direction, Explanation, Facts, Fitted, Proposal
from limbcli.diagnostics.model.linear import Whitener
from limbcli.diagnostics.model.noise_scale import likeliest_share
from limbcli.effects.base import Effect, Theta, point_name
from limbcli.errors import FitError, LimbError, SolveError
from limbcli.model import Array
from limbcli.stages.diagnosis.curves.site_simulations import FIRST_M
from limbcli.stages.diagnosis.data.noise import BESIDE, IN_MAPS, LEAST_BESIDE, LEAST_IN_MAPS
from limbcli.stages.diagnosis.forward_model.changes import only_febio
from limbcli.stages.diagnosis.forward_model.fit_parameters import Slot
from limbcli.stages.diagnosis.forward_model.fits import Fits
from limbcli.stages.diagnosis.forward_model.measurement_menu import menu
from limbcli.stages.diagnosis.forward_model.predictions import M_BOUNDS, held_points
from limbcli.stages.diagnosis.forward_model.surrogate import SiteCurves
from limbcli.units import kpa_from_mpa

_SETTLED, _BEYOND = 0.1, 0.1  # largest distance in ln m from the nearest, and the largest, solved m
_MAX_NODES = 5  # largest number of solved values of m
_MOST_REPAIRS = 4  # largest number of corrections of the surrogate, for one effect
_STAYS = 0.1  # change of the prediction, in standard deviations, below which a fit has converged
_MOST_POINTS, _TRIED_FULLY = 60, 2  # combinations of grid points that are tried at all, and fitted fully


class SiteForwardModel(Fits):
    """Forward model of one site, or of several sites that share the tissue.

    not_simulated : explanations whose fit was not simulated because the work budget was used up
    shares : by noise part, the estimated fraction of its assumed size (`settle_noise`)
    """

    not_simulated: set[Explanation]
    shares: dict[str, float]

    def __init__(self, sites: Sequence[SiteCurves], *, verify: bool = True):
        """sites : with the same candidate effects; verify : simulate fitted models"""
        super().__init__(sites)
        self.verify, self.not_simulated, self.shares = verify, set(), {}

    def settle_noise(self) -> None:
        """Take the error of all strains along the fit without effects, and estimate the model errors in maps,
        near parts that are not shown and elsewhere, from that fit.

        Raises
        ------
        SolveError, FitError
            If that fit fails.
        """
        self.strain_along(self.fit((), {}))
        for name, least in ((BESIDE, LEAST_BESIDE), (IN_MAPS, LEAST_IN_MAPS)):
            if name not in self.data.noise.names:
                continue
            base = self.fit((), {})
            off = self.data.y - base.prediction
            share = likeliest_share(off, base.jacobian, self.data.noise, name, least=least)
            self.shares[name] = share
            self.allow_for(name, share)

    # ------------------------------------------------------------ the contract

    @property
    def candidates(self) -> Sequence[Facts]:
        return [
            Facts(
                e.name, e.sentence, e.kind,
                {
                    s.name: s.parameter.proportional(s.parameter.typical)
                    for s in self.slots((e.name,)) if not s.parameter.shape
                },
                simulated=e.solves,
            )
            for e in self.effects.values()
        ]  # fmt: skip

    @property
    def interval_widening(self) -> float:
        return thresholds.MAP_INTERVAL_FACTOR if IN_MAPS in self.data.noise.names else 1.0

    def fit(self, explanation: Explanation, start: Mapping[str, float]) -> Fitted:
        """Least-squares fit of c, m and the effects' parameters; the best over the effects' grid points."""
        if not explanation:
            return self._fit_base()
        self._check_channels(explanation)
        effects = [self.effects[name] for name in explanation]
        # With several effects none has a late onset: a free step and another effect can fit almost any
        # residual.
        grids = [held_points(e)[:1] if e.onset and len(effects) > 1 else held_points(e) for e in effects]
        combinations: list[Sequence[Theta]] = list(itertools.islice(itertools.product(*grids), _MOST_POINTS))
        if len(combinations) > _TRIED_FULLY:
            quick = self._each(explanation, combinations, start, thorough=False)
            combinations = [points for _, points, _ in quick[:_TRIED_FULLY]]
        deviance, points, fitted = self._each(explanation, combinations, start, thorough=True)[0]
        if self._reaches(fitted.values["m"]):
            deviance, fitted = self.best_fit(explanation, points, start)
        return self.plausible(fitted, deviance, points)

    def reported(self, fitted: Fitted, *, scale: float = 1.0, besides: Array | None = None) -> Reported:
        """Values and intervals from the profile over m; those of c and m are widened where maps determine
        them (`thresholds.MAP_INTERVAL_FACTOR`)."""
        whiten = self.whiten if besides is None else Whitener.of(self.data.noise.covariance + besides)

        def walk(m: float, start: Mapping[str, float]) -> Conditional:
            return self.at(fitted, m, start, whiten)

        found = reported(walk, fitted.values, M_BOUNDS, scale=scale)
        ln_low, ln_high = (float(each[0]) for each in self.bounds(()))
        limits = {s.name: (s.parameter.low, s.parameter.high) for s in self.slots(fitted.explanation)}
        limits["c_kpa"] = kpa_from_mpa(np.exp(ln_low)), kpa_from_mpa(np.exp(ln_high))
        limits["m"] = M_BOUNDS
        return found.widened(self.interval_widening).within(limits)

    def verified(self, fitted: Fitted) -> Fitted:
        """Simulate the fitted model, correct the surrogate there and fit again, until the fit converges.

        At most twice with several effects and four times with one. The fit is returned unchanged if the work
        budget is used up. If it does not converge, it moves to where the surrogate is wrong; the best
        simulated parameters are then returned.
        """
        explanation = fitted.explanation
        solves = any(self.effects[name].solves for name in explanation)
        if not self.verify or not solves or fitted.at_bound:
            return fitted
        if any(each.simulations.spent for each in self.sites):
            self.not_simulated.add(explanation)
            return fitted
        points, solved = self.points(fitted), []
        for _ in range(_MOST_REPAIRS if len(explanation) == 1 else 2):
            x = self._x_of(fitted)
            x[1] = np.log(round(fitted.values["m"], 4))
            for k, each in enumerate(self.sites):
                theta = self.theta(fitted.values, explanation, k)
                each.repair(float(np.exp(x[1])), explanation, theta, points)
            before = self.predict(x, explanation, points)
            solved.append((float(np.sum(self._off(x, explanation, points) ** 2)), x))
            best = min(solved, key=lambda each: each[0])
            deviance, fitted = self.best_fit(explanation, points, {}, besides=[best[1]])
            fitted = self.plausible(fitted, deviance, points)
            if np.max(np.abs(fitted.prediction - before) / self.data.deviation) < _STAYS:
                return fitted
        return self._fitted(best[1], explanation, points)

    def directions(self, fitted: Fitted, name: str) -> Sequence[Direction]:
        effect = self.effects[name]
        self._check_channels((name,))
        slots = [slot for slot in self.slots((name,)) if not slot.parameter.shape]
        found, problem = [], None
        for point in effect.grid:
            try:
                columns = [self._column(fitted, effect, slot, point) for slot in slots]
            except SolveError as error:  # other points may have a solution
                problem = error
                continue
            signs = tuple(slot.parameter.sign for slot in slots)
            names = tuple(slot.name for slot in slots)
            found.append(
                Direction(np.stack(columns, axis=1), signs, point_name(point), names, effect.free(point))
            )
        if not found and problem is not None:
            raise problem
        return found

    def proposals(self, fits: Sequence[Fitted]) -> Sequence[Proposal]:
        return menu(self, fits)

    # ------------------------------------------------------------

    def _column(self, fitted: Fitted, effect: Effect, slot: Slot, point: Theta) -> Array:
        """Sensitivity at the effect's null value by finite differences of the surrogate about the fitted
        model."""
        p, old = slot.parameter, fitted.explanation
        points = [*self.points(fitted), effect.held(point)]
        explanation = (*old, effect.name)
        slots = self.slots(explanation)
        values = {s.name: s.parameter.null for s in slots} | effect.free(point) | dict(fitted.values)
        x = [np.log(fitted.values["c_kpa"] / 1e3), np.log(fitted.values["m"])]
        x += [values[s.name] for s in slots]
        k = 2 + [s.name for s in slots].index(slot.name)
        step = p.looked_at * (p.start - p.null)
        up, down = np.array(x), np.array(x)
        up[k] += step
        if not p.sign:
            down[k] -= step
        for each in self.sites:
            each.inherit(old, points[:-1], explanation, points)
        moved = self.predict(up, explanation, points) - self.predict(down, explanation, points)
        return np.asarray(moved / (up[k] - down[k]))

    def _fit_base(self) -> Fitted:
        for each in self.sites:
            each.solve_nodes(FIRST_M)
        for _ in range(_MAX_NODES):
            fitted = self.best_fit((), (), {})[1]
            m = fitted.values["m"]
            solved = self._nodes()
            if abs(np.log(self._nearest(m) / m)) < _SETTLED or len(solved) >= _MAX_NODES:
                break
            if not self._solve_node(float(round(m, 3))):
                break
        for each in self.sites:
            each.changes.m = min(each.nodes, key=lambda node: abs(np.log(node / fitted.values["m"])))
        self.base_end = (fitted.values["c_kpa"] / 1e3, fitted.values["m"])
        return fitted

    def _reaches(self, m: float) -> bool:
        """Solve at m if it exceeds all solved values; returns whether this was needed and succeeded."""
        nodes = self._nodes()
        if np.log(m / max(nodes)) < _BEYOND or len(nodes) >= _MAX_NODES:
            return False
        return self._solve_node(float(round(m, 3)))

    def _solve_node(self, m: float) -> bool:
        solved = [each.solve_node(m) for each in self.sites]
        return all(solved)

    def _nodes(self) -> set[float]:
        return set.intersection(*(set(each.nodes) for each in self.sites))

    def _nearest(self, m: float) -> float:
        return min(self._nodes() or {FIRST_M[0]}, key=lambda node: abs(np.log(node / m)))

    def _each(
        self, explanation: Explanation, combinations: Sequence[Sequence[Theta]], start: Mapping[str, float],
        *, thorough: bool,
    ) -> list[tuple[float, Sequence[Theta], Fitted]]:  # fmt: skip
        """Fits at these points of the effects' grids, the best first; points without a solution are left
        out."""
        found, problem = [], None
        for points in combinations:
            try:
                cost, fitted = self.best_fit(explanation, points, start, thorough=thorough)
            except LimbError as error:
                problem = error
                continue
            found.append((cost, points, fitted))
        if not found and problem is not None:
            raise problem
        return sorted(found, key=lambda each: each[0])

    def _check_channels(self, explanation: Explanation) -> None:
        has = {channel for each in self.sites for channel in each.site.channels}
        has |= {"bone"} if all(each.has_bone for each in self.sites) else set()
        for name in explanation:
            for each in self.sites:
                if name in each.refused:
                    raise each.refused[name]
            if self.effects[name].febio_only:
                raise only_febio(self.effects[name])
            lacking = [each for each in self.effects[name].needs if each not in has]
            if lacking:
                if "bone" in lacking:
                    raise FitError(
                        "it requires a bone under the probe, where the model has none",
                        where=f"effect {name}",
                        fix="check the site's position and the bones' surfaces",
                    )
                raise FitError(
                    f"it requires data that were not measured: {', '.join(lacking)}",
                    where=f"effect {name}", fix="measure it; see the next measurement",
                )  # fmt: skip
