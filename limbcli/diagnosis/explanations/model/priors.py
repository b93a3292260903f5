"""Prior distributions of the parameters of an explanation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limbcli.model import Array


@dataclass(frozen=True)
class Prior:
    """Normal about `mean` between `low` and `high`; uniform there if `deviation` is infinite."""

    mean: float
    deviation: float
    low: float = -math.inf
    high: float = math.inf

    @staticmethod
    def uniform(low: float, high: float) -> Prior:
        return Prior(0.5 * (low + high), math.inf, low, high)


@dataclass(frozen=True, eq=False)
class Priors:
    """Priors of all fitted parameters, about the values that were fitted.

    Parameters
    ----------
    precision : (p,) reciprocal variance. Of a uniform prior, that of the normal distribution with the same
    height
        in its middle: a parameter that the data do not determine then neither gains nor loses probability.
    shift : (p,) mean less fitted value; 0 where the prior is uniform
    low, high : (p,) limits less fitted value
    is_normal : (p,) mask; the others are uniform
    """

    precision: Array
    shift: Array
    low: Array
    high: Array
    is_normal: NDArray[np.bool_]

    @staticmethod
    def about(values: Array, priors: tuple[Prior, ...]) -> Priors:
        """
        >>> found = Priors.about(np.array([1.0, 2.0]), (Prior(0.0, 2.0), Prior.uniform(0.0, 4.0)))
        >>> found.precision.round(3).tolist(), found.shift.tolist(), found.high.tolist()
        ([0.25, 0.393], [-1.0, 0.0], [inf, 2.0])
        """
        precision, shift = np.zeros(len(priors)), np.zeros(len(priors))
        for k, each in enumerate(priors):
            if math.isfinite(each.deviation):
                precision[k], shift[k] = each.deviation**-2, each.mean - values[k]
            else:
                precision[k] = 2 * math.pi / (each.high - each.low) ** 2
        low, high = (np.array([getattr(each, end) for each in priors]) - values for end in ("low", "high"))
        return Priors(
            precision, shift, low, high, np.array([math.isfinite(each.deviation) for each in priors])
        )
