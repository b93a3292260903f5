"""Shear-wave elastography: speeds and maps.

A map is in the probe's frame: `lateral` along its long side from its centre, `depth` down from its face, both
mm, in the tissue as deformed at that force level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.errors import MeasurementError
from limbcli.errors.problems import Problem, checked, errors_of, raise_errors
from limbcli.files.atomic import atomic_file
from limbcli.measurement.number_table import RawTable, header_of, problem, read_table
from limbcli.measurement.shear_modulus import speed_from_young
from limbcli.model import Array

COLUMNS = ("lateral_mm", "depth_mm", "speed_m_per_s")
_MODULUS = "young_kpa"  # as scanners show it, in place of the speed
SPEED_LOW_M_PER_S, SPEED_HIGH_M_PER_S = 0.3, 20.0
_MAX_LATERAL, _MAX_DEPTH = 75.0, 120.0
_SHOWN = 4
_WIDEST = 1.3  # largest ratio of the half width of a map to that of the probe
_AT_ODDS = 1.3  # largest ratio, either way, of a map's mean to that in levels.csv


@dataclass(frozen=True, eq=False)
class SweMap:
    """One level's pixels: lateral, depth (mm) and speed_m_per_s, all (n_pixels,)."""

    lateral: Array
    depth: Array
    speed_m_per_s: Array
    path: Path | None = None

    def __len__(self) -> int:
        return len(self.speed_m_per_s)

    def within(self, *, lateral: tuple[float, float], depth: tuple[float, float]) -> SweMap:
        """The pixels inside a region of interest (mm, limits included)."""
        keep = (self.lateral >= lateral[0]) & (self.lateral <= lateral[1])
        keep &= (self.depth >= depth[0]) & (self.depth <= depth[1])
        return SweMap(self.lateral[keep], self.depth[keep], self.speed_m_per_s[keep], self.path)


@dataclass(frozen=True)
class SweStatistics:
    """Statistics of one level: mean and standard deviation over pixels, quartiles (m/s), pixel count."""

    mean_m_per_s: float
    sd_m_per_s: float
    quartiles_m_per_s: tuple[float, float, float]
    n_pixels: int


def statistics(swe: SweMap) -> SweStatistics:
    """Mean, spread and count of a map's pixels.

    The mean is that of speeds, not of moduli: E[v^2] = mean^2 + SD^2, so rho mean^2 is below the mean modulus
    by (SD / mean)^2.

    Raises MeasurementError if the map has no pixels.

    >>> found = statistics(SweMap(np.zeros(3), np.arange(3.0), np.array([1.0, 2.0, 3.0])))
    >>> found.mean_m_per_s, found.sd_m_per_s, found.n_pixels
    (2.0, 1.0, 3)
    """
    if not len(swe):
        raise MeasurementError(
            "the shear-wave map has no pixels in the region of interest",
            where=str(swe.path or "shear-wave map"),
            fix="enlarge the region of interest, or omit the level's map",
        )
    speed = swe.speed_m_per_s
    q1, q2, q3 = (float(each) for each in np.quantile(speed, [0.25, 0.5, 0.75]))
    sd = float(speed.std(ddof=1)) if len(speed) > 1 else 0.0
    return SweStatistics(float(speed.mean()), sd, (q1, q2, q3), len(speed))


def map_file(folder: Path, level: int) -> Path:
    """Path of the map of a row of levels.csv.

    >>> map_file(Path("swe"), 3).as_posix()
    'swe/level_03.csv'
    """
    return folder / f"level_{level:02d}.csv"


def write_map(path: Path, swe: SweMap) -> None:
    """Write one map in long form, atomically."""
    rows = zip(swe.lateral, swe.depth, swe.speed_m_per_s, strict=True)
    lines = [",".join(COLUMNS), *(f"{x:.6g},{z:.6g},{v:.4f}" for x, z, v in rows)]
    with atomic_file(path) as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_map(path: Path) -> SweMap:
    """Read and check one map.

    Raises MeasurementError with every problem of the file and its line.
    """
    return checked(*check_map(path), MeasurementError)


def read_maps(folder: Path, n_levels: int | None = None) -> list[SweMap]:
    """Read the maps of all levels, in order; as many as levels.csv has rows, if that is given.

    Raises MeasurementError with every problem of every file, including missing files.
    """
    maps, problems = check_maps(folder, n_levels)
    raise_errors(problems, MeasurementError)
    return maps


def check_maps(folder: Path, n_levels: int | None = None) -> tuple[list[SweMap], list[Problem]]:
    """The maps that are usable, and every problem: missing, surplus and faulty files.

    n_levels : rows of levels.csv; None if unknown: derived from the numbers of the maps
    """
    problems: list[Problem] = []
    maps = []
    n_levels = _n_by_names(folder) if n_levels is None else n_levels
    expected = [map_file(folder, level) for level in range(n_levels)]
    for path in expected:
        if not path.is_file():
            fix = (
                "write one file per row of levels.csv (the header only where nothing was "
                "read), or remove swe_maps from the site"
            )
            problems.append(problem(f"the map {path.name} is missing", folder, fix))
            continue
        swe, found = check_map(path)
        problems += found
        if swe is not None:
            maps.append(swe)
    if maps and not any(map(len, maps)):
        fix = "export the maps again, or remove swe_maps from the site"
        problems.append(problem("no map has any pixels", folder, fix))
    for path in sorted(folder.glob("*")):
        if path not in expected and not path.name.startswith("."):
            fix = (
                f"{n_levels} levels need the maps level_00.csv to {expected[-1].name}"
                if maps
                else ("name the maps level_00.csv, level_01.csv, ..., one per row of levels.csv")
            )
            problems.append(problem(f"{path.name} belongs to no level", folder, fix))
    return maps, problems


