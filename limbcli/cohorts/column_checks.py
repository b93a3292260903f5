"""Plausibility checks on the table of a cohort, applied to every row before anything is computed."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from limbcli.cohorts.table import (
    FACE,
    LAYERS,
    OF_PERSON,
    PERSON,
    PRESSURE,
    REQUIRED,
    SEX,
    SITE,
    TRIAL,
    CohortTable,
    read_cohort,
)
from limbcli.cohorts.unit_guess import common_factors, disagreeing, pressure_units, unusual_face
from limbcli.errors.problems import Problem, errors_of
from limbcli.measurement.edge_noise import EdgeNoise, layer_noise
from limbcli.measurement.number_table import RawTable, problem
from limbcli.model import Array

Rows = NDArray[np.bool_]
Listed = Callable[
    [Rows | np.bool_, Callable[[int], str], str], list[Problem]
]  # `_listed` of the complete rows

_SHOWN = 5  # largest number of rows listed per kind of problem
# tolerances (mm; fraction of the whole) of the sum of the layers against the whole: rounding
_SUM_MM, _SUM_SHARE = 0.1, 0.005
# a layer has grown if it did so by more than this many standard deviations of the noise and by this many mm
_GROWTH_SIGMAS, _LEAST_GROWTH = 6.0, 0.5
_FACE = (20.0, 10_000.0)  # plausible area of the probe face, mm2
_WHOLE = (1.0, 400.0)  # plausible distance from skin to bone, mm
# Smallest plausible median skin thickness of a table, mm: 752 rows of arms and legs (Neumann et al. 2018)
# have 1.4, and none less than 0.6.
_THINNEST_SKIN = 0.4
_FORCE = (0.05, 500.0)  # plausible force, N
# smallest contribution of fat and muscle to the whole's shortening, as a fraction: less is rounding
_LEAST_BELOW = 1e-3
# a slope that differs from pressure over depth by more than this factor is in the wrong unit
_SLOPE_OFF = 5.0
_R2_ROUNDING = 0.01


def checked_cohort(path: Path) -> tuple[CohortTable | None, list[Problem]]:
    """The complete rows of a table, if they are usable, and every problem."""
    raw, problems = read_cohort(path)
    if raw is None or errors_of(problems):
        return None, problems
    columns, lines = raw.numbers, np.array(raw.lines)
    complete = np.all([np.isfinite(columns[name]) for name in REQUIRED if name != "skin_mm"], axis=0)
    complete &= np.any([np.isfinite(columns[name]) for name in (FACE, PRESSURE) if name in columns], axis=0)
    listed = partial(_listed, complete, lines, path)
    problems += _unnamed(raw, listed, PERSON, "person") + _unnamed(raw, listed, SITE, "site")
    problems += _without_skin(raw, listed)
    n_left = int((~complete).sum())
    if n_left:
        words = f"{n_left} of {len(lines)} rows are missing a reading and are excluded{_at(lines[~complete])}"
        problems.append(problem(words, path, "fill the empty cells, or ignore this", warning=True))
    if not complete.any():
        problems.append(problem("no row is complete", path, "fill the empty cells"))
    if errors_of(problems):
        return None, problems
    all_rows = _table(raw, path)
    with np.errstate(all="ignore"):  # values that no tissue or probe can have; wrong units cause the others
        problems += _units(raw, all_rows, complete, listed) or _contradictions(raw, all_rows, listed)
    if errors_of(problems):
        return None, problems
    table = replace(all_rows.rows(complete), n_incomplete=n_left)
    if face := unusual_face(raw.numbers, all_rows.face, complete):
        fix = "check the units: a force in kgf makes it 9.8 times too small; if it is so, give face_mm2"
        problems.append(problem(face, path, fix))
    problems += _repeated(table) + _alike(table) + _sexes(table) + _partly_given(table)
    problems += _grown(table, layer_noise(table.shortened))
    return (None if errors_of(problems) else table), problems


def _at(lines: Array) -> str:
    named = ", ".join(str(each) for each in lines[:_SHOWN])
    return f" (lines {named}{' and others' if len(lines) > _SHOWN else ''})"


def _table(raw: RawTable, path: Path) -> CohortTable:
    columns = raw.numbers
    n = len(raw)
    thickness = np.stack([columns[f"{each}_mm"] for each in LAYERS], axis=1)
    strain = np.stack([columns[f"{each}_strain"] for each in LAYERS], axis=1)
    face = columns.get(FACE, np.full(n, np.nan))
    if PRESSURE in columns:
        face = np.where(np.isfinite(face), face, columns["max_force_n"] / columns[PRESSURE])
    text = {
        name: np.array(raw.texts.get(name, [""] * n), dtype=object) for name in (PERSON, SITE, TRIAL, SEX)
    }
    used = {*REQUIRED, FACE, PRESSURE}
    return CohortTable(
        person=text[PERSON], site=text[SITE], trial=text[TRIAL], sex=text[SEX],
        force=columns["max_force_n"], face=face, thickness=thickness, shortened=strain * thickness,
        slope=columns["stiffness_mpa_per_mm"],
        others={name: each for name, each in columns.items() if name not in used},
        lines=np.array(raw.lines), path=path,
    )  # fmt: skip


def _listed(
    complete: Rows, lines: Array, path: Path, wrong: Rows | np.bool_, words: Callable[[int], str], fix: str
) -> list[Problem]:
    """A problem for each of the first complete rows that are wrong, and one for the remaining ones."""
    rows = np.flatnonzero(complete & wrong)
    found = [problem(words(k), path, fix, line=int(lines[k])) for k in rows[:_SHOWN]]
    if len(rows) > _SHOWN:
        found.append(problem(f"and {len(rows) - _SHOWN} more rows like these", path, fix))
    return found


def _unnamed(raw: RawTable, listed: Listed, name: str, noun: str) -> list[Problem]:
    """Rows without person or site: they would all be treated as one person, or one site."""
    return listed(
        np.array([not cell for cell in raw.texts[name]]),
        lambda k: f"the {noun} is missing",
        f"enter the {noun} in every row, even if it is the same as in the row above",
    )


def _without_skin(raw: RawTable, listed: Listed) -> list[Problem]:
    skin = raw.numbers["skin_mm"]
    others = np.isfinite(raw.numbers["fat_mm"]) | np.isfinite(raw.numbers["muscle_mm"])
    return listed(
        others & (~np.isfinite(skin) | (skin == 0.0)),
        lambda k: "there are layers below the skin, but no skin thickness: skin_mm is empty or 0",
        "also mark the border between skin and fat: without it the fat's thickness includes the skin's",
    )


def _units(raw: RawTable, table: CohortTable, complete: Rows, listed: Listed) -> list[Problem]:
    columns, lines, path = raw.numbers, table.lines, table.path
    whole, force, strain = columns["thickness_mm"], columns["max_force_n"], columns["total_strain"]
    depth = strain * whole
    found = listed(
        ~((whole >= _WHOLE[0]) & (whole <= _WHOLE[1])),
        lambda k: f"thickness_mm is {whole[k]:g}: its unit looks wrong",
        "give millimetres",
    )
    skin = columns["skin_mm"]
    middle = float(np.median(skin[complete])) if np.isfinite(skin[complete]).all() else np.nan
    if 0 < middle < _THINNEST_SKIN:
        what = f"the skin is {middle:.2g} mm thick in the median of all rows: the unit of lengths looks wrong"
        what += " (usual are 1 to 2 mm, which are 0.1 to 0.2 cm, or 0.04 to 0.08 inch)"
        found.append(problem(what, path, "give skin_mm and all other lengths in millimetres"))
    found += listed(
        ~((force >= _FORCE[0]) & (force <= _FORCE[1])),
        lambda k: f"max_force_n is {force[k]:g}: its unit looks wrong",
        "give newtons",
    )
    found += listed(
        ~((table.face >= _FACE[0]) & (table.face <= _FACE[1])),
        lambda k: f"the probe's face is {table.face[k]:g} mm2: a unit of face, force or pressure looks wrong",
        "give face_mm2 in mm2, or max_pressure_mpa in MPa and max_force_n in N",
    )
    percent = np.max([np.abs(columns[f"{each}_strain"]) for each in ("total", *LAYERS)], axis=0)
    found += listed(
        percent > 2.0,
        lambda k: f"a strain is {percent[k]:g}: its unit looks wrong",
        "give shortening over thickness (0.2, not 20)",
    )
    found += _pressure_against_force(raw, complete, listed)
    secant = force / table.face / depth
    off = table.slope / secant
    explained = np.zeros(len(lines), dtype=bool)
    for rows, words in common_factors(raw, complete & (depth > 0) & (off > 0), secant, table.slope):
        explained |= rows
        fix = "give the slope in MPa/mm, forces in N, faces in mm2 and lengths in mm"
        found.append(problem(words, path, fix, line=int(lines[np.argmax(rows)])))
    found += listed(
        ~explained & (depth > 0) & ~((off > 1 / _SLOPE_OFF) & (off < _SLOPE_OFF)),
        lambda k: (
            f"stiffness_mpa_per_mm is {table.slope[k]:g} but pressure over displacement is {secant[k]:.3g}: "
            "its unit looks wrong"
        ),
        "give the slope of pressure (MPa) over displacement (mm)",
    )
    return found


def _pressure_against_force(raw: RawTable, complete: Rows, listed: Listed) -> list[Problem]:
    """The pressure must be force over face where all three are given."""
    columns, wrong = raw.numbers, complete & disagreeing(raw.numbers)
    if not wrong.any():
        return []
    ratio = columns[PRESSURE] * columns[FACE] / columns["max_force_n"]
    middle = float(np.median(ratio[wrong]))
    units = pressure_units(middle) if middle > 0 else ""
    return listed(
        wrong,
        lambda k: (
            f"max_pressure_mpa is {columns[PRESSURE][k]:g}, but max_force_n over face_mm2 is "
            f"{columns['max_force_n'][k] / columns[FACE][k]:.3g}: they differ by the factor {ratio[k]:.3g}"
        ),
        f"correct one of the three, or leave max_pressure_mpa empty; the median factor is {middle:.3g}: "
        f"{units}",
    )


def _contradictions(raw: RawTable, table: CohortTable, listed: Listed) -> list[Problem]:
    columns, n = raw.numbers, len(raw)
    whole, depth = columns["thickness_mm"], columns["total_strain"] * columns["thickness_mm"]
    apart = np.abs(table.whole - whole)
    found = listed(
        (table.thickness <= 0).any(axis=1),
        lambda k: (
            "interfaces cross at first contact: "
            + ", ".join(f"{name} {table.thickness[k, j]:g} mm" for j, name in enumerate(LAYERS))
        ),
        "a layer's lower border lies below its upper one; mark them again",
    )
    found += listed(
        apart > _SUM_MM + _SUM_SHARE * whole,
        lambda k: f"the layers add up to {table.whole[k]:.2f} mm, thickness_mm is {whole[k]:.2f}",
        "adjacent layers must share their borders; correct thickness_mm or a layer",
    )
    crossing = (table.shortened >= table.thickness) & (table.thickness > 0)
    found += listed(
        crossing.any(axis=1),
        lambda k: (
            f"interfaces cross under load: the {LAYERS[int(np.argmax(crossing[k]))]} shortens by its "
            f"whole thickness"
        ),
        "mark the image at the largest force again; a strain stays below 1",
    )
    missed = np.abs(table.depth - depth)
    found += listed(
        missed > _SUM_MM + 0.02 * np.abs(depth),
        lambda k: f"the layers shorten by {table.depth[k]:.2f} mm, the total by {depth[k]:.2f}",
        "correct total_strain or a layer's strain",
    )
    found += listed(
        depth <= 0,
        lambda k: f"the total thickness increases under load: total_strain is {columns['total_strain'][k]:g}",
        "shortening counts positive; mark both images again",
    )
    below = table.shortened[:, 1:].sum(axis=1)
    found += listed(
        (depth > 0) & (below < _LEAST_BELOW * depth),
        lambda k: (
            f"fat and muscle together do not shorten under load: {table.shortened[k, 1]:.2f} and "
            f"{table.shortened[k, 2]:.2f} mm, of {depth[k]:.2f} mm"
        ),
        "shortening counts positive; mark the borders of both images again",
    )
    line, parabola = (columns.get(f"r2_{name}", np.full(n, np.nan)) for name in ("line", "parabola"))
    found += listed(
        (line > 1.0) | (parabola > 1.0) | (parabola < line - _R2_ROUNDING),
        lambda k: (
            f"r2_line is {line[k]:g} and r2_parabola {parabola[k]:g}: neither exceeds 1, and a parabola fits "
            "no worse than a line"
        ),
        "correct them, or leave both empty (are they in percent, or exchanged?)",
    )
    girth = columns.get("circumference_mm", np.full(n, np.nan))
    found += listed(
        np.nan_to_num(girth, nan=np.inf) <= np.pi * whole,
        lambda k: (
            f"a circumference of {girth[k]:g} mm is smaller than the layers allow: a limb {whole[k]:g} mm "
            f"thick from skin to bone measures more than {np.pi * whole[k]:.0f} mm round"
        ),
        "give the limb's circumference at the site in mm, or leave the cell empty",
    )
    return found


def _repeated(table: CohortTable) -> list[Problem]:
    """The same person, site and trial in more than one row."""
    first: dict[tuple[str, str, str], int] = {}
    found, fix = [], "remove one of them, or number the repetitions in a column `trial`"
    for k, key in enumerate(zip(table.person, table.site, table.trial, strict=True)):
        if (before := first.setdefault(key, k)) != k:
            words = f"person {key[0]}, site {key[1]} is already in line {table.lines[before]}"
            found.append(problem(words, table.path, fix, line=int(table.lines[k])))
    return found[:_SHOWN]


def _alike(table: CohortTable) -> list[Problem]:
    """Names of people and sites that differ only in capitals, spaces or leading zeros: possibly the same."""
    found = []
    for noun, names in (("people", table.people), ("sites", table.sites)):
        written: dict[str, list[str]] = {}
        for name in names:
            written.setdefault(_plain(name), []).append(name)
        twice = [each for each in written.values() if len(each) > 1]
        if twice:
            listed = "; ".join(" and ".join(map(repr, each)) for each in twice[:_SHOWN])
            more = " and others" if len(twice) > _SHOWN else ""
            words = f"{noun} whose names barely differ are treated as different: {listed}{more}"
            fix = "write the name the same way in all rows, if they are the same"
            found.append(problem(words, table.path, fix, warning=True))
    return found


def _plain(name: str) -> str:
    """A name normalised for typical variations when it is typed again.

    >>> _plain("006") == _plain(" 6"), _plain("LL_P") == _plain("ll p"), _plain("1-2") == _plain("12")
    (True, True, False)
    """
    words = re.sub(r"[\W_]+", " ", name.casefold()).strip()
    return re.sub(r"(?<!\d)0+(?=\d)", "", words)


def _sexes(table: CohortTable) -> list[Problem]:
    """More than two values, for which a prediction could not use one column."""
    words = sorted({each for each in table.sex.tolist() if each})
    if len(words) <= 2:
        return []
    listed = ", ".join(map(repr, words[:_SHOWN]))
    what = f"sex contains {len(words)} different words ({listed}), so it is not used"
    fix = "write one word for each of two, spelled the same in all rows"
    return [problem(what, table.path, fix, warning=True)]


def _partly_given(table: CohortTable) -> list[Problem]:
    """Data given for only some people, which a prediction for all cannot use as a column."""
    empty = {name: np.isnan(table.others[name]) for name in OF_PERSON if name in table.others}
    empty[SEX] = np.array([not each for each in table.sex])
    return [
        problem(
            f"{name} is empty in {int(rows.sum())} of {len(rows)} rows, so it is not used"
            f"{_at(table.lines[rows])}",
            table.path, "fill the empty cells, or ignore this", warning=True,
        )
        for name, rows in empty.items() if rows.any() and not rows.all()
    ]  # fmt: skip


def _grown(table: CohortTable, noise: EdgeNoise) -> list[Problem]:
    limit = np.maximum(_GROWTH_SIGMAS * noise.shortened, _LEAST_GROWTH)
    growing: Rows = np.asarray(table.shortened < -limit)
    return _listed(
        np.ones(len(growing), dtype=bool),
        table.lines,
        table.path,
        np.asarray(growing.any(axis=1)),
        lambda k: (
            f"the {LAYERS[j := int(np.argmax(growing[k]))]} grows by {-table.shortened[k, j]:.2f} mm "
            f"under load, more than the noise of its edges ({noise.shortened[j]:.2f} mm) allows"
        ),
        "shortening counts positive; mark the borders of both images again",
    )
