"""Definition of an effect: a sentence of physics, its parameters, and pure changes of model or reading."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from limbcli.effects.reading import Reading
from limbcli.effects.stiffness_places import Places, Stiffness, stiffened
from limbcli.model import Array, LimbModel

Theta = Mapping[str, float]
Kind = Literal["numerical", "measurement", "tissue", "swe"]
NUMERICAL: Kind = "numerical"  # effects of mesh, cut and contact: always examined first


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect; its name includes its unit if it has one.

    null : the value without the effect
    start : initial guess of a fit
    low, high : bounds
    typical : a plausible value if the effect is present (used for effects that the data cannot show)
    prior : what is known of its size, with the source
    shape : it is undefined without the effect (a place, a thickness), so it has no null value of its own
        (`null` is `start`) and is fitted from the points of the effect's grid
    natural_bounds : values beyond `low` and `high` are impossible (a fraction of 0 or 1), so a fit may end
        there
    both_sides : its effects on the two sides of null are not opposite, so a simulated effect is solved on
        both
    saturates : distance from `null` over which its effect levels off, as 1 - exp(-distance / saturates);
        None: its effect is proportional to the distance
    looked_at : fraction of the way from `null` to `start` at which its influence near null is evaluated
    needs : channels without which it stays at null, as nothing tells it from the effect's other parameters
    reported : name, with its unit, of the quantity by which its size is reported; empty: its own
    turn : that quantity for a value of the parameter and c in kPa; None: the value itself
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
    both_sides: bool = False
    needs: tuple[str, ...] = ()
    reported: str = ""
    turn: Callable[[float, float], float] | None = None

    @staticmethod
    def of_shape(name: str, start: float, low: float, high: float, prior: str = "") -> Parameter:
        return Parameter(name, start, start, low, high, start, prior, True)

    @property
    def step(self) -> float:
        """Change at which its influence is evaluated: from null to the start value, or for a shape a tenth of
        its range."""
        if self.shape:
            return 0.1 * (self.high - self.low)
        return max(abs(self.start - self.null), 1e-6)

    def proportional(self, value: float) -> float:
        """Quantity to which the effect of this value is proportional; near null it equals the distance from
        null.

        >>> Parameter("mu", 0.0, 0.2, 0.0, 1.0, 0.15, saturates=0.2).proportional(0.2)  # 0.2 (1 - 1 / e)
        0.126...
        """
        distance = value - self.null
        return (
            distance if self.saturates is None else -self.saturates * math.expm1(-distance / self.saturates)
        )

    def quantity(self, value: float, c_kpa: float) -> float:
        """The reported quantity for a value, in a tissue with this c."""
        return value if self.turn is None else self.turn(value, c_kpa)

    @property
    def sign(self) -> int:
        """+1 or -1 where the null value is a bound, so the effect has one direction only; otherwise 0."""
        if self.shape:
            return 0
        return 1 if self.null <= self.low else -1 if self.null >= self.high else 0


def times_c(value: float, c_kpa: float) -> float:
    """kPa, of a value relative to c (`Parameter.turn`)."""
    return value * c_kpa


def exponential(value: float, c_kpa: float) -> float:
    """A ratio, of its logarithm (`Parameter.turn`)."""
    return math.exp(value)


def adds_to(field: str, parameter: Parameter) -> Callable[[Reading, Theta], Reading]:
    """The change of a reading by a parameter that is added to this field of it."""
    return lambda reading, theta: _with_field(reading, field, getattr(reading, field) + theta[parameter.name])


def multiplies(field: str, parameter: Parameter) -> Callable[[Reading, Theta], Reading]:
    """The change of a reading by a parameter that is a factor on this field of it."""
    return lambda reading, theta: _with_field(reading, field, getattr(reading, field) * theta[parameter.name])


def _with_field(reading: Reading, field: str, value: float) -> Reading:
    return replace(reading, **{field: value})  # type: ignore[arg-type]


def same_model(model: LimbModel, theta: Theta) -> LimbModel:
    """The unchanged model, for effects on the reading."""
    return model


def same_reading(reading: Reading, theta: Theta) -> Reading:
    """The unchanged reading, for effects on the model."""
    return reading


@dataclass(frozen=True)
class Effect:
    """One candidate missing effect.

    needs : channels without which it cannot be assessed: "force", "swe", "map", "travel", "skin-bone",
        "hold"; "bone": a bone under the probe, in the model
    grid : values, tried in turn, of parameters that are undefined at the null (a time constant, a place); for
        those declared with `shape` they are only the initial guess of a fit
    stiffness : the field by which the effect multiplies all stiffnesses of the tissue, if it does so; `apply`
        follows from it unless it is given
    waves : change of the law as seen in the scanner's window, where it differs from `apply` (a layer thinner
        than an element stiffens the whole element, but lies above the window)
    solves : the prediction needs a simulation with `apply`; otherwise `observe` is sufficient (where both
        differ from the identity and `solves` is false, `apply` is what FEBio is given)
    febio_only : the reference solver does not support the model
    new_mesh : `apply` moves nodes or elements
    spreads : it spreads the load, so that a large part of its effect on the speeds is due to the changed
        deformation
    onset : name of the grid value that is a fraction of the levels; at the levels before it the effect is
        absent
    each_time : its size differs between measurements (an error of the operator or the tare); otherwise
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

    def __post_init__(self) -> None:
        if self.stiffness is not None and self.apply is same_model:
            object.__setattr__(self, "apply", self._stiffened)

    def _stiffened(self, model: LimbModel, theta: Theta) -> LimbModel:
        if all(theta[each.name] == each.null for each in self.sizes):
            return model
        return stiffened(model, self.factor(theta))

    def factor(self, theta: Theta) -> Stiffness:
        """Its field of stiffness at these values of its parameters."""
        stiffness = self.stiffness
        assert stiffness is not None
        return lambda places: stiffness(places, theta)

    @property
    def sizes(self) -> tuple[Parameter, ...]:
        """The parameters that have a null value; with all of them at null there is no effect."""
        return tuple(each for each in self.parameters if not each.shape)

    def measured_by(self, channels: Collection[str]) -> Effect:
        """The effect with the parameters that these channels can tell (`Parameter.needs`)."""
        told = tuple(each for each in self.parameters if set(each.needs) <= set(channels))
        return self if len(told) == len(self.parameters) else replace(self, parameters=told)

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
        """The values of a grid point that a fit starts from and then changes."""
        names = {each.name for each in self.parameters}
        return {name: value for name, value in point.items() if name in names}

    def held(self, point: Theta) -> dict[str, float]:
        """The values of a grid point that stay fixed."""
        names = {each.name for each in self.parameters}
        return {name: value for name, value in point.items() if name not in names}

    def without_onset(self, point: Theta) -> dict[str, float]:
        """A grid point without the onset, which the model does not use."""
        return {name: value for name, value in point.items() if name != self.onset}


def applied(model: LimbModel, effects: Iterable[tuple[Effect, Theta]], *, waves: bool = False) -> LimbModel:
    """The model with these effects applied in the given order; with `waves`, as seen by shear waves in the
    scanner's window.

    Factors on all stiffnesses are applied last: the other effects are given relative to the tissue's c and
    are scaled with it.
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
