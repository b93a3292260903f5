"""First guesses from converged states: beside an earlier solve, and on the polynomial through them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.model import Array

_STRAIGHT = 1 - 1e-6  # cosine


def continued(system: System, last: State, before: State, after: State) -> State:
    """The last state plus what an earlier solve changed by, between two of its load steps."""
    still = np.zeros_like(last.u)
    change = [b - a for a, b in zip(_ratios(system, before), _ratios(system, after), strict=True)]
    volumes = [a + each for a, each in zip(system.linear_volumes(last, still), change, strict=True)]
    u = last.u + after.u - before.u
    return replace(after, u=u, volumes=tuple(volumes))


def _ratios(system: System, state: State) -> tuple[Array, ...]:
    return state.volumes or system.linear_volumes(state, np.zeros_like(state.u))


def extrapolate(system: System, states: list[State], time: float) -> State:
    """First guess on the polynomial through converged states; pressures follow theirs."""
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
    """What the states, and the one at `time`, are a smooth function of.

    The way of the driven bodies where that is straight: a load curve may go at any pace, by kinks.
    Otherwise the time.
    """
    aim = system.prescribed(states[-1], time)
    places = np.array([[body.shift for body in each.bodies] for each in (*states, aim)])
    ways = np.diff(places.reshape(len(places), -1), axis=0)
    lengths = np.linalg.norm(ways, axis=1)
    turned = any((a.turn != b.turn).any() for a, b in zip(states[-1].bodies, aim.bodies, strict=True))
    straight = (ways @ ways.sum(axis=0)) >= _STRAIGHT * lengths * lengths.sum()
    if turned or not lengths.all() or not straight.all():
        return [*(s.time for s in states), time]
    return [0.0, *np.cumsum(lengths).tolist()]


def lagrange(times: np.ndarray, time: float) -> np.ndarray:
    """Weights of the polynomial through `times`, at `time`.

    >>> lagrange(np.array([0.0, 1.0]), 2.0)
    array([-1.,  2.])
    """
    weights = np.ones(len(times))
    for k in range(len(times)):
        for j in range(len(times)):
            if j != k:
                weights[k] *= (time - times[j]) / (times[k] - times[j])
    return weights
