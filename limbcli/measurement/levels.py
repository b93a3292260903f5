"""The force levels of one indentation, as stored in `levels.csv`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from limbcli.errors import CaseError
from limbcli.model import Array, IntArray

LAYERS = ("skin", "fat", "muscle")  # from the probe inward
TOUCH_FORCE, TOUCH_DEPTH = 1.0, 1.0  # N, mm: largest force and depth of a level 0, the probe's first touch
FEWEST_LOADING = 3  # smallest number of loading levels for a curve
LAST = "last"  # selects the last cycle with that many


@dataclass(frozen=True, eq=False, kw_only=True)
class Levels:
    """One measurement, a row per force level, in the order measured; all arrays (n_levels,).

    force N, compression positive; depth mm since level 0; swe_* m/s and pixel counts, hold s, probe travel
    and skin-bone distance mm, NaN where not measured; phase "load" or "unload"; cycle counts loadings from 1
    (default: one cycle).

    rows : row of each level in the file, counted from 0, by which its maps are numbered
    n_in_file : rows of the file, of all cycles
    zero_depth : depth (mm) in the file at which these depths begin (`of_cycle`)
    layers : thickness along the beam (mm) of those of `LAYERS` that were measured at any level, in order
    """

    force: Array
    depth: Array
    swe_mean_m_per_s: Array
    swe_sd_m_per_s: Array
    swe_pixels: Array
    phase: tuple[str, ...]
    hold: Array
    probe_travel: Array
    skin_bone: Array
    path: Path
    layers: Mapping[str, Array] = field(default_factory=dict)
    cycle: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    rows: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    n_in_file: int = 0
    zero_depth: float = 0.0

    def __post_init__(self) -> None:
        n = len(self.force)
        usual = {"cycle": np.ones(n, dtype=np.int64), "rows": np.arange(n)}
        for name, values in usual.items():
            if not len(getattr(self, name)):
                object.__setattr__(self, name, values)
        if not self.n_in_file:
            object.__setattr__(self, "n_in_file", n)

    def __len__(self) -> int:
        return len(self.force)

    @property
    def loading(self) -> np.ndarray:
        """(n_levels,) bool: the levels of the loading phase."""
        return np.array([each == "load" for each in self.phase])

    @property
    def begins_at_zero(self) -> bool:
        """Whether the first level is level 0: first touch, before any significant load."""
        first_touch = self.force[0] <= TOUCH_FORCE and self.depth[0] <= TOUCH_DEPTH
        return bool(first_touch and self.phase[0] == "load")

    def layer(self, name: str) -> Array:
        """Thickness of a layer, mm (n_levels,); NaN where not measured."""
        return self.layers.get(name, np.full(len(self), np.nan))

    @property
    def has_swe(self) -> bool:
        return bool(np.isfinite(self.swe_mean_m_per_s).any())

    @property
    def cycles(self) -> tuple[int, ...]:
        """The numbers of the cycles, in ascending order."""
        return tuple(int(each) for each in np.unique(self.cycle))

    def n_loading(self, cycle: int) -> int:
        """Number of loading levels in a cycle."""
        return int((self.loading & (self.cycle == cycle)).sum())

    def chosen_cycle(self, cycle: str = LAST) -> int:
        """The cycle's number, from "last" (the last with at least three loading levels) or a number.

        Raises CaseError if there is no such cycle, or it has fewer than three levels of loading.

        >>> four, nan = np.arange(4.0), np.full(4, np.nan)
        >>> columns = ("swe_mean_m_per_s", "swe_sd_m_per_s", "swe_pixels", "hold", "probe_travel")
        >>> unread = dict.fromkeys((*columns, "skin_bone"), nan)
        >>> some = Levels(force=four, depth=four, phase=("load",) * 4, path=Path("x"), **unread)
        >>> some.chosen_cycle(), some.chosen_cycle("1")
        (1, 1)
        """
        whole = [each for each in self.cycles if self.n_loading(each) >= FEWEST_LOADING]
        if cycle == LAST:
            return whole[-1] if whole else self.cycles[-1]
        listed = ", ".join(map(str, self.cycles))
        fix = f"cycles with enough levels: {', '.join(map(str, whole)) or 'none'}; or `last`"
        if not cycle.isdecimal() or int(cycle) not in self.cycles:
            what = f"there is no cycle {cycle}; the levels are of cycle {listed}"
            raise CaseError(what, where=f"--cycle, {self.path}", fix=fix, cycles=list(self.cycles))
        if int(cycle) not in whole:
            n = self.n_loading(int(cycle))
            what = f"cycle {cycle} has {n} level{'s' if n != 1 else ''} of loading; a curve needs at least "
            raise CaseError(f"{what}{FEWEST_LOADING}", where=f"--cycle, {self.path}", fix=fix, n_levels=n)
        return int(cycle)

    def of_cycle(self, number: int) -> Levels:
        """The levels of one cycle; depths and travel count from its own first touch, if it has one.

        Tissue that was loaded before does not recover completely: the remaining deformation belongs to the
        state from which the cycle's loading begins.
        """
        rows = np.flatnonzero(self.cycle == number)
        if len(rows) == len(self):
            return self
        columns = {
            each.name: getattr(self, each.name)[rows]
            for each in fields(self)
            if isinstance(getattr(self, each.name), np.ndarray)
        }
        part = replace(
            self,
            phase=tuple(self.phase[k] for k in rows),
            layers={name: values[rows] for name, values in self.layers.items()},
            **columns,
        )
        touches = bool(part.phase[0] == "load" and part.force[0] <= TOUCH_FORCE)
        if number == self.cycles[0] or not touches:
            return part
        zero = float(part.depth[0])
        travel = part.probe_travel - part.probe_travel[0]
        return replace(part, depth=part.depth - zero, probe_travel=travel, zero_depth=zero)
