"""Measured files of a site: levels.csv, trace.csv, swe/level_00.csv, ..."""

from __future__ import annotations

from pathlib import Path

from limbcli.measurement.elastography import map_file, write_map
from limbcli.phantom.simulated_readings import Readings, levels_rows

TRACE_HEADER = "time_s,force_n,depth_mm,accel_x_g,accel_y_g,accel_z_g"


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
