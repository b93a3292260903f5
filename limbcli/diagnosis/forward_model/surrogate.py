"""Surrogate of one site: curves for any tissue and effects, interpolated from a few simulations.

The material law is simulated at a few values of its exponent m and interpolated; c scales force and
modulus exactly. Changes by effects come from `changes`. After a refit, the model with the fitted
effect is simulated, and the surrogate is corrected by the difference.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from limbcli.diagnosis.curves.curve_plan import bend, where_solved
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.diagnosis.data.site_data import SiteData
from limbcli.diagnosis.explanations.forward_model import Explanation
from limbcli.diagnosis.forward_model.changes import Changes, logs, without_spikes
from limbcli.diagnosis.mesh_error.mesh_correction import MeshCorrection, Penetration
from limbcli.effects.curves import Curves, gaps_filled, without_gaps
from limbcli.effects.effect import Effect, Theta, point_name
from limbcli.effects.reading import Reading
from limbcli.errors import LimbError
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

_OF_LEVELS = ("force", "swe", "map", "travel", "layer")
_NEAR = 5  # number of solved values of m used in the interpolation
_ON = 0.25  # range of polynomial extrapolation in m, as a fraction of the span of solved values
# Largest change of ln force and ln speed by effects: larger trial values in a fit would overflow.
_MOST_CHANGE = 10.0
_OF_NO_EFFECT = 0.1  # size, in units of the start value, below which a correction is not due to the effect
_FAR_IN_M = 0.3  # distance in ln m that counts as much as an effect's start value
_SHAPES = 4  # number of curves kept at the simulations' c
_SAME = 1e-9  # squared distance below which two models are the same


@dataclass(frozen=True, eq=False)
class AtPoints:
    """A model with the effects of an explanation, each at a point of its grid.

    >>> pair = AtPoints(("tilt", "skin-layer"), ({}, {"skin_thickness_mm": 1.5}))
    >>> pair.key, pair.without(1).key
    ((('tilt', 'skin-layer'), 'skin_thickness_mm 1.5'), (('tilt',), ''))
    """

    explanation: Explanation = ()
    points: tuple[Theta, ...] = ()

    def __iter__(self) -> Iterator[tuple[str, Theta]]:
        return zip(self.explanation, self.points, strict=True)

    @cached_property
    def key(self) -> tuple[Explanation, str]:
        """The explanation, and the label of the points."""
        return self.explanation, "; ".join(point_name(point) for point in self.points if point)

    def only(self, kept: Iterable[int]) -> AtPoints:
        """With the effects of these numbers."""
        several = list(kept)
        return AtPoints(tuple(self.explanation[k] for k in several), tuple(self.points[k] for k in several))

    def without(self, k: int) -> AtPoints:
        return self.only(n for n in range(len(self.points)) if n != k)

    def added(self, name: str, point: Theta) -> AtPoints:
        return AtPoints((*self.explanation, name), (*self.points, point))


@dataclass(frozen=True, eq=False)
class Repair:
    """Error of the surrogate at one simulated model, `missed` (n, n_columns) in `logs`, and its scaling to
    others; sizes : of the effects in that model, in units of their start values; ln_m : of its law"""

    missed: Array
    sizes: Mapping[str, float]
    ln_m: float

    def at(self, sizes: Mapping[str, float]) -> Array:
        """Correction in proportion to the effects' sizes, so that it nearly vanishes without them."""
        least = _OF_NO_EFFECT**2
        along = sum(size * sizes[name] for name, size in self.sizes.items())
        whole = sum(size**2 for size in self.sizes.values())
        return self.missed * max(0.0, (along + least) / (whole + least))

    def apart(self, sizes: Mapping[str, float], ln_m: float) -> float:
        """Squared distance to a model, with sizes in units of their start values and ln m in `_FAR_IN_M`."""
        return ((ln_m - self.ln_m) / _FAR_IN_M) ** 2 + sum(
            (sizes[name] - size) ** 2 for name, size in self.sizes.items()
        )


@dataclass(frozen=True, eq=False)
class Repairs:
    """Corrections of one explanation: the sum of those of its parts, and those of its own simulations.

    The latter are interpolated by inverse squared distance, which reproduces each one where it was simulated.

    Source: Shepard 1968, Proc 23rd ACM Nat Conf 517 (weights by inverse squared distance).
    """

    of_parts: tuple[Repairs, ...] = ()
    solved: tuple[Repair, ...] = ()

    def at(self, sizes: Mapping[str, float], ln_m: float) -> Array | float:
        total: Array | float = 0.0
        for part in self.of_parts:
            total = total + part.at(sizes, ln_m)
        weights = np.array([1.0 / (each.apart(sizes, ln_m) + _SAME) for each in self.solved])
        for weight, each in zip(weights / max(weights.sum(), _SAME), self.solved, strict=True):
            total = total + weight * each.at(sizes)
        return total


