"""The stiffness of a whole limb from its sites: a Gaussian process over anatomical coordinates.

For each parameter p of c, m and f_kappa, at a place x of the limb,

    ln p(x) = mu_p + b_p + f_p(x)

mu_p is the population's mean, b_p ~ N(0, s_p^2) the person's deviation from it (constant over the limb) and
f_p ~ GP(0, sigma^2 k) the variation within the limb (`kernel`). A site reads the mean of ln p over its
region, plus the error that its interval states, plus one of its own, N(0, tau^2): what two measurements of
one place differ by. Far from every site the field is thus the person's mean as the sites show it, and without
sites the population's.

The force of a site reads all three parameters together (`forces`), so that they are conditioned together.

The correlation lengths, sigma and tau are not known from a few sites. They are not fitted: every combination
of a grid is kept, weighted by its marginal likelihood, and all results are averages over the grid. Each
parameter has its own, weighted by its own readings: c may vary a lot within a limb whose m does not.

Source: Rasmussen and Williams 2006, Gaussian Processes for Machine Learning, sections 2.2, 2.7 and 5.2.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.spatial import cKDTree
from scipy.special import ndtr, ndtri
from scipy.stats import chi2

from limbcli.model import Array
from limbcli.stiffness_field.coordinates import AnatomicalPlaces, LimbCoordinates
from limbcli.stiffness_field.expectation import normal_readings
from limbcli.stiffness_field.field_readings import FieldReadings, gathered, linear_about
from limbcli.stiffness_field.kernel import Between, Lengths
from limbcli.stiffness_field.likelihood import Interval
from limbcli.stiffness_field.readings import PARAMETERS, MapReading, SiteReading, check_readings

LABELS = ("identified", "interpolated", "assumed")
# A point is identified within this distance (mm) of what a site's reading averages over, if the readings have
# removed half of the variance that the field has far from all sites; it is assumed if they have removed less
# than a tenth.
NEAR_MM, IDENTIFIED, ASSUMED = 10.0, 0.5, 0.9
_LEAST_WEIGHT = 1e-3  # combinations of less weight, as a fraction of the largest, are left out
_CHUNK = 4000  # points at a time
_STEPS, _STILL, _WIDEST = 12, 1e-3, 8.0  # quantiles of mixtures
# Standard deviations of an error of ln force of each site's own, the least with which sites agree.
_OWN_OF_FORCE = (0.0, 0.05, 0.15, 0.5, 1.5)
_CHANCE = 0.999  # probability of a distance of the readings that is not at odds
_SEED = 7  # of the orders in which hypotheses are combined
_ROUNDS, _STEP, _SETTLED = 40, 0.5, 1e-3  # of linear forces: rounds, largest and last change of ln


@dataclass(frozen=True)
class FieldPrior:
    """Prior of one parameter: ln of the person's mean is normal.

    mean : of ln (of MPa for c); deviation : of ln; low, high : possible values, draws are kept within them
    source : in words
    """

    mean: float
    deviation: float
    low: float
    high: float
    source: str


PRIORS: Mapping[str, FieldPrior] = {
    "c": FieldPrior(
        float(np.log(0.008)), 0.7, 1e-5, 1.0,
        "chosen: 2 to 32 kPa (95 %), which holds both sites of the lower legs in MULTIS (`cohort`: 4.9 and "
        "18.8 kPa)",
    ),
    "m": FieldPrior(float(np.log(3.9)), 0.69, 1.0, 100.0, "that of `diagnose`: 1 to 15 (95 %)"),
    "f_kappa": FieldPrior(float(np.log(100.0)), 0.9, 0.01, 1000.0, "chosen: 17 to 580 (95 %)"),
}  # fmt: skip


@dataclass(frozen=True)
class HypothesisGrid:
    """Values of the quantities that few sites do not tell, all combinations equally probable before the data.

    height_mm, around, depth : correlation lengths
    variation : sigma, standard deviation of ln within a limb
    own_error : tau, standard deviation of ln of a site's own error beyond its interval
    """

    height_mm: tuple[float, ...] = (40.0, 120.0)
    around: tuple[float, ...] = (0.6, 1.5)
    depth: tuple[float, ...] = (0.5, 1.5)
    variation: tuple[float, ...] = (0.15, 0.3, 0.6)
    own_error: tuple[float, ...] = (0.0, 0.15)

    def combinations(self) -> list[Hypothesis]:
        return [
            Hypothesis(Lengths(*each[:3]), *each[3:])
            for each in itertools.product(
                self.height_mm, self.around, self.depth, self.variation, self.own_error
            )
        ]


@dataclass(frozen=True)
class Hypothesis:
    """One combination of the grid."""

    lengths: Lengths
    variation: float
    own_error: float


@dataclass(frozen=True, eq=False)
class Values:
    """One parameter at n points (c in MPa): median, ends of the 95 % interval, all (n,).

    ratio : variance of ln over that far from every site, 0 (known) to 1
    """

    value: Array
    low: Array
    high: Array
    ratio: Array


@dataclass(frozen=True, eq=False)
class PointValues:
    """The field at n points: c, c_low, c_high (MPa, 95 %), all (n,).

    label : "identified", "interpolated" or "assumed"; distance : mm to the nearest point that a reading of c
        averages over (inf without sites); ratio : as `Values`
    """

    c: Array
    c_low: Array
    c_high: Array
    label: NDArray[np.str_]
    distance: Array
    ratio: Array


@dataclass(frozen=True, eq=False)
class Conditioned:
    """The field under one hypothesis for each parameter: readings (n,) and their noise with all likelihoods
    made normal.

    hypotheses : in the order of `PARAMETERS`
    model_error : as of `FieldReadings`
    weights : (n,) the inverse covariance times the readings' distance from the prior mean
    """

    hypotheses: tuple[Hypothesis, ...]
    log_evidence: float
    values: Array
    noise: Array
    model_error: Array
    factor: tuple[NDArray[np.floating[Any]], bool]
    weights: Array

    def told(self, cross: Array) -> Array:
        """Variance (n,) that the readings take from quantities of covariances `cross` (n, n_readings) with
        them, less what the errors of the forces' models give back."""
        root = solve_triangular(self.factor[0], cross.T, lower=True)
        return np.asarray((root**2).sum(axis=0) - ((self._model_errors.T @ root) ** 2).sum(axis=0))

    @cached_property
    def _model_errors(self) -> Array:
        """The errors of the forces' models, one standard deviation each (n_readings, k), divided by the
        factor."""
        rows = np.flatnonzero(np.diag(self.model_error) > 0.0)
        variance, axes = np.linalg.eigh(self.model_error[np.ix_(rows, rows)])
        errors = np.zeros((len(self.values), len(rows)))
        errors[rows] = axes * np.sqrt(np.maximum(variance, 0.0))
        return np.asarray(solve_triangular(self.factor[0], errors, lower=True))


