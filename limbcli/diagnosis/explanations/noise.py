"""Noise model: a covariance composed of named parts, each with its source; and fits whitened by it.

The size of the noise is stated, its distribution is not. Readings taken by hand deviate by more than three
standard deviations far more often than under a normal distribution, and a true effect must not be rejected
because of one outlier: every test draws from Student's t with `TAILS` degrees of freedom, scaled to the
stated standard deviation.

A part that is a single unknown (a gain, a calibration, the compressibility) is in the covariance, but
generalised least squares gives the same parameters and chi2 as a fit in which it is one more parameter with
its prior; `common_errors` gives that fit's estimates.

Source: Lange, Little & Taylor 1989, J Am Stat Assoc 84:881 (t with few degrees of freedom for measured data);
Jeffreys 1961, Theory of Probability, section 5.7 (5 to 9 of them in long series of readings);
Robinson 1991, Stat Sci 6:15 (best linear unbiased prediction of the common unknowns).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import null_space

from limbcli.model import Array, IntArray
from limbcli.numbers.whitening import Whitener

_RANK = 1e-8
ASSUMED = "assumed"
OF_MODEL = "model: "  # beginning of the name of a part that is an error of the model
TAILS = 7.0
EXCESS = 6.0 / (TAILS - 4.0)  # excess kurtosis over the normal distribution


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Whitened residual r (n,), sensitivities J (n, p) of the fitted parameters, and the projector P off J.

    basis : (n, rank) orthonormal, spans the columns of J; P = I - basis basis'
    """

    residual: Array
    jacobian: Array
    basis: Array

    @staticmethod
    def of(residual: Array, jacobian: Array, *, as_it_stands: bool = False) -> LinearFit:
        """The fit, or with `as_it_stands` that where it stopped: if a linear step along J would reduce chi2
        by more than one, that direction is removed from the span. A prior, a bound, or a kink in the model
        stopped the fit, and following the derivatives would assume implausible sizes."""
        length = np.linalg.norm(jacobian, axis=0)
        u, s, _ = np.linalg.svd(jacobian / np.where(length > 0, length, 1.0), full_matrices=False)
        basis = u[:, s > _RANK * np.max(s, initial=1e-300)]
        pull = basis.T @ residual
        if as_it_stands and float(pull @ pull) > 1.0:
            basis = basis @ null_space(pull[None, :])
        return LinearFit(residual, jacobian, basis)

    @property
    def nu(self) -> int:
        """Degrees of freedom: rank of P."""
        return len(self.residual) - self.basis.shape[1]

    def project(self, x: Array) -> Array:
        """P x: the part of x that no change of the fitted parameters can reproduce; x (n,) or (n, k).

        >>> state = LinearFit.of(np.zeros(2), np.array([[1.0], [0.0]]))
        >>> state.project(np.array([3.0, 4.0]))
        array([0., 4.])
        """
        return x - self.basis @ (self.basis.T @ x)

    @cached_property
    def left(self) -> Array:
        """P r (n,)."""
        return self.project(self.residual)

    @property
    def chi2(self) -> float:
        return float(self.left @ self.left)


