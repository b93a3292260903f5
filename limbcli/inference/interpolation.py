"""PCHIP interpolation of a simulated curve, with the derivative of the result by the curve's values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.errors import FitError
from limbcli.inference.monotone_interpolation import Monotone
from limbcli.model import Array


@dataclass(frozen=True, eq=False)
class Sample:
    """A curve evaluated at given places.

    values : (n,)
    slopes : (n,) d value / d place
    weights : (n, n_knots) d value / d knot value
    """

    values: Array
    slopes: Array
    weights: Array


def pchip_sample(knots: Array, values: Array, places: Array) -> Sample:
    """Evaluate the shape-preserving piecewise cubic through (knots, values) at `places`.

    The same curve as `Monotone`, `scipy.interpolate.PchipInterpolator` and MATLAB's `pchip`.

    Parameters
    ----------
    knots : (n_knots,) strictly increasing, n_knots >= 2
    values : (n_knots,)
    places : (n,) within the knots

    Raises
    ------
    FitError
        If the knots do not increase, or a place lies outside them.

    >>> sample = pchip_sample(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 4.0]), np.array([0.5, 2.0]))
    >>> sample.values
    array([0.3125, 4.    ])
    """
    _check(knots, values, places)
    return Sample(*Monotone.through(knots, values).read(places))


def pchip_inverse(knots: Array, values: Array, wanted: Array) -> Array:
    """Places within the knots at which the curve through increasing values equals `wanted`.

    >>> pchip_inverse(np.arange(4.0), 2 * np.arange(4.0), np.array([0.0, 3.0, 9.0])).round(9)
    array([0. , 1.5, 3. ])
    """
    return Monotone.through(knots, values).inverse(wanted)


def _check(knots: Array, values: Array, places: Array) -> None:
    if len(knots) < 2 or len(knots) != len(values) or np.any(knots[1:] <= knots[:-1]):
        raise FitError(
            "the simulated curve's depths do not increase",
            where=f"{len(knots)} points",
            fix="check force-depth.csv of the run: it must contain every depth level once",
        )
    slack = 1e-9 * max(1.0, float(np.abs(knots).max()))
    if np.any(places < knots[0] - slack) or np.any(places > knots[-1] + slack):
        raise FitError(
            f"a measured depth lies outside the simulated {knots[0]:.3f} to {knots[-1]:.3f} mm",
            where=f"measured {places.min():.3f} to {places.max():.3f} mm",
            fix="build the model again so that its load covers the measurement: limbcli build-feb",
        )
