"""Pressure and shear of one named patch of the skin."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class PatchPressure:
    """A patch of the skin under one load; `load_n` 0: after donning; patch "skin": all of it.

    Attributes
    ----------
    area_mm2 : at rest
    contact_area_mm2 : current area of its facets under pressure
    mean_kpa, p95_kpa, mean_shear_kpa : over the area in contact
    peak_kpa, peak_shear_kpa : largest mean over one facet
    """

    load_n: float
    patch: str
    area_mm2: float
    contact_area_mm2: float
    mean_kpa: float
    p95_kpa: float
    peak_kpa: float
    mean_shear_kpa: float
    peak_shear_kpa: float
