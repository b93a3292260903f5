"""All unit conversion factors.

Inside the package every bare number is in mm, N, MPa, s (mass in tonne). Quantities that enter or leave the
package carry their unit in their name and are converted here.
"""

from __future__ import annotations

from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", float, NDArray[np.float64])

GRAVITY_M_PER_S2 = 9.80665
# Unit systems of FEBio model files (<units>): mm and N of their units of length and force; times are in s.
SYSTEMS = {
    "mm-N-s": (1.0, 1.0),
    "SI": (1e3, 1.0),
    "CGS": (10.0, 1e-5),
    "mm-kg-s": (1.0, 1e-3),
    "mm-g-s": (1.0, 1e-6),
    "mm-mg-s": (1.0, 1e-9),
    "um-nN-s": (1e-3, 1e-9),
}


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
    "kgf": GRAVITY_M_PER_S2,
    "gf": GRAVITY_M_PER_S2 / 1e3,
    "lbf": 4.4482216152605,
}
LENGTH_UNITS_IN_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "inch": 25.4}
