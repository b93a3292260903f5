"""Interface between the diagnosis and the simulations: the `ForwardModel` protocol and its data types."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from limbcli.diagnosis.explanations.noise import LinearFit, Noise
from limbcli.model import Array
from limbcli.numbers.whitening import Whitener

Mask = NDArray[np.bool_]

Explanation = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Data:
    """The measured data, stacked into one vector.

    y : (n,); channel : of every datum; order : (n,) position along its channel (level number)
    groups, blocks : name -> (n,) bool, the parts tested to localise a misfit, and those to be held out
    series : of every datum, the levels it belongs to (a channel, one part of its maps); empty: the channel
    place : (n, 2) mm in an image, NaN for data without a position in an image
    """

    y: Array
    channel: tuple[str, ...]
    order: Array
    noise: Noise
    groups: Mapping[str, Mask] = field(default_factory=dict)
    blocks: Mapping[str, Mask] = field(default_factory=dict)
    series: tuple[str, ...] = ()
    place: Array | None = None

    def __len__(self) -> int:
        return len(self.y)

    @property
    def deviation(self) -> Array:
        return np.asarray(np.sqrt(np.diag(self.noise.covariance)))

    @property
    def imaged(self) -> Mask:
        """Mask (n,) of the data that have a position in an image."""
        if self.place is None:
            return np.zeros(len(self), dtype=bool)
        return np.asarray(np.isfinite(self.place).all(axis=1))

    def channels(self) -> dict[str, Mask]:
        return _masks(self.channel)

    def all_series(self) -> dict[str, Mask]:
        """Mask (n,) of each series: the data of one quantity at successive levels."""
        return _masks(self.series or self.channel)


def _masks(labels: Sequence[str]) -> dict[str, Mask]:
    return {name: np.array([each == name for each in labels]) for name in dict.fromkeys(labels)}


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
class Direction:
    """Sensitivities `columns` (n, q), not whitened, to the sizes of an effect at its null value, whose priors
    are by name; point : of the effect's grid; at : initial values of the fitted grid parameters there"""

    columns: Array
    priors: Mapping[str, Prior]
    point: str = ""
    at: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Priors:
    """Priors of all fitted parameters, about the values that were fitted.

    precision : (p,) reciprocal variance; of a uniform prior, that of the normal one with the same height in
        its middle: a parameter that the data do not determine then neither gains nor loses probability
    shift : (p,) mean less fitted value, 0 where uniform; low, high : (p,) limits less fitted value; is_normal
        : (p,)
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
        rows = [(each.mean, each.deviation, each.low, each.high) for each in priors]
        mean, deviation, low, high = np.array(rows).reshape(-1, 4).T
        normal = np.isfinite(deviation)
        precision = np.where(normal, deviation**-2.0, 2 * math.pi / (high - low) ** 2)
        shift = np.where(normal, mean - values, 0.0)
        return Priors(precision, shift, low - values, high - values, normal)


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model fitted to the data, with some effects in it.

    prediction : (n,); jacobian : (n, p) by the base parameters (in logs), then the effects' in the order of
        the explanation, as are the priors
    values : of all parameters by name; at_bound : a message for those that ended on a bound of what is
        possible
    point : of the effects' grids; ln_points : ln of the mean likelihood over these, relative to that of this
        one
    without : (n,) prediction without the effects whose form is only approximate; None if there are none
    amplification : (n,) how many times an error of the model shows in each datum, as near the cut-off of
        guided waves; None: once
    """

    explanation: Explanation
    prediction: Array
    jacobian: Array
    base_names: tuple[str, ...]
    values: Mapping[str, float]
    effect_names: tuple[str, ...] = ()
    at_bound: Mapping[str, str] = field(default_factory=dict)
    point: str = ""
    without: Array | None = None
    priors: Priors = field(default_factory=lambda: Priors.about(np.zeros(0), ()))
    ln_points: float = 0.0
    amplification: Array | None = None

    def whitened(self, y: Array, whiten: Whitener, *, as_it_stands: bool = False) -> LinearFit:
        """The fit to the data y (n,)."""
        residual, jacobian = whiten(y - self.prediction), whiten(self.jacobian)
        return LinearFit.of(residual, jacobian, as_it_stands=as_it_stands)


@dataclass(frozen=True)
class Scalable:
    """A part of the noise whose standard deviation is between `least` and `most` of what is assumed."""

    name: str
    least: float
    most: float = 1.0


@dataclass(frozen=True)
class Facts:
    """A candidate effect.

    typical : by parameter, a plausible size as distance from the null value (for blind spots)
    simulated : whether what it does is obtained from a simulation that includes it
    """

    name: str
    sentence: str
    kind: str
    typical: Mapping[str, float] = field(default_factory=dict)
    simulated: bool = True


@dataclass(frozen=True, eq=False)
class Proposal:
    """A possible further measurement, and what each explanation predicts for it.

    seen : by explanation, prediction (m,) and its Jacobian (m, same columns as that Fitted's)
    covariance : (m, m)
    """

    name: str
    sentence: str
    seen: Mapping[Explanation, tuple[Array, Array]]
    covariance: Array


class ForwardModel(Protocol):
    """Forward model of one data set. Raises LimbError where it has no solution; the diagnosis then reports
    the candidate as not evaluated."""

    @property
    def data(self) -> Data: ...

    @property
    def candidates(self) -> Sequence[Facts]: ...

    @property
    def scalable(self) -> Sequence[Scalable]:
        """Errors of the model whose size is estimated in every explanation."""
        ...

    def fit(self, explanation: Explanation, start: Mapping[str, float]) -> Fitted:
        """Fit the model with these effects; `start`: initial guesses of the effect parameters.

        Where simulations are expensive this may be a fit of the surrogate, which `verified` then checks.
        """
        ...

    def verified(self, fitted: Fitted) -> Fitted | None:
        """The same fit, with its numbers taken from a simulation of the fitted model; None if that would be
        too much work."""
        ...

    def directions(self, fitted: Fitted, name: str) -> Sequence[Direction]:
        """Sensitivities (not whitened) of the prediction to one additional effect at its null value."""
        ...

    def proposals(self, fits: Sequence[Fitted]) -> Sequence[Proposal]:
        """Possible further measurements, with the prediction of each of these fits."""
        ...
