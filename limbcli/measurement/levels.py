"""The force levels of one indentation: what `levels.csv` holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from limbcli.model import Array

LAYERS = ("skin", "fat", "muscle")  # from the probe inward
TOUCH_FORCE, TOUCH_DEPTH = 1.0, 1.0  # N, mm: what a level 0 has at most, the probe's first touch


@dataclass(frozen=True, eq=False)
class Levels:
    """One measurement, a row per force level, in the order measured; all arrays (n_levels,).

    force N, compression positive; depth mm since level 0; swe_* m/s and pixel counts,
    hold s, probe travel and skin-bone distance mm, NaN where not measured; phase
    "load" or "unload".
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

    def __len__(self) -> int:
        return len(self.force)

    @property
    def loading(self) -> np.ndarray:
        """(n_levels,) bool: the levels of the loading phase."""
        return np.array([each == "load" for each in self.phase])

    @property
    def begins_at_zero(self) -> bool:
        """Whether the first level is level 0: first touch, before any load."""
        first_touch = self.force[0] <= TOUCH_FORCE and self.depth[0] <= TOUCH_DEPTH
        return bool(first_touch and self.phase[0] == "load")

    def layer(self, name: str) -> Array:
        """mm (n_levels,), NaN where it was not measured."""
        return self.layers.get(name, np.full(len(self), np.nan))

    @property
    def has_swe(self) -> bool:
        return bool(np.isfinite(self.swe_mean_m_per_s).any())
