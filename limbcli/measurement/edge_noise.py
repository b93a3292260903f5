"""How well a layer's edges were marked, determined by the marks themselves.

A layer shortens under the probe; where a table says that it grew, the marks were wrong. So what is read of a
layer is taken as a true shortening, exponentially distributed over people, plus Gaussian noise: the
exponentially modified Gaussian, whose Gaussian part is found by greatest likelihood. Its left flank, the
negative values, holds nearly all that the data know of the noise.

Source: Grushka 1972, Anal Chem 44:1733 (the distribution).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_ndtr

from limbcli.model import Array

ASSUMED_EDGE = 0.1  # mm, one deviation of an edge, where no layer gives it
_FEWEST_NEGATIVE = 5
_FIRST_SIMPLEX = np.array([[0.0, 0.0], [0.3, 0.0], [0.0, -0.3]])  # of ln deviation and ln mean
_EDGES = 2.0  # root of the four marks, two an image, behind a shortening


@dataclass(frozen=True, eq=False)
class EdgeNoise:
    """shortened (3,): deviation (mm) of skin's, fat's, muscle's shortening; from_data (3,): the table's."""

    shortened: Array
    from_data: Array

    @property
    def edge(self) -> Array:
        """(3,) mm: of one marked edge, if the four behind a shortening are alike."""
        return self.shortened / _EDGES


def layer_noise(shortened: Array) -> EdgeNoise:
    """From shortenings (n_rows, n_layers) mm. A layer that never grows takes the largest of the others."""
    n = shortened.shape[1]
    found, known = np.zeros(n), np.zeros(n, dtype=bool)
    for j in range(n):
        values = shortened[:, j]
        if (values < 0).sum() >= _FEWEST_NEGATIVE:
            found[j], known[j] = gaussian_part(values), True
    found[~known] = found[known].max() if known.any() else _EDGES * ASSUMED_EDGE
    return EdgeNoise(found, known)


def gaussian_part(values: Array) -> float:
    """Deviation of the Gaussian in an exponentially modified Gaussian that starts at 0: values (n,).

    >>> rng = np.random.default_rng(7)
    >>> values = rng.exponential(0.8, 3000) + rng.normal(0.0, 0.2, 3000)
    >>> bool(abs(gaussian_part(values) - 0.2) < 0.03)
    True
    """
    scale = float(np.mean(np.abs(values)))
    if scale == 0.0:
        return 0.0
    relative = values / scale  # so that a search that ends at a tolerance ends alike in any unit

    def cost(theta: Array) -> float:
        sigma, mean = np.exp(theta)
        ratio = sigma / mean
        # ln of the density: exponential of mean `mean`, convolved with N(0, sigma^2)
        logs = -np.log(mean) + 0.5 * ratio**2 - relative / mean + log_ndtr(relative / sigma - ratio)
        return -float(logs.mean())

    negative = relative[relative < 0]
    start = float(np.sqrt(np.mean(negative**2))) if len(negative) else 0.1
    first = np.array([np.log(max(start, 1e-4)), 0.0])
    best = minimize(cost, first, method="Nelder-Mead", options={
        "initial_simplex": first + _FIRST_SIMPLEX, "xatol": 1e-4, "fatol": 1e-9,
    })  # fmt: skip
    return scale * float(np.exp(best.x[0]))