def _n_by_names(folder: Path) -> int:
    """The highest number of a map; but the count of the files if most of the numbers up to it are missing."""
    names = {path.name for path in folder.glob("level_*.csv")}
    digits = [name.removeprefix("level_").removesuffix(".csv") for name in names]
    numbers = [int(each) for each in digits if each.isdecimal() and map_file(folder, int(each)).name in names]
    n = max(numbers, default=0) + 1
    return n if n <= 2 * len(numbers) else max(1, len(names))


def check_width(swe: SweMap, probe_length: float) -> list[Problem]:
    """Check that a map is not wider than the image: a linear probe sees what lies under its face.

    probe_length : mm
    """
    half = float(np.abs(swe.lateral).max()) if len(swe) else 0.0
    if half <= _WIDEST * probe_length / 2:
        return []
    what = f"the map reaches {half:g} mm to the side; the probe's image ends at {probe_length / 2:g} mm"
    fix = "lateral_mm is in mm from the probe's centre, not pixels nor from the image's edge"
    return [problem(what, swe.path or Path("shear-wave map"), fix)]


def check_mean(swe: SweMap, mean_m_per_s: float) -> list[Problem]:
    """Check that a level's map and the mean in levels.csv can belong to the same reading.

    mean_m_per_s : m/s, NaN if levels.csv has none; one that is not positive is reported with levels.csv
    """
    if not np.isfinite(mean_m_per_s) or mean_m_per_s <= 0:
        return []
    if not len(swe):
        what = f"the map has no pixels, but levels.csv has a mean speed of {mean_m_per_s:.2f} m/s"
        fix = "export it again; a file with only the header means a level at which nothing was read"
        return [problem(what, swe.path or Path("shear-wave map"), fix, warning=True)]
    own = float(swe.speed_m_per_s.mean())
    if 1 / _AT_ODDS <= own / mean_m_per_s <= _AT_ODDS:
        return []
    what = f"the map's mean speed is {own:.2f} m/s, that of levels.csv {mean_m_per_s:.2f} m/s"
    fix = "one of them is not in m/s, or is of another level or another region of interest"
    return [problem(what, swe.path or Path("shear-wave map"), fix, warning=True)]


def check_map(path: Path) -> tuple[SweMap | None, list[Problem]]:
    """One map, if it is usable, and every problem (errors and warnings)."""
    columns = COLUMNS
    if _MODULUS in header_of(path, {*COLUMNS, _MODULUS}):
        columns = (*COLUMNS[:2], _MODULUS)
    table, problems = read_table(
        path, required=columns, optional=COLUMNS, may_be_empty=True, may_be_nan=(COLUMNS[2], _MODULUS)
    )
    if table is None or errors_of(problems):
        return None, problems
    if len(table.numbers) > len(columns):
        what = f"{_MODULUS} and {COLUMNS[2]} are two figures of one reading"
        return None, [*problems, problem(what, path, "keep one of the two columns")]
    lateral, depth, read = (table.numbers[name] for name in columns)
    speed = speed_from_young(read, np.full(len(read), np.nan))[0] if columns[2] == _MODULUS else read
    swe = SweMap(lateral, depth, speed, path)
    problems += _check_ranges(swe, table, path)
    problems += _check_repeats(swe, table, path)
    kept = np.isfinite(speed)
    return SweMap(lateral[kept], depth[kept], speed[kept], path), problems


def _check_ranges(swe: SweMap, table: RawTable, path: Path) -> list[Problem]:
    speeds = (COLUMNS[2], swe.speed_m_per_s, SPEED_LOW_M_PER_S, SPEED_HIGH_M_PER_S, "m/s, not cm/s or kPa")
    if _MODULUS in table.numbers:
        low, high = 3 * SPEED_LOW_M_PER_S**2, 3 * SPEED_HIGH_M_PER_S**2
        speeds = (_MODULUS, table.numbers[_MODULUS], low, high, "kPa, Young's modulus, not Pa or m/s")
    rules: Sequence[tuple[str, Array, float, float, str]] = (
        ("lateral_mm", swe.lateral, -_MAX_LATERAL, _MAX_LATERAL, "mm from the probe's centre, not pixels"),
        ("depth_mm", swe.depth, 0.0, _MAX_DEPTH, "mm below the probe face, downwards positive, not pixels"),
        (*speeds[:-1], f"{speeds[-1]}; omit pixels without a reading"),
    )  # fmt: skip
    problems = []
    for name, values, low, high, fix in rules:
        rows = np.flatnonzero((values < low) | (values > high))
        for k in rows[:_SHOWN]:
            what = f"{name} is {values[k]:g}; possible values are {low:g} to {high:g}"
            problems.append(problem(what, path, f"it is in {fix}", line=table.lines[k]))
        if len(rows) > _SHOWN:
            what = f"and {len(rows) - _SHOWN} more values of {name} like these"
            problems.append(problem(what, path, f"it is in {fix}"))
    return problems


def _check_repeats(swe: SweMap, table: RawTable, path: Path) -> list[Problem]:
    pixels = np.round(np.stack([swe.lateral, swe.depth], axis=1), 6)
    _, first, count = np.unique(pixels, axis=0, return_index=True, return_counts=True)
    again = first[count > 1]
    if not len(again):
        return []
    k = int(again[0])
    first_pixel = f"lateral {swe.lateral[k]:g}, depth {swe.depth[k]:g}"
    what = f"{len(again)} pixels appear more than once (first: {first_pixel})"
    return [problem(what, path, "keep one reading per pixel", line=table.lines[k])]
