"""What an effect is: a physical sentence, its parameters, and pure changes to model or reading."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from limbcli.effects.reading import Reading
from limbcli.model import LimbModel

Theta = Mapping[str, float]
Kind = Literal["numerical", "measurement", "tissue", "swe"]
TISSUE = "tissue"


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect; its name carries its unit where it has one.

    null : the value without the effect; start : where a fit begins; low, high : bounds
    typical : a plausible value when the effect is there (for what stays unseen)
    prior : what is known of its size, with the source
    """

    name: str
    null: float
    start: float
    low: float
    high: float
    typical: float
    prior: str = ""

    @property
    def sign(self) -> int:
        """+1 or -1 where the null value is a bound: the effect goes one way only; 0 otherwise."""
        return 1 if self.null <= self.low else -1 if self.null >= self.high else 0


def same_model(model: LimbModel, theta: Theta) -> LimbModel:
    """The model is not touched: the effect is in the reading."""
    return model


def same_reading(reading: Reading, theta: Theta) -> Reading:
    """The reading is not touched: the effect is in the model."""
    return reading


@dataclass(frozen=True)
class Effect:
    """One candidate missing effect.

    needs : channels without which nothing can be said of it: "force", "swe", "map", "travel",
        "skin-bone", "hold"
    grid : values of parameters that mean nothing at the null (a thickness, a place), tried in turn
    waves : the change of the law that the scanner's window sees, where that is not `apply`'s (a layer
        thinner than an element stiffens the whole element, and lies above the window)
    solves : the prediction needs a simulation with `apply`; otherwise `observe` is all of it
        (where both differ from the identity and `solves` is false, `apply` is what FEBio is given)
    febio_only : the reference solver refuses the model
    new_mesh : `apply` moves nodes or elements
    spreads : it spreads the load, so that much of what it does to the speeds goes through the deformation
    onset : the grid's value that is a share of the levels: on those before it the effect is not there yet
    each_time : every measurement has its own size of it (an operator's or a tare's error); otherwise
        measurements of one place share it
    """

    name: str
    sentence: str
    kind: Kind
    source: str
    parameters: tuple[Parameter, ...] = ()
    needs: tuple[str, ...] = ("force",)
    apply: Callable[[LimbModel, Theta], LimbModel] = same_model
    observe: Callable[[Reading, Theta], Reading] = same_reading
    waves: Callable[[LimbModel, Theta], LimbModel] | None = None
    grid: tuple[Theta, ...] = field(default=({},))
    solves: bool = False
    febio_only: bool = False
    new_mesh: bool = False
    spreads: bool = False
    onset: str = ""
    each_time: bool = False
    tell_tale: str = ""

    @property
    def null(self) -> dict[str, float]:
        return {each.name: each.null for each in self.parameters}

    @property
    def start(self) -> dict[str, float]:
        return {**self.grid[0], **{each.name: each.start for each in self.parameters}}

    @property
    def typical(self) -> dict[str, float]:
        return {**self.grid[0], **{each.name: each.typical for each in self.parameters}}

    def without_onset(self, point: Theta) -> dict[str, float]:
        """A point of the grid as the model takes it: when the effect sets in is no matter of the model."""
        return {name: value for name, value in point.items() if name != self.onset}


def applied(model: LimbModel, effects: Iterable[tuple[Effect, Theta]], *, waves: bool = False) -> LimbModel:
    """The model with these effects in it; as the shear waves in the scanner's window meet it, on request."""
    for effect, theta in effects:
        change = effect.waves if waves and effect.waves is not None else effect.apply
        model = change(model, theta)
    return model


def point_name(point: Theta) -> str:
    """
    >>> point_name({"thickness_mm": 8.0})
    'thickness_mm 8'
    """
    return ", ".join(f"{name} {value:g}" for name, value in point.items())
