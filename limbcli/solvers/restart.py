"""Restart file: the converged levels of an unfinished run.

A later run of the same model with the same solver resumes from them: each level is already in equilibrium,
which takes one force evaluation to confirm, and its records are written again.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from limbcli.files.atomic import atomic_file
from limbcli.files.unpacking import DAMAGED, read_npz
from limbcli.version import __version__

if TYPE_CHECKING:
    from limbcli.fem.motion.state import State
    from limbcli.fem.system import System
    from limbcli.fem.warm_start import Solved as Solved

RESTART_FILE = "restart.npz"


class Restart:
    """Converged levels of a run, by time.

    folder : of the file
    model : the model's content, or a hash of it
    settings : the solver's settings as text. Levels of another model, other settings or another solver
        version are ignored.
    """

    def __init__(self, folder: Path, model: bytes, settings: str):
        self.path = folder / RESTART_FILE
        words = f"{__version__} {settings} ".encode()
        self.key = hashlib.sha256(words + model).hexdigest()
        self._states: dict[float, State] = {}
        self._stored = self._read()
        self.n_stored = len(self._stored)

    def guess(self, system: System, time: float) -> State | None:
        """The level at a time, if the previous run reached it."""
        state = self._stored.get(time)
        return state if state is not None and state.u.shape == system.X.shape else None

    def keep(self, state: State) -> None:
        """Add a converged level; the file is replaced atomically."""
        self._states[state.time] = state
        if len(self._states) <= self.n_stored and state.time in self._stored:
            return
        self._write()

    def begin_with(self, states: Mapping[float, State]) -> None:
        """Leave levels that were solved elsewhere for the next run."""
        self._states = dict(states)
        self._write()

    def _write(self) -> None:
        arrays = {"key": np.array(self.key), **level_arrays(self._states)}
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(self.path) as path, path.open("wb") as stream:
            np.savez(stream, **arrays)

    def finished(self) -> None:
        self.path.unlink(missing_ok=True)

    def _read(self) -> dict[float, State]:
        """The levels in the file; none if it belongs to another model or is damaged."""
        with contextlib.suppress(*DAMAGED):
            stored = read_npz(self.path)
            if str(stored["key"]) == self.key:
                return levels_of(stored)
        return {}


def solved_arrays(solved: Solved) -> dict[str, Any]:
    """The levels of a solve as named arrays for storage."""
    lame = {f"lame{k}": each for k, each in enumerate(solved.lame)}
    names, values = np.array(list(solved.values)), np.array(list(solved.values.values()))
    return {**level_arrays(solved.states), "names": names, "values": values, "n_lame": len(lame), **lame}


def solved_of(stored: Any) -> Solved:
    """The inverse of `solved_arrays`; derivatives (slopes) are not stored."""
    from limbcli.fem.warm_start import Solved

    names = [(str(material), str(name)) for material, name in stored["names"]]
    lame = tuple(stored[f"lame{k}"] for k in range(int(stored["n_lame"])))
    values = dict(zip(names, stored["values"].tolist(), strict=True))
    return Solved(values, levels_of(stored), {}, lame)


def level_arrays(states: Mapping[float, State]) -> dict[str, Any]:
    """Converged levels as named arrays for storage."""
    arrays: dict[str, Any] = {"times": np.array(list(states))}
    for k, each in enumerate(states.values()):
        arrays[f"u{k}"] = each.u
        arrays[f"shift{k}"] = np.array([body.shift for body in each.bodies])
        arrays[f"rotation{k}"] = np.array([body.rotation for body in each.bodies])
        arrays |= {f"hints{k}_{j}": part for j, part in enumerate(each.hints)}
    return arrays


def levels_of(stored: Any) -> dict[float, State]:
    """The inverse of `level_arrays`: levels by time."""
    states = [_state(stored, k, float(time)) for k, time in enumerate(stored["times"])]
    return {each.time: each for each in states}


def _state(stored: Any, k: int, time: float) -> State:
    from limbcli.fem.motion.rigid import BodyState
    from limbcli.fem.motion.state import State

    keys = [key for key in stored if key.startswith(f"hints{k}_")]
    hints = tuple(stored[f"hints{k}_{j}"] for j in range(len(keys)))
    motions = zip(stored[f"shift{k}"], stored[f"rotation{k}"], strict=True)
    bodies = tuple(BodyState(shift, rotation) for shift, rotation in motions)
    return State(time, stored[f"u{k}"], bodies, hints)
