"""What the diagnosis asks of whoever can simulate: the `ForwardModel`, and the data it is about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from limbcli.diagnostics.model.estimates import Reported
from limbcli.diagnostics.model.noise import Noise
from limbcli.model import Array

Mask = NDArray[np.bool_]

Explanation = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Direction:
    """Whitened sensitivities `columns` (n, q) at the null; `signs` (q,): +1 up only, -1 down only, 0 either.

    `point` says which point of the effect's grid it is; `at`: where on it a fit begins.
    """

    columns: Array
    signs: tuple[int, ...]
    point: str = ""
    names: tuple[str, ...] = ()
    at: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Data:
    """What was measured, stacked.

    y : (n,); channel : of every datum; order : (n,) position along its channel (level number)
    groups : name -> (n,) bool, the parts to be localised (channel, site, third of the levels ...)
    blocks : name -> (n,) bool, the parts to be held out
    series : of every datum, what it is a level of (a channel, one part of its maps); empty: the channel
    place : (n, 2) mm in an image, NaN for what is in none
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

    def channels(self) -> dict[str, Mask]:
        """Mask (n,) of each channel."""
        return _masks(self.channel)

    def all_series(self) -> dict[str, Mask]:
        """Mask (n,) of each series: data that follow one another from level to level."""
        return _masks(self.series or self.channel)


def _masks(labels: Sequence[str]) -> dict[str, Mask]:
    return {name: np.array([each == name for each in labels]) for name in dict.fromkeys(labels)}


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model fitted to the data, with some effects in it.

    prediction : (n,); jacobian : (n, n_base + n_effect_parameters), the base parameters
    first (in logs), then the effects' in the order of the explanation
    values : of all parameters by name; at_bound : those that ended on a bound, or outside
    what is physically possible, in words
    without : (n,) the same tissue's prediction without the effects; None where there are none
    """

    explanation: Explanation
    prediction: Array
    jacobian: Array
    base_names: tuple[str, ...]
    values: Mapping[str, float]
    effect_names: tuple[str, ...] = ()
    at_bound: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    points: Mapping[str, str] = field(default_factory=dict)
    without: Array | None = None


@dataclass(frozen=True)
class Facts:
    """A candidate as the diagnosis sees it.

    typical : by parameter, a plausible size away from its null value (for blind spots)
    simulated : what it does is found by a simulation with it; else from those without it
    """

    name: str
    sentence: str
    kind: str
    typical: Mapping[str, float] = field(default_factory=dict)
    simulated: bool = True


@dataclass(frozen=True, eq=False)
class Proposal:
    """A measurement that could be added: what each explanation predicts for it.

    predictions : by explanation (m,); jacobians : (m, same columns as that Fitted's); covariance (m, m)
    """

    name: str
    sentence: str
    predictions: Mapping[Explanation, Array]
    jacobians: Mapping[Explanation, Array]
    covariance: Array


class ForwardModel(Protocol):
    """Answers for one set of data. Raises LimbError where there is no answer: then it is `not evaluated`."""

    @property
    def data(self) -> Data: ...

    @property
    def candidates(self) -> Sequence[Facts]: ...

    @property
    def interval_widening(self) -> float:
        """Times which intervals are widened, as errors of the model are taken at their likeliest."""
        ...

    def fit(self, explanation: Explanation, start: Mapping[str, float]) -> Fitted:
        """Fit the model with these effects in it; `start`: first guesses of effect parameters.

        Where a simulation is dear this may be a surrogate's fit; `verified` makes it good.
        """
        ...

    def verified(self, fitted: Fitted) -> Fitted:
        """The same fit, its numbers out of a simulation of the model as fitted."""
        ...

    def reported(self, fitted: Fitted, *, scale: float = 1.0, besides: Array | None = None) -> Reported:
        """What is reported of its parameters.

        scale : of the deviance, where the noise's level is not known; besides : covariance (n, n) of what
        the data have to allow for beside their noise
        """
        ...

    def directions(self, fitted: Fitted, name: str) -> Sequence[Direction]:
        """Sensitivities (not whitened) of the prediction to one more effect at its null value."""
        ...

    def proposals(self, fits: Sequence[Fitted]) -> Sequence[Proposal]:
        """Measurements that could be added, with what every one of these fits predicts."""
        ...
