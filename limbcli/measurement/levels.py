"""The force levels of one indentation: what `levels.csv` holds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.model import Array

TOUCH_FORCE, TOUCH_DEPTH = 1.0, 1.0  # N, mm: what a level 0 has at most, the probe's first touch


@dataclass(frozen=True, eq=False)
class Levels:
    """One measurement, a row per force level, in the order measured; all arrays (n_levels,).

    force N, compression positive; depth mm since level 0; swe_* m/s and pixel counts,
    hold s, probe travel and skin-bone distance mm, NaN where not measured; phase
    "load" or "unload".
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

    @property
    def has_swe(self) -> bool:
        return bool(np.isfinite(self.swe_mean_m_per_s).any())
