"""Initial guesses for a solve with other material parameters, from previous solves.

A level's displacements and pressures are extrapolated linearly, by their derivatives, from the nearest
solved parameter values. Parameters are transformed so that the response is close to linear: a bulk
stiffness enters by its reciprocal (near incompressibility u and p are almost linear in 1/kappa), an
exponent by its logarithm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.model import Array

Key = tuple[str, str]
_KEPT = 8  # number of solves that are kept
_BULK = ("kappa", "k", "lam")  # names of bulk stiffnesses
_SOFT = 4.0  # offset of a bulk stiffness in its reciprocal measure, as a multiple of c1 (see `even_step`)


@dataclass(frozen=True, eq=False)
class Solved:
    """The converged levels of one solve.

    values : parameter values, by (material, name), from which distances and extrapolation steps are computed
    states : converged state by time
    slopes : du/d(parameter) (n_points, 3) by time and parameter, where requested
    lame : of each group, ratio of pressure to volume change, p = lame (J - 1)
    """

    values: Mapping[Key, float]
    states: Mapping[float, State]
    slopes: Mapping[float, Mapping[Key, Array]]
    lame: tuple[Array, ...]


class WarmStart:
    """Keeps the levels of the last solves; `at` selects the solve nearest to new parameter values."""

    def __init__(self, *solved: Solved) -> None:
        self._solved: list[Solved] = [*solved]
        self._base: Solved | None = None
        self._values: Mapping[Key, float] = {}

    def keep(self, solved: Solved) -> None:
        self._solved = [*self._solved[-(_KEPT - 1) :], solved]

    @property
    def last(self) -> Solved | None:
        return self._solved[-1] if self._solved else None

    def at(self, values: Mapping[Key, float]) -> None:
        """Set the parameter values for which guesses are requested."""
        self._values = values
        self._base = self.nearest(values)

    def nearest(self, values: Mapping[Key, float]) -> Solved | None:
        """The kept solve whose parameter values are nearest to these."""
        return min(self._solved, key=lambda each: _distance(each.values, values), default=None)

    def guess(self, system: System, time: float) -> State | None:
        """The level at `time`, extrapolated to the requested values; None if the selected solve lacks it."""
        base = self._base
        if base is None or time not in base.states:
            return None
        state = base.states[time]
        u, bulk = state.u, 1.0
        for key, slope in base.slopes.get(time, {}).items():
            before, after = base.values.get(key), self._values.get(key)
            if before is None or after is None or before == after:
                continue
            step = even_step(key[1], before, after, soft=_SOFT * abs(base.values.get((key[0], "c1"), 0.0)))
            u = u + step * slope
            if key[1] in _BULK:
                bulk += step / before
        # p = lame (J - 1) is extrapolated likewise: lame J':du + (J - 1) d lame
        volumes = []
        still = system.linear_volumes(state, np.zeros_like(u))
        moved = system.linear_volumes(state, u - state.u)
        for J, J_moved, before_lame, o in zip(still, moved, base.lame, system.operands, strict=True):
            ratio = (before_lame / o.lame)[:, None]
            volumes.append(1.0 + ratio * ((J - 1.0) * bulk + J_moved - J))
        return replace(state, u=u, volumes=tuple(volumes))


def even_step(name: str, before: float, after: float, *, soft: float = 0.0) -> float:
    """The change of a parameter in a measure in which the response is close to linear.

    soft : offset (MPa) of a bulk stiffness: much below it the measure is linear, above it reciprocal

    >>> even_step("kappa", 1.0, 1e9), round(even_step("m1", 2.0, 4.0), 3), even_step("c1", 1.0, 3.0)
    (0.999999999, 1.386, 2.0)
    """
    if name in _BULK and before > 0 and after > 0:
        return (before + soft) * (after - before) / (after + soft)
    if name.startswith("m") and name[1:].isdigit() and before * after > 0:
        return float(before * np.log(after / before))
    return after - before


def _distance(a: Mapping[Key, float], b: Mapping[Key, float]) -> float:
    """Squared distance between two sets of values, in logarithms where both have the same sign."""
    total = 0.0
    for key in a.keys() & b.keys():
        same_sign = a[key] * b[key] > 0
        total += float(np.log(a[key] / b[key])) ** 2 if same_sign else (a[key] - b[key]) ** 2
    return total
