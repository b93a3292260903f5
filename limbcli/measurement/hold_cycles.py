"""Divide a sequence of holds into loading, unloading and cycles, at the turning points of the force."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def cycles_of_holds(forces: Sequence[float], *, turn: float) -> tuple[list[int], list[str]]:
    """The cycle (from 1) and the phase ("load", "unload") of every hold.

    The force has turned when it has reversed by `turn` from its last extreme. A peak belongs to the loading
    before it; a trough to the loading after it, as its level 0, unless it is the last hold of the record.

    forces : (n_holds,) N, in order of time; turn : N

    >>> cycles_of_holds([0, 2, 4, 2, 0, 2, 4], turn=1.0)
    ([1, 1, 1, 1, 2, 2, 2], ['load', 'load', 'load', 'unload', 'load', 'load', 'load'])
    >>> cycles_of_holds([0, 2, 4, 3.7, 6], turn=1.0)
    ([1, 1, 1, 1, 1], ['load', 'load', 'load', 'load', 'load'])
    """
    turns = _turning_points(forces, turn)
    cycle, phase = np.ones(len(forces), dtype=int), np.full(len(forces), "load", dtype=object)
    for k, start in enumerate(turns):
        rising = k % 2 == 1  # the first turn is a peak
        if rising:
            cycle[start:] += 1
            phase[start:] = "load"
        else:
            phase[start + 1 :] = "unload"
    return [int(each) for each in cycle], [str(each) for each in phase]


def _turning_points(forces: Sequence[float], turn: float) -> list[int]:
    """Holds at which the force turns: peaks and troughs alternately, a peak first.

    >>> _turning_points([0, 2, 4, 2, 0, 2, 4], 1.0)
    [2, 4]
    """
    found: list[int] = []
    extreme, rising = 0, True
    for k, force in enumerate(forces):
        ahead = force - forces[extreme] if rising else forces[extreme] - force
        if ahead >= 0:
            extreme = k
        elif -ahead >= turn:
            found.append(extreme)
            extreme, rising = k, not rising
    return found
