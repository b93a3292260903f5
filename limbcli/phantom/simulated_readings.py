"""Simulated measurement of true levels: readings with noise, the record of the load cell, and their files."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from limbcli.measurement.elastography import (
    SPEED_HIGH_M_PER_S,
    SPEED_LOW_M_PER_S,
    SweMap,
    map_file,
    statistics,
    write_map,
)
from limbcli.model import Array
from limbcli.phantom.case_folder import NoiseLaw
from limbcli.phantom.protocol import LoadingProtocol, TrueLevels

TRACE_HEADER = "time_s,force_n,depth_mm,accel_x_g,accel_y_g,accel_z_g"
SAMPLE_NOISE_N, SAMPLE_NOISE_MM = 0.03, 0.02
TRAVEL_NOISE_MM = 0.1  # standard deviation of the recorded travel of the probe on its guide
LAYER_COLUMNS = ("skin_mm", "fat_mm", "muscle_mm")
_PROBE_DOWN_G = (0.0, -0.05, -0.99)


@dataclass(frozen=True, eq=False, kw_only=True)
class Readings:
    """One measurement as it would be recorded, one row per level.

    skin_bone : None if the beam meets no bone
    trace : columns time (s), force (N), depth (mm) and three accelerations (g)
    travel : of the probe (mm), if recorded
    layers : (n_levels, 2 or 3) skin, fat and, above bone, muscle (mm), if read
    travel_error : (n_levels,) error of the travel reading (mm); None: none
    left_out : numbers of true levels that have no row
    """

    force: Array
    depth: Array
    maps: tuple[SweMap, ...]
    skin_bone: Array | None
    hold: float
    trace: Array
    travel: Array | None = None
    layers: Array | None = None
    travel_error: Array | None = None
    left_out: tuple[int, ...] = ()


def measure(
    true: TrueLevels, law: NoiseLaw, *, protocol: LoadingProtocol, rng: np.random.Generator
) -> Readings:
    """Read each level once.

    Errors of force and depth are independent between levels; level 0 is the tare and the reference of the
    depth, so it is 0 by definition. A speed has one error common to the pixels of its level and one for each
    pixel, both relative. Skin and fat are read with independent errors of their thicknesses; muscle is the
    rest of the distance to the bone.
    """
    n = len(true.force)
    first = np.arange(n) == 0
    force = true.force + np.where(first, 0.0, law.force_n * rng.standard_normal(n))
    depth = true.depth + np.where(first, 0.0, law.depth_mm * rng.standard_normal(n))
    common = 1 + law.swe_level_fraction * rng.standard_normal(n)
    maps = tuple(
        _noisy_map(each, factor, law.swe_pixel_fraction, rng)
        for each, factor in zip(true.maps, common, strict=True)
    )
    skin_bone = None if true.skin_bone is None else true.skin_bone - depth
    quiet = law.force_n == 0
    trace = _trace(force, depth, protocol, rng, quiet=quiet)
    layers = None if true.borders is None else _layers(true.borders, skin_bone, law.layer_mm, rng)
    travel_error = np.where(first | quiet, 0.0, TRAVEL_NOISE_MM * rng.standard_normal(n))
    return Readings(
        force=force, depth=depth, maps=maps, skin_bone=skin_bone, hold=protocol.hold, trace=trace,
        layers=layers, travel_error=travel_error,
    )  # fmt: skip


def _layers(borders: Array, skin_bone: Array | None, deviation: float, rng: np.random.Generator) -> Array:
    """Thickness (n_levels, 2 or 3) of skin, fat, and the rest down to the bone (mm)."""
    upper = np.diff(borders, axis=1, prepend=0.0)
    upper = upper + deviation * rng.standard_normal(upper.shape)
    return upper if skin_bone is None else np.column_stack([upper, skin_bone - upper.sum(axis=1)])


def _noisy_map(swe: SweMap, factor: float, pixel: float, rng: np.random.Generator) -> SweMap:
    """Add noise to a map; pixels whose reading falls outside the scanner's range are removed."""
    speed = swe.speed_m_per_s * factor * (1 + pixel * rng.standard_normal(len(swe)))
    keep = (speed >= SPEED_LOW_M_PER_S) & (speed <= SPEED_HIGH_M_PER_S)
    return SweMap(swe.lateral[keep], swe.depth[keep], speed[keep])


def _trace(
    force: Array, depth: Array, protocol: LoadingProtocol, rng: np.random.Generator, *, quiet: bool
) -> Array:
    """Force and depth over time: smooth ramps and holds, sampled; the probe's weight acts along z."""
    per_ramp = round(protocol.ramp * protocol.sampling_hz)
    per_hold = round(protocol.hold * protocol.sampling_hz)
    s = (np.arange(per_ramp) + 1.0) / per_ramp
    rise = s * s * (3 - 2 * s)

    def steps(levels: Array) -> Array:
        pieces = [np.full(per_hold, levels[0])]
        for before, after in pairwise(levels):
            pieces += [before + (after - before) * rise, np.full(per_hold, after)]
        return np.concatenate(pieces)

    held, deep = steps(force), steps(depth)
    time = np.arange(len(held)) / protocol.sampling_hz
    noise = 0.0 if quiet else 1.0
    held = held + noise * SAMPLE_NOISE_N * rng.standard_normal(len(held))
    acceleration = np.array(_PROBE_DOWN_G) + noise * 0.004 * rng.standard_normal((len(held), 3))
    deep = deep + noise * SAMPLE_NOISE_MM * rng.standard_normal(len(deep))
    return np.column_stack([time, held, deep, acceleration])


def levels_rows(readings: Readings) -> tuple[list[str], list[list[str]]]:
    """Header and rows of levels.csv."""
    header = ["force_n", "depth_mm", "swe_mean_m_per_s", "swe_sd_m_per_s", "swe_pixels", "phase", "hold_s"]
    rows = []
    for k, swe in enumerate(readings.maps):
        found = statistics(swe)
        row = [f"{readings.force[k]:.6g}", f"{readings.depth[k]:.7g}", f"{found.mean_m_per_s:.6g}"]
        row += [f"{found.sd_m_per_s:.4g}", str(found.n_pixels), "load", f"{readings.hold:g}"]
        rows.append(row)
    layers = () if readings.layers is None else zip(LAYER_COLUMNS, readings.layers.T, strict=False)
    more = {"skin_bone_mm": readings.skin_bone, "probe_travel_mm": readings.travel, **dict(layers)}
    for name, values in more.items():
        if values is not None:
            header.append(name)
            for row, value in zip(rows, values, strict=True):
                row.append(f"{value:.6g}")
    return header, rows


def write_readings(folder: Path, readings: Readings) -> None:
    """Write a site's folder in the case format."""
    write_levels(folder, readings)
    trace = (f"{t:.4f},{f:.3f},{d:.3f},{x:.3f},{y:.3f},{z:.3f}" for t, f, d, x, y, z in readings.trace)
    _write(folder / "trace.csv", [TRACE_HEADER, *trace])
    for level, swe in enumerate(readings.maps):
        write_map(map_file(folder / "swe", level), swe)


def write_levels(folder: Path, readings: Readings) -> None:
    """Write levels.csv alone, the only file of a state."""
    folder.mkdir(parents=True, exist_ok=True)
    header, rows = levels_rows(readings)
    _write(folder / "levels.csv", [",".join(header), *(",".join(row) for row in rows)])


def _write(path: Path, lines: list[str]) -> None:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
