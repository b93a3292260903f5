"""A site's levels, checked against the noise stated by its case."""

from __future__ import annotations

import numpy as np

from limbcli.case import Site
from limbcli.case.noting import unnoted
from limbcli.errors import MeasurementError
from limbcli.feb.settings import LEAST_START, apart
from limbcli.measurement.elastography import SweMap, read_maps
from limbcli.measurement.indentation import LayerNoise, Levels, read_levels
from limbcli.measurement.levels import LAST
from limbcli.measurement.repeated_loading import CycleStudy, study_cycles
from limbcli.measurement.speed_noise import SpeedNoise
from limbcli.model import Array


def layer_noise(site: Site) -> LayerNoise:
    """
    >>> from limbcli.case import StatedNoise
    >>> from types import SimpleNamespace
    >>> layer_noise(SimpleNamespace(noise=StatedNoise(layer=0.1)))
    LayerNoise(thickness=0.1, depth=0.3, speed=SpeedNoise(level=0.05, pixel=0.1))
    """
    return LayerNoise(site.noise.layer, site.noise.depth, speed_noise(site))


def speed_noise(site: Site) -> SpeedNoise:
    """Stated noise of a site's speeds."""
    return SpeedNoise(site.noise.swe_level_fraction, site.noise.swe_pixel_fraction)


def all_levels_of(site: Site) -> Levels:
    """The site's levels.csv, all cycles. Raises the errors of `levels_of` except those about the cycle."""
    return read_levels(site.levels, noise=layer_noise(unnoted(site)))


def levels_of(site: Site, cycle: str = LAST) -> Levels:
    """One cycle of the site's levels.csv: the last with three levels of loading, or the one of this number.

    Raises CaseError if there is no such cycle, or it has too few levels; MeasurementError listing every
    problem of the file, including layers that thicken by more than the stated noise.
    """
    levels = all_levels_of(site)
    return levels.of_cycle(levels.chosen_cycle(cycle))


def maps_of(site: Site, levels: Levels) -> list[SweMap] | None:
    """The shear-wave maps of these levels, in order; None if there are none. Raises as `read_maps`."""
    if site.swe_maps is None:
        return None
    maps = read_maps(site.swe_maps, levels.n_in_file)
    return [maps[k] for k in levels.rows]


def cycles_of(site: Site, levels: Levels) -> CycleStudy:
    """The site's cycles, compared using the noise stated by its case; levels : of all cycles."""
    return study_cycles(levels, force_deviation=site.noise.force, depth_deviation=site.noise.depth)


def simulated_depths(levels: Levels) -> Array:
    """The distinct loading depths, sorted (mm), without those at first touch, which need no simulation.

    Depths less than 0.02 mm apart are merged.

    Raises MeasurementError if no loading level is deeper than the initial depth of the simulation.
    """
    depths = np.unique(levels.depth[levels.loading])
    depths = depths[depths > LEAST_START]
    if len(depths) == 0:
        raise MeasurementError(
            f"no loading level is deeper than {LEAST_START:g} mm",
            where=str(levels.path),
            fix="check the column depth_mm: it increases from 0 with the load, in mm",
        )
    return np.array(apart(depths.tolist()))
