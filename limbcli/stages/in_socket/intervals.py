"""Pressure and shear of patches of the skin; their intervals over the limb's draws, from a few more solves.

Every quantity of the table is taken as a sum over ln c, ln m (their means over the limb), the friction, and
the socket's place on the limb (turned about and shifted along the two directions across it): linear in the
first three, by one solve each, one standard deviation away; a parabola in the others, by a solve on either
side, since a socket that is off presses one side and leaves the other. Another solve, with all of them one
deviation to one side, is held out and says how far the sum is off. How c varies from place to place within a
draw is not followed.

Source: the two places are the outer nodes of three-point Gauss-Hermite quadrature, Abramowitz & Stegun 1964,
table 25.10.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from limbcli.errors import SolveError
from limbcli.model import Array, ElementMap, LimbModel, Value
from limbcli.progress import Progress

WHOLE = "skin"  # name of the row of the whole skin
QUANTITIES = ("contact_area_mm2", "mean_kpa", "p95_kpa", "peak_kpa", "mean_shear_kpa", "peak_shear_kpa")

Interval = tuple[float, float]
ALIGNMENT = "alignment"
_POSE = ("tilt_sagittal", "tilt_frontal", "shift_across", "shift_front_back")
NAMES = ("c", "m", "friction", *_POSE)
_REACHES = (3**0.5, 1.0)  # standard deviations to either side; the second where the first has no equilibrium
_SEED = 7
_REPEATS = 40  # frictions and places drawn with every draw of the limb: 50 alone are off by a fifth
_LEAST = 1e-3  # deviations below this are none
_LEAST_FRICTION = 0.01
_ENDS = (2.5, 97.5)  # percentiles of a 95 % interval
# What the held-out solve may miss, of half an interval; and of the largest pressure, what does not matter
_ROUGH, _SLIGHT = 0.5, 0.05

Pose = tuple[float, float, float, float]
"""How far a socket is off its place: tilts about x and y of the upright frame, deg; shifts along them, mm."""


@dataclass(frozen=True, kw_only=True)
class PatchPressure:
    """A patch of the skin under one load; `load_n` 0: after donning; patch "skin": all of it.

    Attributes
    ----------
    area_mm2 : at rest
    contact_area_mm2 : current area of its facets under pressure
    mean_kpa, p95_kpa, mean_shear_kpa : over the area in contact
    peak_kpa, peak_shear_kpa : largest mean over one facet
    """

    load_n: float
    patch: str
    area_mm2: float
    contact_area_mm2: float
    mean_kpa: float
    p95_kpa: float
    peak_kpa: float
    mean_shear_kpa: float
    peak_shear_kpa: float


Solved = Callable[[LimbModel, float, Pose], list[PatchPressure]]


@dataclass(frozen=True, eq=False)
class PressureIntervals:
    """intervals : 95 %, by (load, patch, quantity); `error_fraction` : of the held-out solve, rms of all mean
    pressures relative to their largest; `rough` : load, patch and kPa of mean pressures that this solve
    misses by more than a quarter of their interval; `shares` : by load, what part of the variance of the mean
    pressure on the skin c, m, friction and alignment make; `n_solves` : besides the first; `one_sided` :
    places that are taken as lines, since their other side had no equilibrium
    """

    intervals: dict[tuple[float, str, str], Interval]
    error_fraction: float
    shares: dict[float, dict[str, float]]
    deviations: dict[str, float]
    n_solves: int
    one_sided: tuple[str, ...] = ()
    rough: tuple[tuple[float, str, float], ...] = ()


def drawn_values(
    path: Path, friction: float, deviation: float, *, tilt_deg: float = 0.0, shift_mm: float = 0.0
) -> Array:
    """ln c, ln m, friction and `Pose` (n, 7): of every draw of the limb with several of the others.

    path : draws.csv of the stage `limb`; deviation, tilt_deg, shift_mm : standard deviations
    """
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    logs = np.log([[float(row["c_mean_kpa"]), float(row["m_mean"])] for row in rows])
    logs, rng = np.repeat(logs, _REPEATS, axis=0), np.random.default_rng(_SEED)
    drawn = friction + deviation * rng.standard_normal(len(logs))
    frictions = np.maximum(drawn, _LEAST_FRICTION) if friction else np.zeros(len(logs))
    poses = rng.standard_normal((len(logs), len(_POSE))) * [tilt_deg, tilt_deg, shift_mm, shift_mm]
    return np.column_stack([logs, frictions, poses])


def pressure_intervals(
    limb: LimbModel, friction: float, base: Sequence[PatchPressure], drawn: Array, solved: Solved,
    progress: Progress,
) -> PressureIntervals:  # fmt: skip
    """Intervals of all quantities of the table.

    base : rows of the solve with the limb's own values; solved : the same rows for other values

    Raises SolveError if a solve has no equilibrium, with a changed place neither on one side nor on the
    other.
    """
    centre, deviations = drawn.mean(axis=0), drawn.std(axis=0, ddof=1)
    varied = [k for k in range(len(NAMES)) if deviations[k] > _LEAST]
    y = _values(base)
    solves = _Solves(
        limb, friction, solved, progress, len(varied) + sum(NAMES[k] in _POSE for k in varied) + 1
    )
    responses = [
        _response(y, np.eye(len(NAMES))[k] * deviations, solves, bent=NAMES[k] in _POSE) for k in varied
    ]
    actual = solves.at(-np.where(deviations > _LEAST, deviations, 0.0))
    predicted = y + sum((each(np.array([-1.0]))[0] for each in responses), np.zeros(len(y)))
    z = (drawn - centre)[:, varied] / deviations[varied]
    parts = np.empty((len(drawn), len(responses), len(y)))
    for k, response in enumerate(responses):
        parts[:, k] = response(z[:, k])
    total = parts.sum(axis=1)
    low, high = np.maximum(np.percentile(y + total, _ENDS, axis=0), 0.0)
    keys = [(row.load_n, row.patch, name) for row in base for name in QUANTITIES]
    means = [k for k, key in enumerate(keys) if key[2] == "mean_kpa"]
    off, largest = (predicted - actual)[means], max(np.abs(y[means]).max(), 1e-12)
    rough = np.abs(off) > np.maximum(_ROUGH / 2 * (high - low)[means], _SLIGHT * largest)
    shares = {
        keys[k][0]: _shares(parts[:, :, k], total[:, k], [NAMES[each] for each in varied])
        for k in means if keys[k][1] == WHOLE
    }  # fmt: skip
    return PressureIntervals(
        {key: (float(low[k]), float(high[k])) for k, key in enumerate(keys)},
        float(np.sqrt((off**2).mean()) / largest),
        shares,
        {name: float(each) for name, each in zip(("ln_c", "ln_m", *NAMES[2:]), deviations, strict=True)},
        solves.done,
        tuple(NAMES[k] for k, each in zip(varied, responses, strict=True) if each.one_sided),
        tuple((*keys[means[k]][:2], float(abs(off[k]))) for k in np.flatnonzero(rough)),
    )


@dataclass(eq=False)
class _Solves:
    """The table with changed values; counts the solves. n : how many there will be"""

    limb: LimbModel
    friction: float
    solved: Solved
    progress: Progress
    n: int
    done: int = 0

    def at(self, step: Array) -> Array:
        """All quantities (n_values,) with ln c, ln m, friction and the place changed by `step` (7,)."""
        self.progress.event("task", name="socket: solves for intervals", done=self.done, total=self.n)
        self.done += 1
        pose: Pose = tuple(step[3:].tolist())
        try:
            rows = self.solved(
                _changed(self.limb, *np.exp(step[:2])), max(self.friction + step[2], 0.0), pose
            )
        except SolveError as error:
            what = ", ".join(f"{name} {x:+.2g}" for name, x in zip(NAMES, step, strict=True) if x)
            raise SolveError(
                f"no intervals: the solve with changed {what}: {error.what}",
                where=error.where, fix=error.fix,
            ) from error  # fmt: skip
        return _values(rows)


@dataclass(frozen=True, eq=False)
class _Response:
    """How all quantities change along one parameter: slope z + bend z^2, z in standard deviations.

    one_sided : a line, since the other side had no equilibrium
    """

    slope: Array
    bend: Array
    one_sided: bool = False

    def __call__(self, z: Array) -> Array:
        """Changes (n, n_values) at z (n,)."""
        return z[:, None] * self.slope + z[:, None] ** 2 * self.bend


def _response(y: Array, step: Array, solves: _Solves, *, bent: bool) -> _Response:
    """y : of the limb's own values; step : one standard deviation; bent : a parabola from both sides"""
    if not bent:
        return _Response(solves.at(step) - y, np.zeros_like(y))
    found: dict[float, tuple[float, Array]] = {}
    for sign in (1.0, -1.0):
        try:
            found[sign] = _side(y, sign * step, solves)
        except SolveError:
            if sign < 0 and not found:
                raise
    if len(found) == 1:
        ((sign, (a, change)),) = found.items()
        return _Response(sign * change / a, np.zeros_like(y), one_sided=True)
    (a, up), (b, down) = found.values()
    bend = (up / a + down / b) / (a + b)
    return _Response(up / a - a * bend, bend)