@dataclass(frozen=True, eq=False)
class StiffnessField:
    """c, m and f_kappa in a whole limb, conditioned on the readings of its sites.

    parts, shares : the field under combinations of the parameters' hypotheses, and their posterior
        probabilities (n_parts,)
    together : (n, n) correlations of the readings' regional means, by lengths
    known : (k, 3) mm, points that readings of c average over
    """

    limb: LimbCoordinates
    priors: Mapping[str, FieldPrior]
    readings: FieldReadings
    parts: Sequence[Conditioned]
    shares: Array
    together: Mapping[Lengths, Array]
    known: Array
    sites: Sequence[SiteReading]
    maps: Sequence[MapReading]

    def at(self, points: Array) -> PointValues:
        """c at points (n, 3), mm in the frame of the surfaces, with 95 % intervals and labels."""
        found = self.values_of("c", points)
        distance = np.full(len(points), np.inf)
        if len(self.known):
            distance = cKDTree(self.known).query(points)[0]
        label = np.full(len(points), LABELS[1], dtype="<U12")
        label[found.ratio > ASSUMED] = LABELS[2]
        label[(found.ratio <= IDENTIFIED) & (distance <= NEAR_MM)] = LABELS[0]
        return PointValues(found.value, found.low, found.high, label, distance, found.ratio)

    def values_of(self, parameter: str, points: Array) -> Values:
        """One of "c" (MPa), "m" and "f_kappa" at points (n, 3)."""
        places, shares = self.limb.places(points), self.shares
        out = np.empty((4, len(places)))
        for start in range(0, len(places), _CHUNK):
            chunk = slice(start, start + _CHUNK)
            mean, variance, far = self._moments(parameter, places.part(chunk))
            out[0, chunk] = shares @ mean
            out[1, chunk], out[2, chunk] = (quantile(q, mean, variance, shares) for q in (0.025, 0.975))
            out[3, chunk] = np.clip((shares @ variance) / (shares @ far), 0.0, 1.0)
        prior = self.priors[parameter]
        value, low, high = np.clip(np.exp(out[:3]), prior.low, prior.high)
        return Values(value, low, high, out[3])

    def _moments(self, parameter: str, places: AnatomicalPlaces) -> tuple[Array, Array, Array]:
        """Mean and variance of ln (n_parts, n) at places under each hypothesis; variance far away."""
        which, parts, prior = PARAMETERS.index(parameter), self.parts, self.priors[parameter]
        shape = (len(parts), len(places))
        mean, variance, far = np.full(shape, prior.mean), np.empty(shape), np.empty(shape)
        between = self.to_readings(which, places, {part.hypotheses[which].lengths for part in parts})
        for k, part in enumerate(parts):
            hypothesis = part.hypotheses[which]
            total = hypothesis.variation**2 + prior.deviation**2
            variance[k], far[k] = total, total
            if not len(self.readings):
                continue
            same = (self.readings.parameter == which).astype(float)
            cross = (hypothesis.variation**2) * between[hypothesis.lengths]
            cross += prior.deviation**2 * same
            mean[k] += cross @ part.weights
            variance[k] -= part.told(cross)
            far[k] -= part.told(prior.deviation**2 * same[None])
        return mean, np.maximum(variance, 1e-12), np.maximum(far, 1e-12)

    def to_readings(
        self, which: int, places: AnatomicalPlaces, lengths: Iterable[Lengths]
    ) -> dict[Lengths, Array]:
        """Correlations (n_places, n_readings) of one parameter's variation at places with all readings, for
        each of the lengths."""
        same = self.readings.parameter == which
        own = self.readings.average[same]
        used = own.any(axis=0)
        between = Between(places, self.readings.places.part(used))
        found = {}
        for each in lengths:
            found[each] = np.zeros((len(places), len(self.readings)))
            found[each][:, same] = between.correlation(each) @ own[:, used].T
        return found

    def hypotheses(self, parameter: str) -> list[tuple[Hypothesis, float]]:
        """The hypotheses of a parameter that are kept, with their probabilities."""
        which, found = PARAMETERS.index(parameter), dict[Hypothesis, float]()
        for part, share in zip(self.parts, self.shares.tolist(), strict=True):
            found[part.hypotheses[which]] = found.get(part.hypotheses[which], 0.0) + share
        return list(found.items())

    def mean_over(self, parameter: str, points: Array) -> tuple[Array, Array]:
        """Mean and variance (n_parts,) of the mean of ln over points (q, 3), under each hypothesis."""
        which, places = PARAMETERS.index(parameter), self.limb.places(points)
        prior, parts = self.priors[parameter], self.parts
        mean, variance = np.full(len(parts), prior.mean), np.empty(len(parts))
        several = {part.hypotheses[which].lengths for part in parts}
        itself, between = Between(places, places), self.to_readings(which, places, several)
        for k, part in enumerate(parts):
            hypothesis = part.hypotheses[which]
            own = float(itself.correlation(hypothesis.lengths).mean())
            variance[k] = hypothesis.variation**2 * own + prior.deviation**2
            if len(self.readings):
                same = (self.readings.parameter == which).astype(float)
                cross = hypothesis.variation**2 * between[hypothesis.lengths].mean(axis=0)
                cross += prior.deviation**2 * same
                mean[k] += cross @ part.weights
                variance[k] -= float(part.told(cross[None])[0])
        return mean, np.maximum(variance, 1e-12)


