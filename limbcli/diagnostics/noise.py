"""What is known of the noise: a covariance made of named parts, and where each came from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.model import Array

ASSUMED = "assumed"


@dataclass(frozen=True, eq=False)
class NoisePart:
    """One cause of noise: covariance (n, n) and source ("repeats", "spec", "assumed", "computed")."""

    name: str
    covariance: Array
    source: str


@dataclass(frozen=True, eq=False)
class Noise:
    """The sum of independent parts."""

    parts: tuple[NoisePart, ...]

    @property
    def covariance(self) -> Array:
        return np.asarray(sum(part.covariance for part in self.parts))

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
