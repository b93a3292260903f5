"""Modes of a curve over depth, given at knots."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def at_depths(modes: Array, knots: Array, depth: Array) -> Array:
    """Modes (n_modes, n_knots) of ln force interpolated at measured depths (n,): (n, n_modes); constant
    before the first knot.

    >>> at_depths(np.array([[0.1, 0.3]]), np.array([1.0, 3.0]), np.array([0.5, 2.0])).ravel()
    array([0.1, 0.2])
    """
    return np.stack([np.interp(depth, knots, each) for each in modes], axis=1)