def stiffness_field(
    limb: LimbCoordinates,
    sites: Sequence[SiteReading],
    maps: Sequence[MapReading] = (),
    *,
    priors: Mapping[str, FieldPrior] = PRIORS,
    grid: HypothesisGrid | None = None,
) -> StiffnessField:
    """The field of a limb from the readings of its sites.

    Without sites it is the prior everywhere. Parameters that no site tells keep their prior.

    Raises FitError if a reading is not finite and positive, in another unit, or of a site that was given
    twice.
    """
    check_readings(sites, maps)
    hypotheses = (grid or HypothesisGrid()).combinations()
    lengths = {each.lengths for each in hypotheses}
    alone = gathered(limb, sites, maps, forces=False)
    together = _averaged_correlations(alone, lengths)
    shares = [_shares(alone, name, hypotheses, priors, together) for name in PARAMETERS]
    readings = gathered(limb, sites, maps, forces=True)
    together = _averaged_correlations(readings, lengths)
    joint = _combined(hypotheses, shares)
    for own_error in _OWN_OF_FORCE if len(readings.forces) > 1 else (0.0,):
        readings, parts = _with_linear_forces(readings, joint, priors, together, own_error)
        if not _at_odds(readings, parts, priors):
            break
    of_c = [each.points for each in sites if "c" in each.values] + [each.points for each in maps]
    return StiffnessField(
        limb, priors, readings, parts, np.array([share for _, share in joint]), together,
        np.concatenate(of_c) if of_c else np.empty((0, 3)),
        tuple(sites), tuple(maps),
    )  # fmt: skip


