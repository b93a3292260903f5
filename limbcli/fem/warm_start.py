"""First guesses for a solve with other material parameters, from the solves before it.

A level's displacements and pressures are moved along their derivatives from the solved
parameters that lie nearest. What is moved is what changes most evenly: a bulk stiffness by
its reciprocal (near incompressibility u and p depend on 1/kappa almost linearly), an exponent by
its logarithm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.model import Array

Key = tuple[str, str]
_KEPT = 8
_BULK = ("kappa", "k", "lam")
_SOFT = 4.0


@dataclass(frozen=True, eq=False)
class Solved:
    """The levels of one solve.

    values : the parameters that the solves differ in
    states, slopes : by time; du/d(parameter) (n_points, 3), where it was asked for
    lame : pressure per volume change of each group
    """

    values: Mapping[Key, float]
    states: Mapping[float, State]
    slopes: Mapping[float, Mapping[Key, Array]]
    lame: tuple[Array, ...]


class WarmStart:
    """Keeps solved levels; `at` picks those nearest to new parameter values."""

    def __init__(self) -> None:
        self._solved: list[Solved] = []
        self._base: Solved | None = None
        self._values: Mapping[Key, float] = {}

    @staticmethod
    def by(solved: Solved) -> WarmStart:
        """From these levels alone."""
        found = WarmStart()
        found.keep(solved)
        return found

    def keep(self, solved: Solved) -> None:
        self._solved = [*self._solved[-(_KEPT - 1) :], solved]

    @property
    def last(self) -> Solved | None:
        return self._solved[-1] if self._solved else None

    def at(self, values: Mapping[Key, float]) -> None:
        """Set the parameter values that guesses are wanted for."""
        self._values = values
        self._base = min(self._solved, key=lambda each: _distance(each.values, values), default=None)

    def guess(self, system: System, time: float) -> State | None:
        """The level at `time`, moved to the wanted values; None where no solve had it."""
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
        # p = lame (J - 1), moved in the same measure: lame J':du + (J - 1) d lame
        volumes = []
        still = system.linear_volumes(state, np.zeros_like(u))
        moved = system.linear_volumes(state, u - state.u)
        for J, J_moved, before_lame, o in zip(still, moved, base.lame, system.operands, strict=True):
            ratio = (before_lame / o.lame)[:, None]
            volumes.append(1.0 + ratio * ((J - 1.0) * bulk + J_moved - J))
        return replace(state, u=u, volumes=tuple(volumes))


def even_step(name: str, before: float, after: float, *, soft: float = 0.0) -> float:
    """The change of a parameter, measured so that the response changes evenly with it.

    soft : stiffness (MPa) below which a bulk stiffness counts linearly

    >>> even_step("kappa", 1.0, 1e9), round(even_step("m1", 2.0, 4.0), 3), even_step("c1", 1.0, 3.0)
    (0.999999999, 1.386, 2.0)
    """
    if name in _BULK and before > 0 and after > 0:
        return (before + soft) * (after - before) / (after + soft)
    if name.startswith("m") and name[1:].isdigit() and before * after > 0:
        return float(before * np.log(after / before))
    return after - before


def _distance(a: Mapping[Key, float], b: Mapping[Key, float]) -> float:
    """Between two sets of values, in logarithms where both have one sign."""
    total = 0.0
    for key in a.keys() & b.keys():
        same_sign = a[key] * b[key] > 0
        total += float(np.log(a[key] / b[key])) ** 2 if same_sign else (a[key] - b[key]) ** 2
    return total
