"""All unit conversion factors.

Inside the package every bare number is in mm, N, MPa, s (mass in tonne). Quantities that enter or leave the
package carry their unit in their name and are converted here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeVar, cast

if TYPE_CHECKING:  # without numpy, which help and `new` do not need
    import numpy as np
    from numpy.typing import NDArray

Number = TypeVar("Number", float, "NDArray[np.float64]")

GRAVITY_M_PER_S2 = 9.80665
# Unit systems of FEBio model files (<units>): mm and N of their units of length and force; times are in s.
SYSTEMS = {
    "mm-N-s": (1.0, 1.0), "SI": (1e3, 1.0), "CGS": (10.0, 1e-5), "mm-kg-s": (1.0, 1e-3),
    "mm-g-s": (1.0, 1e-6), "mm-mg-s": (1.0, 1e-9), "um-nN-s": (1e-3, 1e-9),
}  # fmt: skip


def mpa_from_kpa(value_kpa: Number) -> Number:
    """Convert kPa to MPa.

    >>> mpa_from_kpa(5.0)
    0.005
    """
    return cast(Number, value_kpa / 1e3)


def kpa_from_mpa(value: Number) -> Number:
    """Convert MPa to kPa.

    >>> kpa_from_mpa(0.005)
    5.0
    """
    return cast(Number, value * 1e3)


def mpa_from_pa(value_pa: Number) -> Number:
    """Convert Pa to MPa.

    >>> mpa_from_pa(2000.0)
    0.002
    """
    return cast(Number, value_pa / 1e6)


def tonne_per_mm3_from_kg_per_m3(value_kg_per_m3: Number) -> Number:
    """Convert kg/m^3 to tonne/mm^3.

    >>> tonne_per_mm3_from_kg_per_m3(1000.0)
    1e-09
    """
    return cast(Number, value_kg_per_m3 * 1e-12)


def m_per_s_from_mm_per_s(value: Number) -> Number:
    """Convert mm/s to m/s.

    >>> m_per_s_from_mm_per_s(2000.0)
    2.0
    """
    return cast(Number, value / 1e3)


FORCE_UNITS_IN_N = {
    "N": 1.0,
    "mN": 1e-3,
    "cN": 1e-2,
    "kN": 1e3,
    "kgf": GRAVITY_M_PER_S2,
    "gf": GRAVITY_M_PER_S2 / 1e3,
    "lbf": 4.4482216152605,
}
PRESSURE_UNITS_IN_MPA = {
    "MPa": 1.0,
    "kPa": 1e-3,
    "Pa": 1e-6,
    "bar": 0.1,
    "psi": 4.4482216152605 / 25.4**2,
    "mmHg": 133.322387415e-6,
    "kgf/cm2": GRAVITY_M_PER_S2 / 100.0,
}
LENGTH_UNITS_IN_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "inch": 25.4, "ft": 304.8, "yd": 914.4}
TIME_UNITS_IN_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
ACCELERATION_UNITS_IN_G = {"g": 1.0, "mg": 1e-3, "m/s2": 1.0 / GRAVITY_M_PER_S2}
# Other names that files give to these units; a force in kg is the weight of that mass.
_ALSO = {
    "N": "newton newtons", "mN": "millinewton millinewtons", "kgf": "kg kp kilogram kilograms",
    "gf": "g gr gram grams", "lbf": "lb lbs pound pounds",
    "mm": "millimeter millimeters millimetre millimetres",
    "cm": "centimeter centimeters centimetre centimetres",
    "m": "meter meters metre metres", "inch": "in inches", "ft": "foot feet", "yd": "yard yards",
    "um": "\u00b5m \u03bcm micron microns micrometer micrometers micrometre micrometres",
    "s": "sec secs second seconds", "ms": "msec msecs millisecond milliseconds",
    "us": "\u00b5s \u03bcs usec microsecond microseconds", "min": "minute minutes",
    "m/s2": "m/s^2 m/s\u00b2 m/s/s m.s-2",
}  # fmt: skip


def unit_named(word: str, units: Mapping[str, float]) -> str | None:
    """The unit of a table (a key of `units`) that a word in a file stands for; None if it is none of them.

    >>> unit_named("Millimetres", LENGTH_UNITS_IN_MM), unit_named("kg", FORCE_UNITS_IN_N)
    ('mm', 'kgf')
    >>> unit_named("V", FORCE_UNITS_IN_N)
    """
    if word in units:
        return word
    low = word.lower().rstrip(".")
    return next((key for key in units if low == key.lower() or low in _ALSO.get(key, "").split()), None)