def unit_errors(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Independent errors of mean 0 and standard deviation 1, with the heavy tails of real readings.

    >>> errors = unit_errors(np.random.default_rng(7), (200_000,))
    >>> round(float(errors.std()), 2), round(100 * float(np.mean(np.abs(errors) > 3)), 1)
    (1.0, 0.9)
    """
    return rng.standard_t(TAILS, shape) * np.sqrt((TAILS - 2.0) / TAILS)


@dataclass(frozen=True, eq=False)
class NoisePart:
    """One cause of noise: covariance (n, n) and source ("repeats", "spec", "assumed", "computed", or
    "estimated" from the data).

    direction : (n,) effect of one standard deviation, if the part is a single unknown; else None
    """

    name: str
    covariance: Array
    source: str
    direction: Array | None = None

    def scaled(self, share: float) -> NoisePart:
        """The part with its standard deviation multiplied by an estimated factor."""
        return replace(self.times(np.full(len(self.covariance), share)), source="estimated")

    def times(self, factors: Array) -> NoisePart:
        """The part with the standard deviation of each datum multiplied by its factor (n,)."""
        direction = None if self.direction is None else factors * self.direction
        return NoisePart(self.name, self.covariance * np.outer(factors, factors), self.source, direction)


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise as the sum of independent parts; stated : source of the measurement's own noise."""

    parts: tuple[NoisePart, ...]
    stated: str = ""

    @cached_property
    def covariance(self) -> Array:
        return np.asarray(sum(part.covariance for part in self.parts))

    @cached_property
    def whitener(self) -> Whitener:
        return Whitener.of(self.covariance)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parts with a non-zero covariance."""
        return tuple(part.name for part in self.parts if part.covariance.any())

    def with_share(self, name: str, share: float) -> Noise:
        """The noise with the standard deviation of part `name` scaled by the estimated `share`."""
        return self.with_parts(part.scaled(share) if part.name == name else part for part in self.parts)

    def amplified(self, times: Array | None) -> Noise:
        """The noise with the model's errors multiplied by these factors (n,); None: by 1."""
        if times is None:
            return self
        return self.with_parts(
            part.times(times) if part.name.startswith(OF_MODEL) else part for part in self.parts
        )

    def with_parts(self, parts: Iterable[NoisePart]) -> Noise:
        return Noise(tuple(parts), self.stated)

    @property
    def is_assumed(self) -> bool:
        """Whether the measurement's own noise is only assumed, so that no absolute test is possible."""
        return self.stated == ASSUMED

    def provenance(self) -> list[dict[str, str]]:
        return [{"part": part.name, "source": part.source} for part in self.parts]


def independent(name: str, deviation: Array, *, source: str) -> NoisePart:
    """
    >>> independent("depth", np.array([2.0, 3.0]), source="spec").covariance
    array([[4., 0.],
           [0., 9.]])
    """
    return NoisePart(name, np.diag(np.asarray(deviation, dtype=float) ** 2), source)


def common(name: str, direction: Array, *, source: str) -> NoisePart:
    """Fully correlated noise from one unknown: `direction` (n,) is its effect at one standard deviation.

    >>> common("gain", np.array([1.0, 2.0]), source="spec").covariance
    array([[1., 2.],
           [2., 4.]])
    """
    direction = np.asarray(direction, dtype=float)
    return NoisePart(name, np.outer(direction, direction), source, direction)


def of_groups(name: str, direction: Array, group: IntArray, *, source: str) -> NoisePart:
    """As `common`, but with one unknown for each group (n,) of data.

    >>> of_groups("depth", np.array([1.0, 2.0, 3.0]), np.array([0, 0, 1]), source="spec").covariance
    array([[1., 2., 0.],
           [2., 4., 0.],
           [0., 0., 9.]])
    """
    same = group[:, None] == group[None, :]
    return NoisePart(name, np.where(same, np.outer(direction, direction), 0.0), source)


def correlated(
    name: str, deviation: Array, order: Array, *, correlation: float, source: str
) -> NoisePart:  # fmt: skip
    """Noise correlated between neighbours: covariance sd_i sd_j correlation^|order_i - order_j|.

    >>> correlated("x", np.ones(2), np.array([0.0, 1.0]), correlation=0.5, source="spec").covariance
    array([[1. , 0.5],
           [0.5, 1. ]])
    """
    kernel = correlation ** np.abs(order[:, None] - order[None, :])
    return NoisePart(name, deviation[:, None] * kernel * deviation[None, :], source)


@dataclass(frozen=True)
class CommonError:
    """One unknown that many data have in common, in standard deviations of its prior.

    value : its estimate, 0 where the data do not determine it; deviation : its standard deviation, then 1
    """

    name: str
    value: float
    deviation: float


def common_errors(noise: Noise, whiten: Whitener, state: LinearFit) -> tuple[CommonError, ...]:
    """Estimates of all noise parts that are a single unknown, at a fit.

    whiten : of the whole noise; state : of the fit, whitened
    """
    found = []
    for part in noise.parts:
        if part.direction is None or not part.direction.any():
            continue
        seen = state.project(whiten(part.direction))
        left = max(1.0 - float(seen @ seen), 0.0)
        found.append(CommonError(part.name, float(seen @ state.residual), left**0.5))
    return tuple(found)
