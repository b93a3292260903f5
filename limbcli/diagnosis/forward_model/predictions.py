"""Predictions of explanations for the data of one site, or of several measurements of one place, from c, m
and effects' parameters at given points of the effects' grids.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from limbcli.diagnosis.curves.curve_plan import some_solved
from limbcli.diagnosis.data.site_data import SiteData, joined
from limbcli.diagnosis.explanations.estimates import LN_M_DEVIATION, USUAL_M
from limbcli.diagnosis.explanations.forward_model import Explanation, Fitted, Prior
from limbcli.diagnosis.forward_model.changes import only_febio
from limbcli.diagnosis.forward_model.surrogate import AtPoints, SiteCurves
from limbcli.effects.curves import Curves
from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.effects.reading import Reading
from limbcli.errors import FitError, SolveError
from limbcli.model import Array

NOTHING = AtPoints()
_DIAGNOSED_M_BOUNDS = (1.0, 20.0)
_DIFFERENCE = 1e-3
_ON_BOUND = 1e-3  # distance from a bound, as a fraction of the range, within which a parameter is on it
_ROOMY = 1.5  # standard deviation of the prior of a size, in plausible sizes


@dataclass(frozen=True)
class Slot:
    """A parameter of an explanation: its name in the fit, and the site it applies to (None: all).

    each_time : its size differs between measurements
    """

    name: str
    parameter: Parameter
    site: int | None = None
    each_time: bool = False

    @property
    def prior(self) -> Prior:
        """Normal about null, as wide as `_ROOMY` plausible sizes; uniform for a shape."""
        p = self.parameter
        if p.shape:
            return Prior.uniform(p.low, p.high)
        return Prior(p.null, _ROOMY * max(abs(p.typical - p.null), 1e-9), p.low, p.high)

    def on_bound(self, value: float) -> str:
        """Message where the value ended on a bound; empty elsewhere, at null and on a natural bound."""
        p = self.parameter
        near = _ON_BOUND * (p.high - p.low)
        if p.natural_bounds or (not p.shape and abs(value - p.null) <= near):
            return ""
        side = "lower" if value - p.low < near else "higher" if p.high - value < near else ""
        bound = p.low if side == "lower" else p.high
        return f"{self.name} ended on its {side} bound {bound:g}" if side else ""


def held_points(effect: Effect) -> list[Theta]:
    """The distinct points of an effect's grid, without the parameters that a fit varies."""
    found: list[Theta] = []
    for point in effect.grid:
        if effect.held(point) not in found:
            found.append(effect.held(point))
    return found


