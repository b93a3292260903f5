"""What is known of the noise: a covariance made of named parts, and where each came from.

Its size is stated, its law is not. Readings taken by hand err by more than three deviations far more often
than the normal law has it, and a true effect must not be ruled out for one slip: every test draws from
Student's t with `TAILS` degrees of freedom, scaled to the stated deviation.

Source: Lange, Little & Taylor 1989, J Am Stat Assoc 84:881 (t with few degrees of freedom for measured data);
Jeffreys 1961, Theory of Probability, section 5.7 (5 to 9 of them in long series of readings).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from limbcli.model import Array

ASSUMED = "assumed"
TAILS = 7.0
_KEPT_BYTES = 256 * 2**20  # of draws in memory
EXCESS = 6.0 / (TAILS - 4.0)  # kurtosis beyond the normal law's


def unit_errors(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Independent errors of mean 0 and deviation 1, with the tails of real readings.

    >>> errors = unit_errors(np.random.default_rng(7), (200_000,))
    >>> round(float(errors.std()), 2), round(100 * float(np.mean(np.abs(errors) > 3)), 1)
    (1.0, 0.9)
    """
    return rng.standard_t(TAILS, shape) * np.sqrt((TAILS - 2.0) / TAILS)


@dataclass(frozen=True, eq=False)
class ErrorDraws:
    """Batches of independent errors (`unit_errors`), the same whenever they are asked for.

    seed : fixes all of them; n_data : errors in a draw; size : draws in a batch
    """

    seed: tuple[int, ...]
    n_data: int
    size: int
    _kept: dict[int, NDArray[np.float32]] = field(default_factory=dict)

    def batch(self, k: int) -> NDArray[np.float32]:
        """(size, n_data), in single precision: more digits than a test by draws has use for."""
        if k not in self._kept:
            rng = np.random.default_rng([*self.seed, k])
            drawn = unit_errors(rng, (self.size, self.n_data)).astype(np.float32)
            if (len(self._kept) + 1) * drawn.nbytes > _KEPT_BYTES:
                return drawn
            self._kept[k] = drawn
        return self._kept[k]


@dataclass(frozen=True, eq=False)
class NoisePart:
    """One cause of noise: covariance (n, n) and source ("repeats", "spec", "assumed", "computed", or
    "estimated" from the data)."""

    name: str
    covariance: Array
    source: str


@dataclass(frozen=True, eq=False)
class Noise:
    """The sum of independent parts."""

    parts: tuple[NoisePart, ...]

    @cached_property
    def covariance(self) -> Array:
        """(n, n), the same array every time."""
        return np.asarray(sum(part.covariance for part in self.parts))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parts that are not nothing."""
        return tuple(part.name for part in self.parts if part.covariance.any())

    def with_share(self, name: str, share: float) -> Noise:
        """The part `name` times `share`, as it was estimated; others as they are."""
        return Noise(
            tuple(
                NoisePart(name, share**2 * part.covariance, "estimated") if part.name == name else part
                for part in self.parts
            )
        )

    @property
    def is_assumed(self) -> bool:
        """No absolute test can be made of the measurement's own noise."""
        return any(part.source == ASSUMED and part.name.startswith("measurement") for part in self.parts)

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
    """One unknown that moves all data together: `direction` (n,) is its effect at one standard deviation.

    >>> common("gain", np.array([1.0, 2.0]), source="spec").covariance
    array([[1., 2.],
           [2., 4.]])
    """
    direction = np.asarray(direction, dtype=float)
    return NoisePart(name, np.outer(direction, direction), source)


def correlated(
    name: str, deviation: Array, order: Array, *, correlation: float, source: str
) -> NoisePart:  # fmt: skip
    """Neighbours err alike: covariance sd_i sd_j correlation^|order_i - order_j|; NaN order: independent.

    >>> correlated("x", np.ones(2), np.array([0.0, 1.0]), correlation=0.5, source="spec").covariance
    array([[1. , 0.5],
           [0.5, 1. ]])
    """
    distance = np.abs(order[:, None] - order[None, :])
    kernel = np.where(np.isfinite(distance), correlation ** np.nan_to_num(distance, nan=0.0), 0.0)
    kernel[np.isnan(distance)] = 0.0
    np.fill_diagonal(kernel, 1.0)
    return NoisePart(name, deviation[:, None] * kernel * deviation[None, :], source)


def numerical(name: str, differences: Sequence[Array]) -> NoisePart:
    """The model's own error: each difference (n,) between two meshes is one deviation of a common unknown.

    >>> numerical("mesh", [np.array([1.0, 0.0]), np.array([0.0, 2.0])]).covariance
    array([[1., 0.],
           [0., 4.]])
    """
    stacked = np.array(differences, dtype=float)
    return NoisePart(name, stacked.T @ stacked, "computed")
