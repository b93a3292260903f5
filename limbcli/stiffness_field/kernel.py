"""Covariance of the field between two places, and its random Fourier features.

    k = Matern 3/2 (height) x squared exponential (around) x Matern 3/2 (depth)

On the circle the middle factor is the periodic kernel exp(-2 sin^2(angle / 2) / l^2).

Source: Rasmussen and Williams 2006, Gaussian Processes for Machine Learning, eqs. 4.17 (Matern), 4.31
(periodic) and 4.15 (spectral density: of Matern 3/2 in one dimension a t distribution with 3 degrees of
freedom, of the squared exponential a normal one); Rahimi and Recht 2007, NeurIPS 20 (random features).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.model import Array
from limbcli.stiffness_field.coordinates import AnatomicalPlaces

_T_FREEDOM = 3  # twice the smoothness 3/2


@dataclass(frozen=True)
class Lengths:
    """Correlation lengths: height (mm), around (as a chord of the unit circle; about rad), depth (share of
    the way from skin to bone)."""

    height_mm: float
    around: float
    depth: float


class Between:
    """Correlations between two lists of places, for several lengths: each factor is computed once."""

    def __init__(self, a: AnatomicalPlaces, b: AnatomicalPlaces):
        self._height = np.abs(a.height[:, None] - b.height)
        self._chord = ((a.around[:, None] - b.around) ** 2).sum(axis=2)
        self._depth = np.abs(a.depth[:, None] - b.depth)
        self._known: dict[tuple[str, float], Array] = {}

    def correlation(self, lengths: Lengths) -> Array:
        """Correlation (n_a, n_b)."""
        height = self._once("height", lengths.height_mm)
        return np.asarray(height * self._once("around", lengths.around) * self._once("depth", lengths.depth))

    def _once(self, name: str, length: float) -> Array:
        if (name, length) not in self._known:
            if name == "around":
                found = np.exp(-0.5 * self._chord / length**2)
            else:
                scaled = np.sqrt(3.0) * ((self._height if name == "height" else self._depth) / length)
                found = (1.0 + scaled) * np.exp(-scaled)
            self._known[name, length] = found
        return self._known[name, length]


def correlation(a: AnatomicalPlaces, b: AnatomicalPlaces, lengths: Lengths) -> Array:
    """Correlation (n_a, n_b) between places."""
    return Between(a, b).correlation(lengths)


@dataclass(frozen=True, eq=False)
class Features:
    """Random frequencies (n, 4) of height (1/mm), around (2) and depth: functions sqrt(1/n) (cos, sin)."""

    frequencies: Array

    @classmethod
    def drawn(cls, n: int, lengths: Lengths, rng: np.random.Generator) -> Features:
        height = rng.standard_t(_T_FREEDOM, n) / lengths.height_mm
        around = rng.standard_normal((n, 2)) / lengths.around
        depth = rng.standard_t(_T_FREEDOM, n) / lengths.depth
        return cls(np.column_stack([height, around, depth]))

    def at(self, places: AnatomicalPlaces) -> Array:
        """Values (n_places, 2 n) whose products approximate the correlation."""
        phase = np.column_stack([places.height, places.around, places.depth]) @ self.frequencies.T
        return np.concatenate([np.cos(phase), np.sin(phase)], axis=1) / np.sqrt(len(self.frequencies))