def _shares(
    readings: FieldReadings, parameter: str, hypotheses: Sequence[Hypothesis],
    priors: Mapping[str, FieldPrior], together: Mapping[Lengths, Array],
) -> Array:  # fmt: skip
    """Posterior probability (n_hypotheses,) of each hypothesis of a parameter from its own readings; 0 where
    it is left out."""
    which = np.flatnonzero(readings.parameter == PARAMETERS.index(parameter))
    own = readings.part(which)
    inner = {lengths: each[np.ix_(which, which)] for lengths, each in together.items()}
    n = len(PARAMETERS)
    logs = np.array([conditioned(own, (each,) * n, priors, inner).log_evidence for each in hypotheses])
    shares = np.exp(logs - logs.max())
    shares[shares <= _LEAST_WEIGHT] = 0.0
    return np.asarray(shares / shares.sum())


def _combined(
    hypotheses: Sequence[Hypothesis], shares: Sequence[Array]
) -> list[tuple[tuple[Hypothesis, ...], float]]:
    """Combinations of one hypothesis for each parameter, with probabilities that add up to those of each.

    Each parameter divides the range from 0 to 1 among its hypotheses, in an order of its own; a combination
    is what meets in one place. So there are no more than the sum of all hypotheses.
    """
    rng = np.random.default_rng(_SEED)
    orders = [rng.permutation(np.flatnonzero(each)) for each in shares]
    ends = [np.cumsum(each[order]) for each, order in zip(shares, orders, strict=True)]
    cuts = np.unique(np.concatenate([[0.0, 1.0], *(each[:-1] for each in ends)]))
    widths = np.diff(cuts)
    middles = cuts[:-1] + 0.5 * widths
    at = [
        order[np.minimum(np.searchsorted(end, middles), len(order) - 1)]
        for order, end in zip(orders, ends, strict=True)
    ]
    return [
        (tuple(hypotheses[int(k)] for k in each), float(width))
        for *each, width in zip(*at, widths, strict=True) if width > 0
    ]  # fmt: skip