def _side(y: Array, step: Array, solves: _Solves) -> tuple[float, Array]:
    """How many standard deviations away a solve was possible, and the changes (n_values,) there."""
    far, near = _REACHES
    try:
        return far, solves.at(far * step) - y
    except SolveError:
        solves.n += 1
        return near, solves.at(near * step) - y


def _values(rows: Sequence[PatchPressure]) -> Array:
    return np.array([getattr(row, name) for row in rows for name in QUANTITIES])


def _shares(parts: Array, total: Array, names: Sequence[str]) -> dict[str, float]:
    """The covariance of each parameter's part with the sum, as a fraction of the sum's variance; tilts and
    shifts together are the alignment."""
    variance, centred = float(total.var()), total - total.mean()
    shares: dict[str, float] = {}
    for k, name in enumerate(names):
        whose = ALIGNMENT if name in _POSE else name
        share = float((parts[:, k] * centred).mean() / variance) if variance else 0.0
        shares[whose] = shares.get(whose, 0.0) + share
    return shares


def _changed(limb: LimbModel, c: float, m: float) -> LimbModel:
    """The limb with c (and kappa) and m of its tissue multiplied by these factors."""
    law = limb.materials["tissue"]
    values = law.parameters.items()
    changes = {name: _times(value, m if name.startswith("m") else c) for name, value in values}
    return replace(limb, materials={**limb.materials, "tissue": law.with_parameters(**changes)})


def _times(value: Value, factor: float) -> Value:
    if isinstance(value, ElementMap):
        return replace(value, values=value.values * factor)
    assert isinstance(value, float | int)
    return float(value * factor)
