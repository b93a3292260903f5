"""What an effect is: a physical sentence, its parameters, and pure changes to model or reading."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from limbcli.effects.places import Places
from limbcli.effects.reading import Reading
from limbcli.model import Array, LimbModel

Theta = Mapping[str, float]
Kind = Literal["numerical", "measurement", "tissue", "swe"]
NUMERICAL: Kind = "numerical"  # what mesh, cut and contact do: looked at first in any case


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect; its name carries its unit where it has one.

    null : the value without the effect; start : where a fit begins; low, high : bounds
    typical : a plausible value when the effect is there (for what stays unseen)
    prior : what is known of its size, with the source
    shape : it means nothing at the effect's null (a place, a thickness): it has no null value of its own
        (`null` is `start`), and is fitted from the points of the effect's grid
    natural_bounds : nothing lies beyond `low` and `high` (a share of 0 or 1): a fit may end there
    both_sides : what it changes on one side of null is not the opposite of what it changes on the other, so
        that a simulated effect is solved on either
    extent : a shape that says how far the effect reaches: as large as can be it makes another effect of it
    saturates : distance from `null` over which what it changes levels off, as 1 - exp(-distance / saturates);
        None: it changes things in proportion
    looked_at : the share of the way from `null` to `start` over which its influence at the null is looked at
    """

    name: str
    null: float
    start: float
    low: float
    high: float
    typical: float
    prior: str = ""
    shape: bool = False
    natural_bounds: bool = False
    saturates: float | None = None
    looked_at: float = 0.02
    extent: bool = False
    both_sides: bool = False

    @staticmethod
    def of_shape(
        name: str, start: float, low: float, high: float, prior: str = "", *, extent: bool = False
    ) -> Parameter:
        return Parameter(name, start, start, low, high, start, prior, True, extent=extent)

    @property
    def step(self) -> float:
        """By how much it moves when its influence is looked at: to a fit's start, or a part of its range."""
        if self.shape:
            return 0.1 * (self.high - self.low)
        return max(abs(self.start - self.null), 1e-6)

    def proportional(self, value: float) -> float:
        """What grows in proportion to the change that this value makes; near null its distance from it.

        >>> Parameter("mu", 0.0, 0.2, 0.0, 1.0, 0.15, saturates=0.2).proportional(0.2)  # 0.2 (1 - 1 / e)
        0.126...
        """
        distance = value - self.null
        return (
            distance if self.saturates is None else -self.saturates * math.expm1(-distance / self.saturates)
        )

    def from_proportional(self, x: float) -> float:
        """The value that changes things by as much; infinite where none does."""
        if self.saturates is None:
            return self.null + x
        if x >= self.saturates:
            return math.inf
        return self.null - self.saturates * math.log1p(-x / self.saturates)

    @property
    def sign(self) -> int:
        """+1 or -1 where the null value is a bound: the effect goes one way only; 0 otherwise."""
        if self.shape:
            return 0
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

    needs : channels without which it cannot be judged: "force", "swe", "map", "travel",
        "skin-bone", "hold"; "bone": one under the probe, in the model
    grid : values of parameters that mean nothing at the null (a time constant, a place), tried in turn;
        of those with a `shape` a fit only begins there
    stiffness : where the effect is a factor on all stiffnesses of the tissue: that factor, over places;
        `apply` then follows from it
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
    stiffness: Callable[[Places, Theta], Array] | None = None
    solves: bool = False
    febio_only: bool = False
    new_mesh: bool = False
    spreads: bool = False
    onset: str = ""
    each_time: bool = False
    tell_tale: str = ""

    @property
    def sizes(self) -> tuple[Parameter, ...]:
        """The parameters that have a null value: without them there is no effect."""
        return tuple(each for each in self.parameters if not each.shape)

    @property
    def null(self) -> dict[str, float]:
        return {each.name: each.null for each in self.parameters}

    @property
    def start(self) -> dict[str, float]:
        return {**{each.name: each.start for each in self.parameters}, **self.grid[0]}

    @property
    def typical(self) -> dict[str, float]:
        return {**{each.name: each.typical for each in self.parameters}, **self.grid[0]}

    def free(self, point: Theta) -> dict[str, float]:
        """What of a point of the grid a fit begins with, and then moves."""
        names = {each.name for each in self.parameters}
        return {name: value for name, value in point.items() if name in names}

    def held(self, point: Theta) -> dict[str, float]:
        """What of a point of the grid stays as it is."""
        names = {each.name for each in self.parameters}
        return {name: value for name, value in point.items() if name not in names}

    def without_onset(self, point: Theta) -> dict[str, float]:
        """A point of the grid as the model takes it: when the effect sets in is no matter of the model."""
        return {name: value for name, value in point.items() if name != self.onset}


def applied(model: LimbModel, effects: Iterable[tuple[Effect, Theta]], *, waves: bool = False) -> LimbModel:
    """The model with these effects in it, in whatever order they come; as the shear waves in the scanner's
    window meet it, on request.

    Factors on all stiffnesses come last: the others are given in terms of the tissue's c, and are stiffened
    and softened with it.
    """
    for effect, theta in sorted(effects, key=lambda each: each[0].stiffness is not None):
        change = effect.waves if waves and effect.waves is not None else effect.apply
        model = change(model, theta)
    return model


def point_name(point: Theta) -> str:
    """
    >>> point_name({"thickness_mm": 8.0})
    'thickness_mm 8'
    """
    return ", ".join(f"{name} {value:g}" for name, value in point.items())
