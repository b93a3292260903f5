"""Joint draws of c, m and f_kappa of a whole limb, as functions that can be evaluated at any points.

A draw takes one hypothesis of the grid for each parameter by its probability, a function from the prior
(random Fourier features), and errors of the readings; it then moves the function by the readings' distance
from it:

    f(x) = f_prior(x) + k(x, readings) (K + R)^-1 (values - f_prior(readings) - errors)

which is a draw from the posterior. Errors of c and m of a site that its fit correlates are drawn together, so
that c and m of a draw are correlated as the fit says. Draw k of a seed is the same function however many
draws are made, and for any points in any order.

Source: Wilson et al. 2020, ICML 119:10292 (pathwise conditioning).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.linalg import cho_solve

from limbcli.errors import FitError
from limbcli.files.atomic import atomic_file
from limbcli.files.plain_text import write_rows
from limbcli.model import Array
from limbcli.numbers.units import kpa_from_mpa
from limbcli.stiffness_field.coordinates import AnatomicalPlaces
from limbcli.stiffness_field.field import Conditioned, StiffnessField
from limbcli.stiffness_field.kernel import Features
from limbcli.stiffness_field.readings import PARAMETERS

N_DRAWS = 50
_FREQUENCIES = 256
_CHUNK = 20000  # points at a time


@dataclass(frozen=True, eq=False)
class DrawnValues:
    """c (MPa), m and f_kappa of one draw at n points, all (n,)."""

    c: Array
    m: Array
    f_kappa: Array


@dataclass(frozen=True, eq=False)
class Draw:
    """One draw of the field.

    features : of each parameter; level : (3,) mean of ln of each: the prior's and the person's
    weights : (3, 2 n) of the features; update : (n_readings,) of the correlations with the readings
    """

    number: int
    field: StiffnessField
    part: Conditioned
    features: tuple[Features, ...]
    level: Array
    weights: Array
    update: Array

    def at(self, points: Array | AnatomicalPlaces) -> DrawnValues:
        """c, m and f_kappa at points (n, 3), mm in the frame of the surfaces, or at places in the limb.

        For several draws at the same points, `field.limb.places(points)` spares the distances.
        """
        places = self.field.limb.places(points)
        logs = np.concatenate(
            [
                self.logs(places.part(slice(start, start + _CHUNK)))
                for start in range(0, max(len(places), 1), _CHUNK)
            ]
        )
        priors = [self.field.priors[name] for name in PARAMETERS]
        return DrawnValues(
            *(np.clip(np.exp(each), p.low, p.high) for each, p in zip(logs.T, priors, strict=True))
        )

    def logs(self, places: AnatomicalPlaces) -> Array:
        """ln of c, m, f_kappa (n, 3) at places."""
        out = self.level + _values(self.features, self.weights, places)
        if len(self.update):
            for k in np.unique(self.field.readings.parameter):
                hypothesis = self.part.hypotheses[int(k)]
                cross = self.field.to_readings(int(k), places, [hypothesis.lengths])[hypothesis.lengths]
                out[:, k] += hypothesis.variation**2 * cross @ self.update
        return np.asarray(out)


@dataclass(frozen=True, eq=False)
class Draws:
    """`n` joint draws of a field; `seed` fixes all of them."""

    field: StiffnessField
    seed: int = 7
    n: int = N_DRAWS

    def draw(self, k: int) -> Draw:
        """Draw number k, from 0.

        Raises FitError if there is no such draw.
        """
        if not 0 <= k < self.n:
            raise FitError(
                f"there is no draw {k}", where="draws of the stiffness field", fix=f"give 0 to {self.n - 1}"
            )
        return _drawn(self, k)

    def table(self, points: Array, weights: Array | None = None) -> list[dict[str, float]]:
        """One row per draw: means of c, m and f_kappa over the limb, and c at each site.

        points : (n, 3) mm over which the means are taken (geometric, as the field is one of logarithms)
        weights : (n,) such as volumes of elements; None: equal
        """
        rows, places = [], self.field.limb.places(points)
        at_sites = {site.name: self.field.limb.places(site.points) for site in self.field.sites}
        for k in range(self.n):
            draw = self.draw(k)
            found = draw.at(places)
            means = [
                float(np.exp(np.average(np.log(each), weights=weights)))
                for each in (found.c, found.m, found.f_kappa)
            ]
            row = {"draw": float(k), "c_mean_kpa": kpa_from_mpa(means[0]), "m_mean": means[1]}
            row["f_kappa_mean"] = means[2]
            for name, region in at_sites.items():
                here = draw.at(region)
                c, m = (float(np.exp(np.log(each).mean())) for each in (here.c, here.m))
                row |= {f"c_{name}_kpa": kpa_from_mpa(c), f"m_{name}": m}
            hypothesis = draw.part.hypotheses[0]  # of c
            row |= {
                "length_along_mm": hypothesis.lengths.height_mm,
                "length_around_rad": hypothesis.lengths.around,
                "length_depth": hypothesis.lengths.depth,
                "variation_of_ln": hypothesis.variation,
            }
            rows.append(row)
        return rows


def write_draws(path: Path, rows: Sequence[dict[str, float]]) -> None:
    """Write draws.csv, one row per draw, atomically."""
    with atomic_file(path) as partial:
        write_rows(partial, rows[0], ([f"{value:.6g}" for value in row.values()] for row in rows))


@lru_cache(maxsize=64)
def _drawn(draws: Draws, k: int) -> Draw:
    field, rng = draws.field, np.random.default_rng([draws.seed, k])
    readings, part = field.readings, field.parts[_one_of(field.shares, rng)]
    hypotheses = part.hypotheses
    features = tuple(Features.drawn(_FREQUENCIES, each.lengths, rng) for each in hypotheses)
    sizes = np.array([[each.variation] for each in hypotheses])
    weights = sizes * rng.standard_normal((len(PARAMETERS), 2 * _FREQUENCIES))
    priors = [field.priors[name] for name in PARAMETERS]
    person = np.array([p.deviation for p in priors]) * rng.standard_normal(len(priors))
    level = np.array([p.mean for p in priors]) + person
    update = np.empty(0)
    if len(readings):
        n, which = len(readings), readings.parameter
        prior = _values(features, weights, readings.places)
        seen = level[which] + np.einsum("nq,nq->n", readings.average, prior.T[which])
        errors = _normal(part.noise, rng)
        own = np.array([each.own_error for each in hypotheses])[which]
        errors += _normal(part.model_error, rng)
        errors += _normal(own[:, None] * readings.own * own, rng)
        update = cho_solve(part.factor, part.values - seen - errors)
        for j, p in enumerate(priors):
            level[j] += p.deviation**2 * float(update[which == j].sum())
        assert update.shape == (n,)
    return Draw(k, field, part, features, level, weights, np.asarray(update, float))


def _one_of(shares: Array, rng: np.random.Generator) -> int:
    """Number of one of the parts, by their probabilities."""
    return int(np.searchsorted(np.cumsum(shares), rng.random() * (1 - 1e-12)))


def _values(features: Sequence[Features], weights: Array, places: AnatomicalPlaces) -> Array:
    """Variation (n_places, 3) of ln of each parameter before the readings."""
    return np.stack([each.at(places) @ own for each, own in zip(features, weights, strict=True)], axis=1)


def _normal(covariance: Array, rng: np.random.Generator) -> Array:
    """A draw (n,) from N(0, covariance), which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(values))))