class SiteCurves:
    """One site's data and the surrogate of its simulations.

    correction : from the working mesh to the site's own; penetration : of the probe into the simulated models
    refused : effects that cannot be evaluated here, and why
    """

    def __init__(
        self, site: SiteData, simulations: SiteSimulations, effects: Mapping[str, Effect], *,
        correction: MeshCorrection | None = None, penetration: Penetration | None = None,
        refused: Mapping[str, LimbError] | None = None, progress: Progress = SILENT,
    ):  # fmt: skip
        self.site, self.simulations, self.effects, self.refused = site, simulations, effects, refused or {}
        self.correction, self.penetration = correction, penetration
        self.changes = Changes(simulations, progress=progress)
        self.nodes: dict[float, Curves] = {}
        self._base = lru_cache(1)(self._interpolated)  # most finite differences of a fit do not change m
        self._shape = lru_cache(_SHAPES)(self._shaped)  # nor do those by c or by effects on readings alone
        self._repairs: dict[tuple[Explanation, str], Repairs] = {}  # by the key of the model

    def solve_nodes(self, values: Sequence[float]) -> None:
        """Solve at these m, the stiffest law first; failures are left out, but SolveError if all fail."""
        self.nodes |= where_solved(self.simulations.curves, sorted(values, reverse=True))
        if not self.nodes:
            self.simulations.curves(min(values))  # raises

    @property
    def thickness(self) -> float:
        """mm from skin to bone along the beam; NaN if the beam meets no bone in the model."""
        return next((each.thickness for each in self.nodes.values() if each.thickness > 0), float("nan"))

    def predict(self, c: float, m: float, model: AtPoints, theta: Theta) -> Array:
        """Prediction of this site's data (n,)."""
        found = self.site.predict(*self.read(c, m, model, theta))
        for k, (name, point) in enumerate(model):
            share = point.get(self.effects[name].onset, 0.0)
            if share > 0.0:
                found = np.where(self._before(share), self.predict(c, m, model.without(k), theta), found)
        return found

    def _before(self, share: float) -> NDArray[np.bool_]:
        """Mask (n,) of data at levels before this fraction of all levels."""
        first = share * len(self.site.protocol)
        return np.asarray(self.site.rows.among(*_OF_LEVELS) & (self.site.rows.level < first))

    def read(self, c: float, m: float, model: AtPoints, theta: Theta) -> tuple[Curves, Reading]:
        """The surrogate's curves at these parameter values, and the reading model applied to them."""
        return self.curves(c, m, model, theta), self.reading(c, model, theta)

    def curves(self, c: float, m: float, model: AtPoints, theta: Theta) -> Curves:
        of_effects = tuple(
            (p.name, theta[p.name])
            for name, _ in model if self.effects[name].solves
            for p in self.effects[name].parameters if p.name in theta
        )  # fmt: skip
        repairs = self._repairs.get(model.key)
        shape = self._shape(m, model, of_effects, repairs, len(self.nodes))
        times = c / self.simulations.c
        taller = 1.0 if self.correction is None else self.correction.thickness_ratio
        thickness = shape.thickness * taller * (1.0 + theta.get("thickness_change", 0.0))
        log_speed = shape.log_speed + 0.5 * np.log(times)
        found = replace(shape, force=shape.force * times, thickness=thickness, log_speed=log_speed)
        return found if self.penetration is None else self.penetration.without(found, shape.force)

    def _shaped(
        self, m: float, model: AtPoints, of_effects: tuple[tuple[str, float], ...], repairs: Repairs | None,
        n_nodes: int,
    ) -> Curves:  # fmt: skip
        """The curves at the simulations' c; of_effects : parameters of effects that change the simulation"""
        theta = dict(of_effects)
        depth, base, plain = self._base(m, n_nodes)
        values = base
        if repairs is not None:
            values = values + repairs.at(self._sizes(model, theta), float(np.log(m)))
        for name, point in model:
            if self.effects[name].solves:
                values = values + self.changes.of(self.effects[name], point)(theta)
        values = base + np.clip(values - base, -_MOST_CHANGE, _MOST_CHANGE)
        force = np.concatenate([[0.0], np.exp(values[1:, 0])])
        return plain.with_table(depth, force, values[:, 1:])

    def reading(self, c: float, model: AtPoints, theta: Theta) -> Reading:
        reading = Reading(c=c)
        for name, point in model:
            reading = self.effects[name].observe(reading, {**point, **theta})
        return reading

    def repair(self, m: float, model: AtPoints, theta: Theta) -> None:
        """Simulate the model (SolveError if that fails), and correct the surrogate to the result."""
        effects = [(self.effects[name], point) for name, point in model]
        solving = tuple(
            (e, {**e.null, **{k: v for k, v in theta.items() if k in e.null}, **e.without_onset(q)})
            for e, q in effects if e.solves
        )  # fmt: skip
        true = logs(self.simulations.curves(m, solving))
        true = true + self._corrected(m, true.shape[1])
        known = self._repairs.get(model.key, Repairs())
        self._repairs[model.key] = replace(known, solved=())
        missed = true - logs(self.curves(self.simulations.c, m, model, theta))
        missed[0, 0] = 0.0
        if any(effect.new_mesh for effect, _ in solving):
            missed = without_spikes(self.simulations, missed)
        made = Repair(gaps_filled(missed), self._sizes(model, theta), float(np.log(m)))
        self._repairs[model.key] = replace(known, solved=(*known.solved, made))

    def inherit(self, old: AtPoints, new: AtPoints) -> None:
        """Initialise the correction of a larger model with that of the one it extends."""
        if old.key in self._repairs:
            self._repairs.setdefault(new.key, Repairs((self._repairs[old.key],)))

    def inherit_parts(self, model: AtPoints) -> None:
        """Begin a larger model's correction with those of its largest simulated part, and of the rest's."""
        n = len(model.explanation)
        if n < 2 or model.key in self._repairs:
            return
        left = set(range(n))
        total: tuple[Repairs, ...] = ()
        for size in range(n - 1, 0, -1):
            for part in itertools.permutations(range(n), size):
                key = model.only(part).key
                if left.issuperset(part) and key in self._repairs:
                    total += (self._repairs[key],)
                    left -= set(part)
        if total:
            self._repairs[model.key] = Repairs(total)

    # ------------------------------------------------------------

    def _sizes(self, model: AtPoints, theta: Theta) -> dict[str, float]:
        """Sizes of the simulated effects, in units of their start values."""
        return {
            p.name: p.proportional(theta[p.name]) / p.proportional(p.start)
            for name, _ in model if self.effects[name].solves for p in self.effects[name].sizes
        }  # fmt: skip

    def _corrected(self, m: float, width: int) -> Array | float:
        """Mesh correction, padded to `width` columns; lines are not corrected."""
        if self.correction is None:
            return 0.0
        known = self.correction.at(m)
        return np.pad(known, ((0, 0), (0, width - known.shape[1])))

    def _interpolated(self, m: float, n_nodes: int) -> tuple[Array, Array, Curves]:
        """Depths, `logs` at m by the `n_nodes` solved, and the curves of the nearest of these."""
        nodes = sorted(self.nodes, key=lambda node: abs(bend(node) - bend(m)))[:_NEAR]
        first = self.nodes[nodes[0]]
        weights = _weights(bend(np.array(nodes)), float(bend(m)))
        total = np.asarray(
            sum(w * _logs_without_gaps(self.nodes[node]) for w, node in zip(weights, nodes, strict=True))
        )
        return first.depth, total + self._corrected(m, total.shape[1]), first


