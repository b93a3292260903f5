"""Initial guesses: extrapolation of converged states, or of their difference from an earlier solve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from limbcli.fem.motion.rigid import BodyState
from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.model import Array

_STRAIGHT = 1 - 1e-6  # cosine of the angle between two displacements up to which a path counts as straight


def beside(system: System, known: State, time: float, pairs: Sequence[tuple[State, State]]) -> State:
    """The state `known` of an earlier solve at `time`, plus the difference of this solve from it.

    The difference is extrapolated from `pairs` of states at the last load steps: of this solve, and of the
    earlier one. It is smaller and smoother than the states themselves, whose contact grows by leaps.
    """
    *along, aim = _coordinate(system, [ours for ours, _ in pairs], time)
    u, bodies, volumes = known.u, known.bodies, list(_ratios(system, known))
    for weight, (ours, theirs) in zip(lagrange(np.array(along), aim), pairs, strict=True):
        u = u + weight * (ours.u - theirs.u)
        bodies = _combined([bodies, ours.bodies, theirs.bodies], [1.0, weight, -weight])
        apart = zip(_ratios(system, ours), _ratios(system, theirs), strict=True)
        volumes = [each + weight * (a - b) for each, (a, b) in zip(volumes, apart, strict=True)]
    return system.prescribed(replace(known, u=u, bodies=bodies, volumes=tuple(volumes)), time)


def _ratios(system: System, state: State) -> tuple[Array, ...]:
    return state.volumes or system.linear_volumes(state, np.zeros_like(state.u))


def extrapolate(system: System, states: Sequence[State], time: float) -> State:
    """Initial guess by polynomial extrapolation of converged states; volume ratios likewise."""
    *along, aim = _coordinate(system, states, time)
    weights = lagrange(np.array(along), aim)
    last = states[-1]

    def combined(parts: list[Any]) -> Any:
        return sum(w * each for w, each in zip(weights, parts, strict=True))

    bodies = _combined([s.bodies for s in states], weights)
    moved = State(last.time, combined([s.u for s in states]), bodies, last.hints)
    guess = system.prescribed(moved, time)
    still = np.zeros_like(last.u)
    ratios = [system.linear_volumes(s, still) for s in states]
    volumes = tuple(combined(list(each)) for each in zip(*ratios, strict=True))
    return replace(guess, volumes=volumes)


def _combined(
    states: Sequence[tuple[BodyState, ...]], weights: Sequence[float] | Array
) -> tuple[BodyState, ...]:
    """Weighted sums of shifts and rotation vectors: the skin that a free body presses moves with it."""
    return tuple(
        BodyState(
            sum((w * at.shift for w, at in zip(weights, each, strict=True)), np.zeros(3)),
            sum((w * at.rotation for w, at in zip(weights, each, strict=True)), np.zeros(3)),
        )
        for each in zip(*states, strict=True)
    )


def _coordinate(system: System, states: Sequence[State], time: float) -> list[float]:
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
