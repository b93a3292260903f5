"""Columns of a cohort's table against each other: redundant ones, and a factor common to all rows of a place.

A wrong unit of force, pressure, length or slope multiplies a whole column. Where the columns together have a
reading that does not depend on the unit's choice, the factor shows, and the units that it fits are named.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from limbcli.cohorts.table import FACE, PRESSURE, SITE
from limbcli.measurement.number_table import RawTable
from limbcli.model import Array
from limbcli.numbers.units import FORCE_UNITS_IN_N, LENGTH_UNITS_IN_MM, PRESSURE_UNITS_IN_MPA

Rows = NDArray[np.bool_]

_AGREE = 0.01  # by which force over face may differ from the pressure, beside the rounding of the three
# ln of the slope of the secant over that of the line from first contact: 98 % of the layered family's members
# (m 1.5 to 12, any layers) have 0.01 to 0.72; medians of eight places of arms and legs (Neumann et al. 2018)
# -0.02 to 0.07.
REACH = (0.0, 0.72)
_TYPICAL = 0.3
_BEYOND = 0.25  # distance from it, of a median, that no scatter of a place's rows explains
_NAMED = 0.08  # ln, how near a unit's factor must be
_FEWEST_ROWS = 3
_USUAL_FACE = (150.0, 2500.0)  # mm2, of ultrasound probes
_NO_UNIT = "no unit that we know fits"


def disagreeing(columns: Mapping[str, Array]) -> Rows:
    """Rows (n,) whose pressure is not force over face within the rounding of the three columns."""
    if FACE not in columns or PRESSURE not in columns:
        return np.zeros(len(columns["max_force_n"]), dtype=bool)
    names = ("max_force_n", FACE, PRESSURE)
    force, face, pressure = (columns[name] for name in names)
    allowed = _AGREE + sum(np.array([_rounding(each) for each in columns[name]]) for name in names)
    return np.asarray(np.abs(np.log(pressure * face / force)) > allowed)


def _rounding(value: float) -> float:
    """Half a unit of a number's last digit, as a fraction of it; 0 for numbers that are not known or 0.

    >>> _rounding(0.02), _rounding(250.0), _rounding(float("nan"))
    (0.25, 0.002, 0.0)
    """
    if not np.isfinite(value) or value == 0:
        return 0.0
    exponent = Decimal(f"{value:.12g}").as_tuple().exponent
    assert isinstance(exponent, int)
    return float(0.5 * 10.0**exponent / abs(value))


def pressure_units(ratio: float) -> str:
    """Units that explain a pressure `ratio` times force over face."""
    force = {f"max_force_n in {name}": size for name, size in FORCE_UNITS_IN_N.items()}
    pressure = {f"max_pressure_mpa in {name}": 1 / size for name, size in PRESSURE_UNITS_IN_MPA.items()}
    face = {f"face_mm2 in {name} squared": 1 / size**2 for name, size in LENGTH_UNITS_IN_MM.items()}
    return _fitting({**pressure, **force, **face}, np.log(ratio), np.log(ratio))


def common_factors(raw: RawTable, complete: Rows, secant: Array, slope: Array) -> Iterator[tuple[Rows, str]]:
    """Places whose secants (MPa/mm) are off their slopes by a common factor: the rows and the words."""
    ratio = np.log(secant / slope)
    sites = np.array(raw.texts[SITE], dtype=object)
    for site in sorted(set(sites[complete].tolist())):
        rows = complete & (sites == site) & np.isfinite(ratio)
        middle = float(np.median(ratio[rows])) if rows.sum() >= _FEWEST_ROWS else REACH[0]
        if REACH[0] - _BEYOND <= middle <= REACH[1] + _BEYOND:
            continue
        factor = np.exp(middle)
        shown = f"{factor:.3g} times" if factor > 1 else f"1/{1 / factor:.3g} of"
        yield (
            rows,
            (
                f"{site}: pressure over displacement at the largest force is {shown} stiffness_mpa_per_mm in "
                f"the median of {int(rows.sum())} rows; curves of tissue have {np.exp(REACH[0]):.2f} to "
                f"{np.exp(REACH[1]):.2f}: its unit looks wrong. {_units_of(raw, middle)}"
            ),
        )


def _units_of(raw: RawTable, middle: float) -> str:
    """Units that bring ln secant over slope back to what tissue has."""
    by_force = {f"max_force_n in {name}": 1 / size for name, size in FORCE_UNITS_IN_N.items()}
    by_pressure = {f"max_pressure_mpa in {name}": 1 / size for name, size in PRESSURE_UNITS_IN_MPA.items()}
    by_face = {f"face_mm2 in {name} squared": size**2 for name, size in LENGTH_UNITS_IN_MM.items()}
    by_slope = {
        f"stiffness_mpa_per_mm in {name} per mm": size for name, size in PRESSURE_UNITS_IN_MPA.items()
    }
    by_length = {f"stiffness_mpa_per_mm in MPa per {n}": 1 / size for n, size in LENGTH_UNITS_IN_MM.items()}
    by_length |= {f"lengths in {name}": size for name, size in LENGTH_UNITS_IN_MM.items()}
    by_load = {**by_force, **by_face} if FACE in raw.numbers else by_pressure
    return _fitting({**by_load, **by_slope, **by_length}, middle - _TYPICAL, middle - REACH[0])


def _fitting(factors: Mapping[str, float], low: float, high: float) -> str:
    """Sentence on the units whose ln factor lies between these, nearest to the upper first.

    >>> _fitting({"max_force_n in lbf": 1 / 4.448}, -2.0, -1.4), _fitting({"a": 1.0}, 0.0, 0.0)
    ('It fits max_force_n in lbf', 'no unit that we know fits')
    """
    found = {
        name: float(np.log(size))
        for name, size in factors.items()
        if size != 1.0 and low - _NAMED <= np.log(size) <= high + _NAMED
    }
    names = sorted(found, key=lambda name: abs(found[name] - high))[:3]
    return f"It fits {', or '.join(names)}" if names else _NO_UNIT


def unusual_face(columns: Mapping[str, Array], face: Array, complete: Rows) -> str:
    """What is unusual about a face that is known from force over pressure alone; "" if nothing."""
    own = columns.get(FACE, np.full(len(face), np.nan))
    derived = complete & ~np.isfinite(own) & np.isfinite(face)
    middle = float(np.median(face[derived])) if derived.any() else _USUAL_FACE[0]
    if _USUAL_FACE[0] <= middle <= _USUAL_FACE[1]:
        return ""
    return (
        f"force over pressure makes the probe's face {middle:.3g} mm2 in the median; ultrasound probes have "
        f"{_USUAL_FACE[0]:g} to {_USUAL_FACE[1]:g}"
    )