class Predictions:
    """Of sites that share the tissue and the candidate effects, with the priors of what is fitted.

    data : of all sites; whiten : of their noise, as fits weight it
    slots : of an explanation, its parameters in order; priors : of ln c, ln m and these parameters
    """

    def __init__(self, sites: Sequence[SiteCurves]):
        self.sites = tuple(sites)
        self.channels = {channel for each in self.sites for channel in each.site.channels}
        self.effects = {name: each.measured_by(self.channels) for name, each in sites[0].effects.items()}
        self.slots, self.priors = cache(self._slots_of), cache(self._priors_of)  # for every prediction
        self._join()

    def allow_for(self, shares: Mapping[str, float]) -> None:
        """Scale the noise parts of these names to fractions of their assumed sizes, at every site."""
        for each in self.sites:
            for name, share in shares.items():
                each.site = each.site.with_share(name, share)
        self._join()

    def strain_along(self, fitted: Fitted) -> None:
        """Take the error common to all strains along the derivative of this fit, at every site."""
        for k, each in enumerate(self.sites):
            each.site = each.site.with_strain_of(*self.curves_of(fitted, k))
        self._join()

    def _join(self) -> None:
        self.data = joined([each.site for each in self.sites])
        self.whiten = self.data.noise.whitener

    @property
    def site(self) -> SiteData:
        return self.sites[0].site

    def _slots_of(self, explanation: Explanation) -> tuple[Slot, ...]:
        found = []
        for name in explanation:
            effect = self.effects[name]
            for p in effect.parameters:
                if effect.each_time and len(self.sites) > 1:
                    found += [Slot(f"{p.name}@{s.site.name}", p, k, True) for k, s in enumerate(self.sites)]
                else:
                    found.append(Slot(p.name, p, each_time=effect.each_time))
        return tuple(found)

    def sizes(self, name: str) -> list[Slot]:
        return [slot for slot in self.slots((name,)) if not slot.parameter.shape]

    def theta(self, values: Mapping[str, float], explanation: Explanation, site: int) -> dict[str, float]:
        """Effect parameters of one site, by their own names."""
        return {
            slot.parameter.name: float(values[slot.name])
            for slot in self.slots(explanation) if slot.site in (None, site)
        }  # fmt: skip

    def model_of(self, fitted: Fitted) -> AtPoints:
        """The effects of a fit, at the points of their grids that were chosen."""
        chosen: list[Theta] = []
        for effect in (self.effects[name] for name in fitted.explanation):
            held = held_points(effect)
            match = [q for q in held if all(fitted.values.get(k) == v for k, v in q.items())]
            chosen.append(match[0] if match else held[0])
        return AtPoints(fitted.explanation, tuple(chosen))

    def x_of(self, fitted: Fitted) -> Array:
        values = fitted.values
        sizes = [values[slot.name] for slot in self.slots(fitted.explanation)]
        return np.array([np.log(values["c_kpa"] / 1e3), np.log(values["m"]), *sizes])

    def named(self, x: Array, explanation: Explanation) -> dict[str, float]:
        """The effects' parameters of a parameter vector, by their names in the fit."""
        return dict(zip([slot.name for slot in self.slots(explanation)], x[2:].tolist(), strict=True))

    def values_of(self, x: Array, explanation: Explanation) -> tuple[float, float, list[dict[str, float]]]:
        """c (MPa), m, and the effect parameters of every site for a parameter vector."""
        values = self.named(x, explanation)
        thetas = [self.theta(values, explanation, k) for k in range(len(self.sites))]
        return float(np.exp(x[0])), float(np.exp(x[1])), thetas

    def predict(self, x: Array, model: AtPoints = NOTHING) -> Array:
        """Prediction (n,) for x: ln c, ln m, then the effects' parameters in order.

        Raises SolveError if there is no solution, or it is not finite.
        """
        c, m, thetas = self.values_of(x, model.explanation)
        parts = [each.predict(c, m, model, theta) for each, theta in zip(self.sites, thetas, strict=True)]
        found = parts[0] if len(parts) == 1 else np.concatenate(parts)
        if not np.isfinite(found).all():
            raise SolveError("the prediction is not a number", where="diagnose", fix="look at levels.csv")
        return found

    def amplification(self, x: Array, model: AtPoints) -> Array | None:
        """Change (n,) of each shown ln speed per change of it in the tissue, 1 for others; None if all 1."""
        c, m, thetas = self.values_of(x, model.explanation)
        found = np.concatenate([
            each.site.amplification(*each.read(c, m, model, theta))
            for each, theta in zip(self.sites, thetas, strict=True)
        ])  # fmt: skip
        return None if np.allclose(found, 1.0) else found

    def curves_of(self, fitted: Fitted, site: int = 0) -> tuple[Curves, Reading]:
        """The fitted curves of a site, and the reading model applied to them."""
        theta = self.theta(fitted.values, fitted.explanation, site)
        c, m = fitted.values["c_kpa"] / 1e3, fitted.values["m"]
        return self.sites[site].read(c, m, self.model_of(fitted), theta)

    def jacobian(self, x: Array, model: AtPoints) -> Array:
        sizes = [1.0, 1.0, *(slot.parameter.step for slot in self.slots(model.explanation))]
        steps = np.diag(_DIFFERENCE * np.array(sizes))
        return np.stack([self._slope(x, step, model) / step[k] for k, step in enumerate(steps)], axis=1)

    def _slope(self, x: Array, step: Array, model: AtPoints) -> Array:
        """Change over this step by central, else one-sided differences; SolveError if none is solved."""
        known = some_solved(lambda sign: (sign, self.predict(x + sign * step, model)), (1.0, -1.0))
        if len(known) < 2:
            known.append((0.0, self.predict(x, model)))
        (lower, low), (upper, high) = sorted(known, key=lambda each: each[0])
        return np.asarray((high - low) / (upper - lower))

    def _priors_of(self, explanation: Explanation) -> tuple[Prior, ...]:
        (c_low, m_low), (c_high, m_high) = (each.tolist() for each in self.bounds(()))
        return (
            Prior.uniform(c_low, c_high),
            Prior(float(np.log(USUAL_M)), LN_M_DEVIATION, m_low, m_high),
            *(slot.prior for slot in self.slots(explanation)),
        )

    def check_channels(self, explanation: Explanation) -> None:
        """
        Raises FitError or SolveError if an effect requires data that were not measured, a bone, or FEBio.
        """
        has = self.channels | ({"bone"} if all(each.thickness > 0 for each in self.sites) else set())
        for name in explanation:
            for each in self.sites:
                if name in each.refused:
                    raise each.refused[name]
            if self.effects[name].febio_only:
                raise only_febio(self.effects[name])
            lacking = [each for each in self.effects[name].needs if each not in has]
            if "bone" in lacking:
                raise FitError(
                    "it requires a bone under the probe, where the model has none", where=f"effect {name}",
                    fix="check the site's position and the bones' surfaces",
                )  # fmt: skip
            if lacking:
                raise FitError(
                    f"it requires data that were not measured: {', '.join(lacking)}", where=f"effect {name}",
                    fix="measure it; see the next measurement",
                )  # fmt: skip

    def bounds(self, explanation: Explanation) -> tuple[Array, Array]:
        parameters = [slot.parameter for slot in self.slots(explanation)]
        c = self.sites[0].simulations.c
        low = np.array([np.log(c / 20), np.log(_DIAGNOSED_M_BOUNDS[0]), *(p.low for p in parameters)])
        high = np.array([np.log(c * 20), np.log(_DIAGNOSED_M_BOUNDS[1]), *(p.high for p in parameters)])
        return low, high