def quantile(q: float, mean: Array, variance: Array, shares: Array) -> Array:
    """Quantile (n,) of a mixture of normals: means and variances (n_parts, n), shares (n_parts,).

    Newton's method within a bracket, from the quantile of the normal distribution with the same moments.
    """
    deviation = np.sqrt(variance)
    middle = shares @ mean
    total = np.sqrt(shares @ (variance + (mean - middle) ** 2))
    low, high = (mean - _WIDEST * deviation).min(axis=0), (mean + _WIDEST * deviation).max(axis=0)
    x = middle + float(ndtri(q)) * total
    for _ in range(_STEPS):
        z = (x - mean) / deviation
        missed = shares @ ndtr(z) - q
        slope = shares @ (np.exp(-0.5 * z * z) / deviation) / np.sqrt(2.0 * np.pi)
        low, high = np.where(missed < 0, x, low), np.where(missed < 0, high, x)
        step = x - missed / np.maximum(slope, 1e-12)
        x = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
        if np.max(np.abs(missed), initial=0.0) < _STILL * min(q, 1.0 - q):
            break
    return np.asarray(x)


def _with_linear_forces(
    readings: FieldReadings, joint: Sequence[tuple[tuple[Hypothesis, ...], float]],
    priors: Mapping[str, FieldPrior], together: Mapping[Lengths, Array], own_error: float,
) -> tuple[FieldReadings, list[Conditioned]]:  # fmt: skip
    """The readings with all forces linear about what the field then is at their sites (one Gauss-Newton step
    after another), and the field under all combinations of hypotheses."""
    parts = [conditioned(readings, each, priors, together) for each, _ in joint]
    if not readings.forces:
        return readings, parts
    used = [priors[name] for name in PARAMETERS]
    low, high = (np.log([getattr(each, end) for each in used]) for end in ("low", "high"))
    mean = np.array([priors[PARAMETERS[k]].mean for k in readings.parameter])
    no_errors = replace(readings, own=np.zeros_like(readings.own))
    rows = np.array([range(first, first + len(PARAMETERS)) for first in readings.forces])
    spread = [share * _prior_covariance(no_errors, each, priors, together)[rows] for each, share in joint]
    logs = mean.copy()
    for _ in range(_ROUNDS):
        readings = linear_about(readings, logs, own_error)
        parts = [conditioned(readings, each, priors, together) for each, _ in joint]
        found = mean[rows] + sum(k @ part.weights for k, part in zip(spread, parts, strict=True))
        step = np.clip(found - logs[rows], -_STEP, _STEP)
        moved = np.clip(logs[rows] + step, low, high) - logs[rows]
        logs[rows] += moved
        if np.abs(moved).max() < _SETTLED:
            break
    return readings, parts


def _at_odds(readings: FieldReadings, parts: Sequence[Conditioned], priors: Mapping[str, FieldPrior]) -> bool:
    """Whether readings with forces lie farther from what any hypothesis expects than chance allows: sites of
    one place with unlike forces, which only an absurd tissue would give."""
    mean = np.array([priors[PARAMETERS[k]].mean for k in readings.parameter])
    distance = min(float((part.values - mean) @ part.weights) for part in parts)
    return bool(distance > chi2.ppf(_CHANCE, len(readings)))


def _averaged_correlations(readings: FieldReadings, lengths: Iterable[Lengths]) -> dict[Lengths, Array]:
    """Correlations (n, n) of the readings' regional means, for each of the lengths."""
    between, average = Between(readings.places, readings.places), readings.average
    return {each: average @ between.correlation(each) @ average.T for each in lengths}


