"""Initial guesses from converged states: increments of an earlier solve, and polynomial extrapolation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.model import Array

_STRAIGHT = 1 - 1e-6  # cosine of the angle between two displacements up to which a path counts as straight


def continued(system: System, last: State, before: State, after: State) -> State:
    """The last state plus the increment of an earlier solve between the same two load steps."""
    still = np.zeros_like(last.u)
    change = [b - a for a, b in zip(_ratios(system, before), _ratios(system, after), strict=True)]
    volumes = [a + each for a, each in zip(system.linear_volumes(last, still), change, strict=True)]
    u = last.u + after.u - before.u
    return replace(after, u=u, volumes=tuple(volumes))


def _ratios(system: System, state: State) -> tuple[Array, ...]:
    return state.volumes or system.linear_volumes(state, np.zeros_like(state.u))


def extrapolate(system: System, states: list[State], time: float) -> State:
    """Initial guess by polynomial extrapolation of converged states; volume ratios likewise."""
    *along, aim = _coordinate(system, states, time)
    weights = lagrange(np.array(along), aim)
    last = states[-1]

    def combined(parts: list[Any]) -> Any:
        return sum(w * each for w, each in zip(weights, parts, strict=True))

    bodies = [
        replace(at, shift=combined([s.bodies[b].shift for s in states])) for b, at in enumerate(last.bodies)
    ]
    guess = system.prescribed(State(last.time, combined([s.u for s in states]), tuple(bodies)), time)
    still = np.zeros_like(last.u)
    ratios = [system.linear_volumes(s, still) for s in states]
    volumes = tuple(combined(list(each)) for each in zip(*ratios, strict=True))
    return replace(guess, volumes=volumes)


def _coordinate(system: System, states: list[State], time: float) -> list[float]:
    """The extrapolation variable: its values at the states and at `time`.

    The path length of the driven bodies if their path is straight, because a load curve may have kinks in
    time; otherwise the time.
    """
    aim = system.prescribed(states[-1], time)
    places = np.array([[body.shift for body in each.bodies] for each in (*states, aim)])
    ways = np.diff(places.reshape(len(places), -1), axis=0)
    lengths = np.linalg.norm(ways, axis=1)
    turned = any((a.rotation != b.rotation).any() for a, b in zip(states[-1].bodies, aim.bodies, strict=True))
    straight = (ways @ ways.sum(axis=0)) >= _STRAIGHT * lengths * lengths.sum()
    if turned or not lengths.all() or not straight.all():
        return [*(s.time for s in states), time]
    return [0.0, *np.cumsum(lengths).tolist()]


def lagrange(times: np.ndarray, time: float) -> np.ndarray:
    """Lagrange weights of the values at `times` for the interpolating polynomial at `time`.

    >>> lagrange(np.array([0.0, 1.0]), 2.0)
    array([-1.,  2.])
    """
    weights = np.ones(len(times))
    for k in range(len(times)):
        for j in range(len(times)):
            if j != k:
                weights[k] *= (time - times[j]) / (times[k] - times[j])
    return weights