@lru_cache(4 * _NEAR)  # of a few sites
def _logs_without_gaps(solved: Curves) -> Array:
    """`logs`, with parts of maps that not every m shows interpolated between the same depths."""
    return logs(replace(solved, log_speed=without_gaps(solved)))


def _weights(known: Array, at: float) -> Array:
    """Weights (n,) of values at `known` (n,) in polynomial interpolation at `at`.

    Further than `_ON` of their span outside the known points, the polynomial is extrapolated linearly, as
    polynomials diverge.

    >>> known, squares = np.array([1.0, 2.0, 3.0]), np.array([1.0, 4.0, 9.0])
    >>> round(float(_weights(known, 2.5) @ squares), 6)
    6.25
    >>> round(float(_weights(known, 13.5) @ squares), 6)  # 3.5 squared, and 10 on at its slope of 7
    82.25
    """
    span = float(np.ptp(known))
    inside = float(np.clip(at, known.min() - _ON * span, known.max() + _ON * span))

    def polynomial(x: float) -> Array:
        apart = known[:, None] - known[None, :]
        shares = (x - known[None, :]) / (apart + np.eye(len(known)))
        np.fill_diagonal(shares, 1.0)
        return np.asarray(shares.prod(axis=1))

    if inside == at:
        return polynomial(at)
    step = 1e-3 * span
    slope = (polynomial(inside + step) - polynomial(inside - step)) / (2 * step) if span > 0 else 0.0
    return np.asarray(polynomial(inside) + (at - inside) * slope)
