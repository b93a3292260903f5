"""Levels of repeated loading that are made, not measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from limbcli.measurement.levels import Levels

FORCE = np.arange(0.0, 13.0, 2.0)


def depth_of(force: np.ndarray) -> np.ndarray:
    """mm of a tissue that stiffens: 1.2 mm/N at first, 0.4 mm/N at 12 N."""
    return 6.0 * np.log1p(force / 5.0)


def repeated(
    *changes: dict[str, float], unload: bool = True, seed: int | None = None, travel: bool = False
) -> Levels:
    """A cycle for every set of changes: softer (share), left (mm), drift (N), moved (mm).

    Noise of 0.1 N and 0.3 mm with a seed. Unloading follows a curve 0.6 mm deeper half-way.
    """
    rng = np.random.default_rng(seed) if seed is not None else None
    columns: dict[str, list] = {name: [] for name in ("force", "depth", "phase", "cycle", "travel")}
    for number, change in enumerate(changes, 1):
        up = FORCE
        down = FORCE[-2:0:-1] if unload else FORCE[:0]
        for phase, force in (("load", up), ("unload", down)):
            depth = (1 + change.get("softer", 0.0)) * depth_of(force) + change.get("left", 0.0)
            if phase == "unload":
                depth = depth + 0.6 * np.sin(np.pi * force / FORCE[-1])
            columns["force"].append(force - change.get("drift", 0.0))
            columns["depth"].append(depth)
            columns["travel"].append(depth + change.get("moved", 0.0))
            columns["phase"] += [phase] * len(force)
            columns["cycle"] += [number] * len(force)
    force, depth, moved = (np.concatenate(columns[name]) for name in ("force", "depth", "travel"))
    if rng is not None:
        force = force + 0.1 * rng.standard_normal(len(force))
        depth = depth + 0.3 * rng.standard_normal(len(depth))
    nan = np.full(len(force), np.nan)
    return Levels(
        force=force, depth=depth, swe_mean_m_per_s=nan, swe_sd_m_per_s=nan, swe_pixels=nan,
        phase=tuple(columns["phase"]), hold=nan, probe_travel=moved if travel else nan, skin_bone=nan,
        path=Path("x.csv"), cycle=np.array(columns["cycle"], dtype=np.int64),
    )  # fmt: skip