def conditioned(
    readings: FieldReadings, hypotheses: tuple[Hypothesis, ...], priors: Mapping[str, FieldPrior],
    together: Mapping[Lengths, Array],
) -> Conditioned:  # fmt: skip
    """The field under one hypothesis for each parameter; together : as of `StiffnessField`."""
    n = len(readings)
    if not n:
        empty = np.empty(0)
        none = np.empty((0, 0))
        return Conditioned(hypotheses, 0.0, empty, none, none, (none, True), empty)
    covariance = _prior_covariance(readings, hypotheses, priors, together)
    mean = np.array([priors[PARAMETERS[k]].mean for k in readings.parameter])
    values = readings.values.copy()
    noise = readings.noise.copy()
    for i, j, rho in readings.correlated:
        if i not in readings.likelihoods and j not in readings.likelihoods:
            noise[i, j] = noise[j, i] = rho * np.sqrt(noise[i, i] * noise[j, j])
    odd = np.array(sorted(readings.likelihoods), dtype=int)
    normal = np.setdiff1d(np.arange(n), odd)
    log_size = 0.0
    if len(odd):
        given_mean, given = mean[odd], covariance[np.ix_(odd, odd)]
        if len(normal):
            factor = cho_factor((covariance + noise)[np.ix_(normal, normal)], lower=True)
            cross = covariance[np.ix_(odd, normal)]
            given_mean = given_mean + cross @ cho_solve(factor, values[normal] - mean[normal])
            given = given - cross @ cho_solve(factor, cross.T)
        found = normal_readings([readings.likelihoods[k] for k in odd.tolist()], given_mean, given)
        values[odd], log_size = found.values, found.log_size
        noise[odd, odd] = found.variance
    total = covariance + noise
    root = np.linalg.cholesky(total)
    apart = solve_triangular(root, values - mean, lower=True)
    log_evidence = log_size - 0.5 * float(apart @ apart) - float(np.log(np.diag(root)).sum())
    log_evidence -= 0.5 * n * float(np.log(2.0 * np.pi))
    late = [each for each in readings.correlated if set(each[:2]) & set(odd.tolist())]
    for i, j, rho in late:
        noise[i, j] = noise[j, i] = rho * np.sqrt(noise[i, i] * noise[j, j])
    if late:
        root = np.linalg.cholesky(covariance + noise)
    weights = cho_solve((root, True), values - mean)
    return Conditioned(hypotheses, log_evidence, values, noise, readings.model_error, (root, True), weights)


def _prior_covariance(
    readings: FieldReadings, hypotheses: Sequence[Hypothesis], priors: Mapping[str, FieldPrior],
    together: Mapping[Lengths, Array],
) -> Array:  # fmt: skip
    """Covariance (n, n) of the readings before the data, without the noise that they state."""
    out = 1e-10 * np.eye(len(readings))
    for k, each in enumerate(hypotheses):
        block = np.ix_(*(np.flatnonzero(readings.parameter == k),) * 2)
        out[block] += each.variation**2 * together[each.lengths][block] + priors[PARAMETERS[k]].deviation ** 2
        out[block] += each.own_error**2 * readings.own[block]
    return out


def without_site(field: StiffnessField, name: str, grid: HypothesisGrid | None = None) -> StiffnessField:
    """The field from all other sites."""
    return stiffness_field(
        field.limb,
        [each for each in field.sites if each.name != name],
        [each for each in field.maps if each.site != name],
        priors=field.priors,
        grid=grid,
    )


__all__ = [
    "LABELS", "PRIORS", "FieldPrior", "HypothesisGrid", "Interval", "PointValues", "StiffnessField", "Values",
    "quantile", "stiffness_field", "without_site",
]  # fmt: skip
