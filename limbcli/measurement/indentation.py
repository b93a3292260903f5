"""Read and check the force-depth measurement: `levels.csv` (and `trace.csv`, see `trace`).

An impossible reading (a depth in cm, a force in grams, a repeated level) is an error with its line; an
unusual one is a warning.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from limbcli.errors import MeasurementError
from limbcli.errors.problems import Problem, checked, errors_of
from limbcli.measurement.layer_checks import LayerNoise, check_layers
from limbcli.measurement.level_checks import (
    check_columns,
    check_count,
    check_cycles,
    check_distance,
    check_order,
    check_phase,
    check_plausible,
    check_swe,
    check_tare,
    check_values,
    check_zero,
)
from limbcli.measurement.levels import LAYERS, Levels
from limbcli.measurement.number_table import RawTable, problem, read_table
from limbcli.measurement.shear_modulus import speed_from_young
from limbcli.measurement.speed_noise import check_speed_noise
from limbcli.measurement.trace import TRACE_OPTIONAL, TRACE_REQUIRED, Trace, check_trace, read_trace

__all__ = [
    "OPTIONAL", "REQUIRED", "TEXTS", "TRACE_OPTIONAL", "TRACE_REQUIRED", "LayerNoise", "Levels", "Trace",
    "check_levels", "check_trace", "check_values", "level_warnings", "read_levels", "read_trace",
]  # fmt: skip

REQUIRED = ("force_n", "depth_mm")
_MODULI = ("swe_mean_young_kpa", "swe_sd_young_kpa")  # as scanners show them, in place of the speeds
OPTIONAL = (
    "swe_mean_m_per_s", "swe_sd_m_per_s", "swe_pixels", "hold_s", "probe_travel_mm", "skin_bone_mm",
    "cycle", *(f"{name}_mm" for name in LAYERS), *_MODULI,
)  # fmt: skip
TEXTS = ("phase",)
_PHASES = {"": "load", "loading": "load", "unloading": "unload"}  # as in other spellings
_MANY = 10**6  # upper limit of the number of cycles


def read_levels(path: Path, *, noise: LayerNoise | None = None) -> Levels:
    """Read and check `levels.csv`; noise: of layers and depth, so that growth of layers is checked too.

    Raises MeasurementError with every problem of the file and its line.
    """
    return checked(*check_levels(path, noise=noise), MeasurementError)


def level_warnings(path: Path, *, noise: LayerNoise | None = None) -> tuple[str, ...]:
    """Descriptions of what is unusual about usable levels."""
    _, problems = check_levels(path, noise=noise)
    return tuple(f"{each.what} ({each.fix})" for each in problems if each.severity == "warning")


def check_levels(path: Path, *, noise: LayerNoise | None = None) -> tuple[Levels | None, list[Problem]]:
    """The levels, if they are usable, and every problem (errors and warnings)."""
    table, problems = read_table(path, required=REQUIRED, optional=OPTIONAL, texts=TEXTS)
    if table is None or errors_of(problems):
        return None, problems
    levels = _levels(table, path)
    problems += check_count(levels, path)
    problems += _check_moduli(table, path)
    problems += check_phase(levels, table, path)
    problems += check_cycles(levels, table, path)
    problems += check_columns(levels, table, path)
    if not errors_of(problems):
        problems += check_layers(levels, path, lines=table.lines, noise=noise)
    if not errors_of(problems):
        speeds = check_swe(levels, table, path)
        trusted = not errors_of(speeds)
        problems += check_order(levels, table, path)
        problems += check_distance(levels, table, path, noise=noise)
        problems += check_zero(levels, table, path, noise=noise)
        problems += check_tare(levels, table, path)
        problems += check_plausible(levels, path, speed_is_possible=trusted)
        problems += speeds
        if trusted:
            problems += check_speed_noise(levels, table, path, noise=noise.speed if noise else None)
    return levels, problems


def _check_moduli(table: RawTable, path: Path) -> list[Problem]:
    """Speeds or moduli, never both; the spread of a modulus needs the modulus."""
    moduli = [name for name in _MODULI if name in table.numbers]
    speeds = [name for name in ("swe_mean_m_per_s", "swe_sd_m_per_s") if name in table.numbers]
    if moduli and speeds:
        what = f"{moduli[0]} and {speeds[0]} are two figures of one reading"
        return [problem(what, path, "keep the speeds, or the moduli; none is computed from both")]
    if moduli == ["swe_sd_young_kpa"]:
        return [problem("swe_sd_young_kpa is given without swe_mean_young_kpa", path, "add it")]
    return []


def _levels(table: RawTable, path: Path) -> Levels:
    missing = np.full(len(table), np.nan)
    thickness = {name: table.numbers.get(f"{name}_mm", missing) for name in LAYERS}
    phase = table.texts.get("phase", ["load"] * len(table))
    mean, sd = speed_from_young(*(table.numbers.get(name, missing) for name in _MODULI))
    speed, pixels = table.numbers.get("swe_mean_m_per_s", mean), table.numbers.get("swe_pixels", missing)
    cycle = np.nan_to_num(table.numbers.get("cycle", np.ones(len(table))), nan=0.0)
    return Levels(
        force=table.numbers["force_n"],
        depth=table.numbers["depth_mm"],
        swe_mean_m_per_s=speed,
        swe_sd_m_per_s=table.numbers.get("swe_sd_m_per_s", sd),
        # no pixel and no speed: not measured
        swe_pixels=np.where((pixels == 0) & np.isnan(speed), np.nan, pixels),
        phase=tuple(_PHASES.get(each.lower(), each.lower()) for each in phase),
        hold=table.numbers.get("hold_s", missing),
        probe_travel=table.numbers.get("probe_travel_mm", missing),
        skin_bone=table.numbers.get("skin_bone_mm", missing),
        path=path,
        layers={name: each for name, each in thickness.items() if np.isfinite(each).any()},
        cycle=np.clip(cycle, -_MANY, _MANY).astype(np.int64),
    )
