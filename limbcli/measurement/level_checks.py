"""Check the levels of an indentation for impossible and unusual values.

Every check reports its problems with the line and the usual mistake; wrong units show in the stiffness.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from limbcli.errors.problems import SPEED_FROM_KPA, Problem
from limbcli.measurement.layer_checks import LayerNoise
from limbcli.measurement.levels import FEWEST_LOADING, TOUCH_FORCE, Levels
from limbcli.measurement.number_table import RawTable, problem
from limbcli.model import Array
from limbcli.numbers.units import mpa_from_pa

# Range of values for a probe pressed on a calf by hand. Indentation of residual limbs: stiffness 0.3 to 8
# N/mm over 2 to 30 mm (Zheng & Mak 1999; a footprint of 44 x 10 to 53 x 14 mm).
MIN_FORCE, MAX_FORCE = -3.0, 150.0  # N; below: a load cell that was not tared; above: more than a limb bears
_MAX_DEPTH = 60.0
_STIFFNESS_LOW, _STIFFNESS_HIGH = 0.04, 40.0
_STIFFNESS_UNUSUAL_LOW, _STIFFNESS_UNUSUAL_HIGH = 0.2, 8.0
_PUNCH_LENGTH = 260.0
_RATIO_LOW, _RATIO_HIGH = 0.2, 10.0
_RATIO_UNUSUAL_LOW, _RATIO_UNUSUAL_HIGH = 0.4, 6.0
_SPEED_LOW_M_PER_S, _SPEED_HIGH_M_PER_S = 0.3, 15.0
_SPEED_UNUSUAL_M_PER_S = 4.0  # at 0 N
_TOLERATED_FORCE_DROP = 1.0
_SILENT_FORCE_DROP = 0.3
_PULL = 0.5  # N below 0 explained by noise and drift of the load cell
_TARE = "subtract its reading in air from every force (tare_s of [site.load_cell] does so)"
# Largest contradiction between skin_bone_mm and depth_mm: mm, and standard deviations of the depth.
_DISTANCE_OFF, _DISTANCE_SIGMAS = 2.0, 4.0
# Largest distance of level 0 from 0 mm, in standard deviations of the depth; ratio of initial to mean
# compliance that explains a larger one.
_ZERO_SIGMAS, _SOFTER_AT_FIRST = 2.0, 4.0


def check_count(levels: Levels, path: Path) -> list[Problem]:
    n = int(levels.loading.sum())
    if len(levels) == 1:
        fix = "measure in steps of about 2 N; a curve needs at least three levels"
        return [problem("there is only one level", path, fix)]
    if n < FEWEST_LOADING:
        fix = "a curve with two parameters needs at least three levels of loading"
        return [problem(f"there are only {n} levels of loading", path, fix)]
    counts = {cycle: levels.n_loading(cycle) for cycle in levels.cycles}
    if max(counts.values()) < FEWEST_LOADING:
        fix = "a curve needs at least three levels of loading in one cycle"
        what = f"no cycle has more than {max(counts.values())} levels of loading"
        return [problem(what, path, fix)]
    return []


def check_phase(levels: Levels, table: RawTable, path: Path) -> list[Problem]:
    return [
        problem(f"phase is {name!r}", path, "write `load` or `unload`", line=line)
        for name, line in zip(levels.phase, table.lines, strict=True)
        if name not in ("load", "unload")
    ]


def check_cycles(levels: Levels, table: RawTable, path: Path) -> list[Problem]:
    """Cycles must be numbered from 1 without gaps, in the order measured, and load before they unload."""
    problems = []
    numbers = table.numbers.get("cycle")
    if numbers is not None:
        for k in np.flatnonzero(~((numbers >= 1) & (numbers == np.round(numbers)))):
            shown = "empty" if np.isnan(numbers[k]) else f"{numbers[k]:g}"
            fix = "number the loadings 1, 2, 3, ...; a cycle is one loading with the unloading after it"
            problems.append(problem(f"cycle is {shown}", path, fix, line=table.lines[k]))
        if problems:
            return problems
    cycle = levels.cycle
    if cycle[0] != 1:
        fix = "the first loading is cycle 1"
        problems.append(problem(f"the first row is of cycle {cycle[0]}", path, fix, line=table.lines[0]))
    for row in range(1, len(levels)):
        before, now, line = int(cycle[row - 1]), int(cycle[row]), table.lines[row]
        if now < before:
            what = f"the cycles are out of order: cycle {now} comes after cycle {before}"
            problems.append(problem(what, path, "give rows in the order measured", line=line))
        elif now > before + 1:
            what = f"cycle {now} follows cycle {before}: {_skipped(before, now)} without a row"
            problems.append(problem(what, path, "number the loadings 1, 2, 3, ...", line=line))
        elif now == before and levels.phase[row - 1] == "unload" and levels.phase[row] == "load":
            what = f"the tissue is loaded again within cycle {now}"
            fix = "give each loading its own cycle (column cycle: 1, 2, ...), or correct the phase"
            problems.append(problem(what, path, fix, line=line))
    return problems


def _skipped(before: int, now: int) -> str:
    """
    >>> _skipped(1, 3), _skipped(1, 5)
    ('cycle 2 is', 'cycles 2 to 4 are')
    """
    return f"cycle {now - 1} is" if now == before + 2 else f"cycles {before + 1} to {now - 1} are"


# Physical limits: column, least, most, meaning and the usual mistake.
_POSSIBLE: tuple[tuple[str, float, float, str], ...] = (
    ("force_n", MIN_FORCE, MAX_FORCE,
     "N, compression positive; is it in grams (divide by 102), the sign reversed, or a tare missing?"),
    ("depth_mm", -1.0, _MAX_DEPTH, "mm; is it in micrometres, or the sign reversed?"),
    ("swe_sd_m_per_s", 0.0, _SPEED_HIGH_M_PER_S, "m/s; is it in cm/s?"),
    ("swe_pixels", 1.0, 1e7, "pixels"),
    ("hold_s", 0.0, 3600.0, "s; is the time in milliseconds?"),
    ("skin_bone_mm", 0.5, 150.0, "mm"),
    ("skin_mm", -50.0, 10.0, "mm; is it in micrometres, or the fat's?"),
    ("fat_mm", -50.0, 120.0, "mm; is it in micrometres?"),
    ("muscle_mm", -50.0, 150.0, "mm; is it in micrometres?"),
)  # fmt: skip


def check_values(
    columns: Mapping[str, Array | Sequence[float]], path: Path, *, lines: list[int] | None = None
) -> list[Problem]:
    """Values outside the physical limits, cell by cell.

    columns : by their name in levels.csv, (n_levels,) each
    lines : line numbers in the file, one per level, if there is a file
    """
    problems = []
    for name, low, high, meaning in _POSSIBLE:
        values = np.asarray(columns.get(name, ()), dtype=float)
        for k in np.flatnonzero((values < low) | (values > high)):
            what = f"{name} is {values[k]:g}; possible values are {low:g} to {high:g}"
            what += "" if lines else f" (level {k})"
            problems.append(problem(what, path, f"correct it ({meaning})", line=lines[k] if lines else None))
    return problems


def check_columns(levels: Levels, table: RawTable, path: Path) -> list[Problem]:
    columns = {
        "force_n": levels.force, "depth_mm": levels.depth, "swe_sd_m_per_s": levels.swe_sd_m_per_s,
        "swe_pixels": levels.swe_pixels, "hold_s": levels.hold, "skin_bone_mm": levels.skin_bone,
        **{f"{name}_mm": values for name, values in levels.layers.items()},
    }  # fmt: skip
    return check_values(columns, path, lines=table.lines)


_AGAIN = "rows in the order measured; mark unloading with phase = unload, and a second loading with cycle = 2"


def check_order(levels: Levels, table: RawTable, path: Path) -> list[Problem]:
    problems = []
    legs = [(cycle, *leg) for cycle in levels.cycles for leg in (("load", 1.0), ("unload", -1.0))]
    for number, phase, sign in legs:
        rows = np.flatnonzero(levels.cycle == number)
        rows = np.array([k for k in rows if levels.phase[k] == phase], dtype=int)
        force, depth = sign * levels.force[rows], sign * levels.depth[rows]
        lines = [table.lines[k] for k in rows]
        if sign > 0 and len(rows) >= FEWEST_LOADING and _runs_backwards(force, depth):
            what = (
                f"depth_mm decreases while force_n increases (lines {lines[0]} to {lines[-1]}, phase {phase})"
            )
            fix = (
                "is the column reversed, or a distance instead of a decrease? It is the decrease in "
                "skin-bone distance "
            )
            problems.append(problem(what, path, f"{fix}since level 0", line=lines[0]))
            continue
        if sign > 0 and len(rows) >= FEWEST_LOADING and _falls(force, depth):
            what = (
                f"force_n falls from {force[0]:g} N to {force[-1]:g} N over the levels of loading "
                f"(lines {lines[0]} to {lines[-1]})"
            )
            fix = f"are they in reverse order, or those of unloading? Write the {_AGAIN}"
            problems.append(problem(what, path, fix, line=lines[0]))
            continue
        for k in range(1, len(rows)):
            place = f"line {lines[k - 1]} to {lines[k]}"
            if force[k] == force[k - 1] and depth[k] == depth[k - 1]:
                problems.append(problem(f"the level of {place} is repeated", path, "keep one", line=lines[k]))
            elif force[k] < force[k - 1] - _TOLERATED_FORCE_DROP and depth[k] > depth[k - 1]:
                fix = f"write the {_AGAIN}"
                what = f"the force decreases while the depth increases ({place}, phase {phase})"
                problems.append(problem(what, path, fix, line=lines[k]))
            elif force[k] < force[k - 1] - _TOLERATED_FORCE_DROP:
                fix = f"sort the {_AGAIN}"
                what = f"the levels are not in order of force ({place}, phase {phase})"
                problems.append(problem(what, path, fix, line=lines[k]))
            elif sign > 0 and force[k] < force[k - 1] - _SILENT_FORCE_DROP and depth[k] > depth[k - 1]:
                what = (
                    f"the force decreases by {force[k - 1] - force[k]:.2g} N while the depth increases "
                    f"({place})"
                )
                fix = "check the reading, or measure this level again"
                problems.append(problem(what, path, fix, line=lines[k], warning=True))
            elif depth[k] < depth[k - 1]:
                fix = "check the depth reading of these levels"
                fix += "; they are simulated in order of depth" if sign > 0 else ""
                verb = "shrinks" if sign > 0 else "grows"
                with_force = "while the force does not" if force[k] >= force[k - 1] else "with the force"
                what = f"the depth {verb} by {depth[k - 1] - depth[k]:.2g} mm {with_force} "
                what += f"({place}, phase {phase})"
                problems.append(problem(what, path, fix, line=lines[k], warning=True))
    return problems


def _falls(force: Array, depth: Array) -> bool:
    """Whether levels of loading end at less than they began with.

    >>> _falls(np.array([2.0, 1.2, 0.4]), np.array([4.0, 2.0, 1.0]))
    True
    >>> _falls(np.array([0.0, 2.0, 1.5]), np.arange(3))
    False
    """
    steadily = (np.diff(force) < 0).all() and depth[-1] < depth[0]
    return bool(steadily or force[-1] < force[0] - _TOLERATED_FORCE_DROP)


def _runs_backwards(force: Array, depth: Array) -> bool:
    """Whether more pairs of levels (n_levels,) are discordant than concordant (Kendall's tau < 0).

    >>> _runs_backwards(np.array([0.0, 2, 4]), np.array([5.0, 3, 0]))
    True
    >>> _runs_backwards(np.array([0.0, 2, 4, 6]), np.array([0.0, 5, 4, 3]))
    False
    """
    of_force, of_depth = (np.sign(np.subtract.outer(each, each)) for each in (force, depth))
    return bool((of_force * of_depth).sum() < 0)


def check_distance(
    levels: Levels, table: RawTable, path: Path, *, noise: LayerNoise | None = None
) -> list[Problem]:
    """The decrease of the skin-bone distance must equal depth_mm, and must not be the whole distance.

    Both count from the first level that has the distance, wherever the depths begin.
    """
    measured = np.flatnonzero(np.isfinite(levels.skin_bone))
    if not len(measured):
        return []
    first = int(measured[0])
    distance, lost = float(levels.skin_bone[first]), levels.depth - levels.depth[first]
    beyond = np.flatnonzero(lost >= distance)
    if len(beyond):
        k = int(beyond[0])
        what = f"depth_mm is {levels.depth[k]:g}, but the bone lies {distance:g} mm below the skin "
        what += f"(skin_bone_mm, line {table.lines[first]})"
        fix = "depth_mm is the decrease in skin_bone_mm; are both in mm, and are the columns not swapped?"
        return [problem(what, path, fix, line=table.lines[k])]
    deviation = (noise or LayerNoise()).depth
    allowed = max(_DISTANCE_OFF, _DISTANCE_SIGMAS * np.sqrt(2) * deviation)
    off = np.flatnonzero(np.abs(distance - levels.skin_bone - lost) > allowed)
    if not len(off):
        return []
    k, several = int(off[0]), f"{len(off)} levels: here" if len(off) > 1 else "one level:"
    what = f"skin_bone_mm and depth_mm contradict each other at {several} the distance has "
    what += f"become {distance - levels.skin_bone[k]:.3g} mm shorter, the depth {lost[k]:.3g} mm larger"
    fix = "one of the columns has another unit or level; are force_n and depth_mm swapped?"
    if len(off) == 1:
        fix = "check both readings of this level"
    return [problem(what, path, fix, line=table.lines[k], warning=True)]


def check_zero(
    levels: Levels, table: RawTable, path: Path, *, noise: LayerNoise | None = None
) -> list[Problem]:
    """Level 0 is the origin of the depths: if it is not at 0, all depths are shifted.

    A force that was already acting explains such a depth, with a curve that is softest at its start. Depths
    that fall are the matter of `check_order`.
    """
    at, force = float(levels.depth[0]), max(float(levels.force[0]), 0.0)
    loading = levels.loading
    span_force, span_depth = (float(np.ptp(each[loading])) for each in (levels.force, levels.depth))
    if levels.phase[0] != "load" or levels.force[0] > TOUCH_FORCE or at > levels.depth[loading].min():
        return []
    if span_force <= 0 or span_depth <= 0:
        return []
    unsure = _ZERO_SIGMAS * (noise or LayerNoise()).depth
    if -unsure <= at <= unsure + _SOFTER_AT_FIRST * force * span_depth / span_force:
        return []
    what = f"level 0 is at {at:.3g} mm and {levels.force[0]:.3g} N, but depth_mm counts from level 0"
    fix = f"subtract {at:.3g} mm from every depth if this is first touch; otherwise also measure first touch"
    return [problem(what, path, fix, line=table.lines[0], warning=levels.begins_at_zero)]


def check_tare(levels: Levels, table: RawTable, path: Path) -> list[Problem]:
    """Report a force below 0 at first touch: tissue cannot pull, so all readings of the cell are offset."""
    force = float(levels.force[0])
    if force >= -_PULL:
        return []
    what = (
        f"force_n is {force:.3g} N at the first level: tissue does not pull, so the load cell's zero is off"
    )
    return [problem(what, path, _TARE, line=table.lines[0], warning=True)]


def check_plausible(levels: Levels, path: Path, *, speed_is_possible: bool) -> list[Problem]:
    """Wrong units show in the stiffness of a loading.

    Depths in cm make it ten times too high, forces in kgf ten times too low.
    """
    problems = []
    for cycle in levels.cycles:
        if len(levels.cycles) > 1 and levels.n_loading(cycle) < FEWEST_LOADING:
            continue
        named = f" in cycle {cycle}" if len(levels.cycles) > 1 else ""
        rows = np.flatnonzero((levels.cycle == cycle) & levels.loading)
        span_depth, span_force = (float(np.ptp(each[rows])) for each in (levels.depth, levels.force))
        if span_force <= 0 or span_depth <= 0:
            fix = "check both columns; the depth is counted from level 0"
            what = f"force or depth does not increase over the levels{named}"
            return [problem(what, path, fix)]
        expected = _expected_stiffness(levels, int(rows[0])) if speed_is_possible else np.nan
        problems += _check_stiffness(span_force / span_depth, expected, path, named)
    if not levels.begins_at_zero:
        fix = (
            "level 0 is first touch: about 0 N and 0 mm; c is taken from the first row's speed without "
            "correction"
        )
        fix += f"; if the load cell was not tared, {_TARE}" if levels.depth[0] <= 0 < levels.force[0] else ""
        what = f"there is no level 0: the first row is at {levels.force[0]:g} N and {levels.depth[0]:g} mm"
        what += "" if levels.phase[0] == "load" else ", unloading"
        problems.append(problem(what, path, fix, warning=True))
    return problems


def _check_stiffness(stiffness: float, expected: float, path: Path, named: str) -> list[Problem]:
    """Compare with the stiffness of limbs, and with that from this tissue's wave speed (NaN: unknown).

    named : words for the cycle, if there are several
    """
    text = f"force over depth is {stiffness:.3g} N/mm{named}"
    stiff_fix = "depth_mm is in mm (is it in cm?), force_n in N (is it in grams?)"
    soft_fix = "force_n is in N (is it in kgf? multiply by 9.80665), depth_mm in mm"
    ratio = stiffness / expected
    if np.isfinite(ratio):
        stiff_fix += ", swe_mean_m_per_s in m/s"
        soft_fix += ", swe_mean_m_per_s in m/s (is it a modulus in kPa?)"
    if stiffness > _STIFFNESS_HIGH or ratio > _RATIO_HIGH:
        return [problem(f"{text}; no limb{_than(ratio)} is that stiff", path, stiff_fix)]
    if stiffness < _STIFFNESS_LOW or ratio < _RATIO_LOW:
        return [problem(f"{text}; no limb{_than(ratio)} is that soft", path, soft_fix)]
    unusual = not _STIFFNESS_UNUSUAL_LOW <= stiffness <= _STIFFNESS_UNUSUAL_HIGH
    if unusual or ratio > _RATIO_UNUSUAL_HIGH or ratio < _RATIO_UNUSUAL_LOW:
        fix = "check the units (N, mm, m/s); kgf, cm and kPa are common mistakes"
        return [problem(f"{text}, which is unusual{_than(ratio)}", path, fix, warning=True)]
    return []


def _expected_stiffness(levels: Levels, row: int) -> float:
    """Stiffness (N/mm) of a flat probe on tissue with the modulus from this row's wave speed; NaN without it.

    F / (mu depth) is 200 to 340 mm for usual linear probes over 15 to 35 mm of tissue (linear elastic, bonded
    to bone).
    """
    speed = float(levels.swe_mean_m_per_s[row])
    return mpa_from_pa(1000.0 * speed**2) * _PUNCH_LENGTH


def _than(ratio: float) -> str:
    return f" ({ratio:.2g} times what its shear-wave speed implies)" if np.isfinite(ratio) else ""


def check_swe(levels: Levels, table: RawTable, path: Path) -> list[Problem]:
    speed = levels.swe_mean_m_per_s
    problems = []
    if not levels.has_swe:
        fix = "add swe_mean_m_per_s, or enter the stiffness: --c-kpa to both `build-feb` and `fit`"
        return [problem("there is no shear-wave speed at any level", path, fix, warning=True)]
    for k in np.flatnonzero((speed < _SPEED_LOW_M_PER_S) | (speed > _SPEED_HIGH_M_PER_S)):
        too_fast = speed[k] > _SPEED_HIGH_M_PER_S
        unit = "in m/s (is it a modulus in MPa, or a masked value?)"
        if too_fast:
            unit = f"in m/s (is it in cm/s, or a modulus in kPa? then write {SPEED_FROM_KPA})"
        name = "swe_mean_m_per_s"
        if name not in table.numbers:
            name, unit = "the speed from swe_mean_young_kpa", "Young's modulus in kPa (is it in Pa or MPa?)"
        what = f"{name} is {speed[k]:g}; soft tissue gives {_SPEED_LOW_M_PER_S:g} to "
        what += f"{_SPEED_HIGH_M_PER_S:g} m/s"
        problems.append(problem(what, path, f"the column is {unit}", line=table.lines[k]))
    if speed[0] > _SPEED_UNUSUAL_M_PER_S:
        what = f"the speed at level 0 is {speed[0]:g} m/s; relaxed soft tissue is slower, mostly 1 to 3.5 m/s"
        fix = "check that the column holds speeds (m/s), not a modulus (kPa), and that the muscle was relaxed"
        problems.append(problem(what, path, fix, line=table.lines[0], warning=True))
    if not np.isfinite(speed[0]):
        fix = "c comes from the speed at level 0; measure it, or give --c-kpa to both `build-feb` and `fit`"
        problems.append(
            problem("level 0 has no shear-wave speed", path, fix, line=table.lines[0], warning=True)
        )
    needed = speed[levels.loading]  # speeds are not used in unloading
    n_missing = int(np.isnan(needed).sum())
    if 0 < n_missing < len(needed):
        way = "" if len(needed) == len(speed) else " of loading"
        what = f"{n_missing} of {len(needed)} levels{way} have no shear-wave speed"
        problems.append(problem(what, path, "they are excluded from the SWE figures", warning=True))
    return problems
