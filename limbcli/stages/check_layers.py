"""The lines of `check` about measured layers: their thickness, and how it decreases under load."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from limbcli.case import Case, StatedNoise

if TYPE_CHECKING:
    from limbcli.measurement.indentation import LayerNoise, Levels


def stated_layer_noise(site: Mapping[str, Any]) -> LayerNoise:
    """Noise of layers, depth and speeds of a site's raw table in case.toml; default values where it states
    no usable ones."""
    from limbcli.measurement.indentation import LayerNoise
    from limbcli.measurement.speed_noise import SpeedNoise

    table, usual = site.get("noise"), StatedNoise()
    table = table if isinstance(table, Mapping) else {}
    numbers = {
        "layer_mm": usual.layer, "depth_mm": usual.depth,
        "swe_level_fraction": usual.swe_level_fraction, "swe_pixel_fraction": usual.swe_pixel_fraction,
    }  # fmt: skip
    found = {key: table.get(key, value) for key, value in numbers.items()}
    if not all(isinstance(each, int | float) for each in found.values()):
        return LayerNoise()
    thickness, depth, level, pixel = found.values()
    return LayerNoise(thickness, depth, SpeedNoise(level, pixel))


def layer_lines(case: Case) -> list[str]:
    """One line for each site that has layers.

    Unreadable files are skipped, as they have been reported already.
    """
    from limbcli.measurement.indentation import check_levels

    lines = []
    for site in case.sites:
        levels = check_levels(site.levels)[0] if site.levels.is_file() else None
        if levels is not None and levels.layers:
            lines.append(f"site {site.name}: {layer_words(levels)}")
    return lines


def layer_words(levels: Levels) -> str:
    """Each layer's thickness (mm) at the first and last loading level at which it was read.

    >>> from types import SimpleNamespace
    >>> some = SimpleNamespace(
    ...     layers={"skin": np.array([1.5, 1.4, np.nan]), "fat": np.array([6.0, 4.9, 4.1])},
    ...     loading=np.ones(3, dtype=bool), force=np.array([0.0, 4.0, 8.0]),
    ... )
    >>> layer_words(some)
    'skin 1.5 to 1.4 mm (0 to 4 N), fat 6 to 4.1 mm (0 to 8 N)'
    """
    parts = []
    for name, values in levels.layers.items():
        seen = np.flatnonzero(np.isfinite(values) & levels.loading)
        if not len(seen):
            continue
        first, last = seen[0], seen[-1]
        forces = f"{levels.force[first]:.3g} to {levels.force[last]:.3g} N"
        parts.append(f"{name} {values[first]:.3g} to {values[last]:.3g} mm ({forces})")
    return ", ".join(parts)
