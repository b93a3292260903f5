"""Estimate the noise of marked layer edges from the marks themselves.

A layer shortens under the probe; if a table says that it grew, the marks were wrong. The measured shortening
is therefore modelled as a true shortening, exponentially distributed over people, plus Gaussian noise: the
exponentially modified Gaussian, whose Gaussian part is estimated by maximum likelihood. Its left flank, the
negative values, contains nearly all the information about the noise.

Source: Grushka 1972, Anal Chem 44:1733 (the distribution).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_ndtr

from limbcli.model import Array

ASSUMED_EDGE = 0.1  # mm, standard deviation of an edge, used if no layer determines it
_FEWEST_NEGATIVE = 5
# initial simplex of ln standard deviation and ln mean
_FIRST_SIMPLEX = np.array([[0.0, 0.0], [0.3, 0.0], [0.0, -0.3]])
_EDGES = 2.0  # square root of the four marks, two per image, that determine a shortening


@dataclass(frozen=True, eq=False)
class EdgeNoise:
    """Noise of the shortenings of skin, fat and muscle.

    shortened (3,) : standard deviation, mm; from_data (3,) : whether it was determined from the table
    """

    shortened: Array
    from_data: Array

    @property
    def edge(self) -> Array:
        """Standard deviation (3,), mm, of one marked edge, assuming equal noise of the four of a
        shortening.
        """
        return self.shortened / _EDGES


def layer_noise(shortened: Array) -> EdgeNoise:
    """Noise from shortenings (n_rows, n_layers), mm.

    A layer that never grows takes the largest noise of the others.
    """
    n = shortened.shape[1]
    found, known = np.zeros(n), np.zeros(n, dtype=bool)
    for j in range(n):
        values = shortened[:, j]
        if (values < 0).sum() >= _FEWEST_NEGATIVE:
            found[j], known[j] = gaussian_part(values), True
    found[~known] = found[known].max() if known.any() else _EDGES * ASSUMED_EDGE
    return EdgeNoise(found, known)


def gaussian_part(values: Array) -> float:
    """Standard deviation of the Gaussian in an exponentially modified Gaussian starting at 0; values (n,).

    >>> rng = np.random.default_rng(7)
    >>> values = rng.exponential(0.8, 3000) + rng.normal(0.0, 0.2, 3000)
    >>> bool(abs(gaussian_part(values) - 0.2) < 0.03)
    True
    """
    scale = float(np.mean(np.abs(values)))
    if scale == 0.0:
        return 0.0
    # without the unit, nor the round-off that it leaves: where sigma is nearly 0 the cost is flat, and the
    # search would end elsewhere
    relative = np.round(values / scale, 6)

    def cost(theta: Array) -> float:
        sigma, mean = np.exp(theta)
        ratio = sigma / mean
        # log density of an exponential of mean `mean`, convolved with N(0, sigma^2)
        logs = -np.log(mean) + 0.5 * ratio**2 - relative / mean + log_ndtr(relative / sigma - ratio)
        return -float(logs.mean())

    negative = relative[relative < 0]
    start = float(np.sqrt(np.mean(negative**2))) if len(negative) else 0.1
    first = np.array([np.log(max(start, 1e-4)), 0.0])
    best = minimize(cost, first, method="Nelder-Mead", options={
        "initial_simplex": first + _FIRST_SIMPLEX, "xatol": 1e-4, "fatol": 1e-9,
    })  # fmt: skip
    return scale * float(np.exp(best.x[0]))
