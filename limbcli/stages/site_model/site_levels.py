"""A site's levels, judged by the noise that its case states."""

from __future__ import annotations

from limbcli.case import Site
from limbcli.measurement.cycles import CycleStudy, study_cycles
from limbcli.measurement.elastography import SweMap, read_maps
from limbcli.measurement.indentation import LayerNoise, Levels, read_levels
from limbcli.measurement.levels import LAST


def layer_noise(site: Site) -> LayerNoise:
    """
    >>> from limbcli.case import StatedNoise
    >>> from types import SimpleNamespace
    >>> layer_noise(SimpleNamespace(noise=StatedNoise(layer=0.1)))
    LayerNoise(thickness=0.1, depth=0.3)
    """
    return LayerNoise(site.noise.layer, site.noise.depth)


def all_levels_of(site: Site) -> Levels:
    """The site's levels.csv, all cycles. Raises as `levels_of`, but for the cycle."""
    return read_levels(site.levels, noise=layer_noise(site))


def levels_of(site: Site, cycle: str = LAST) -> Levels:
    """One cycle of the site's levels.csv: the last with three levels of loading, or that of a number.

    Raises
    ------
    CaseError
        If there is no such cycle, or it has too few levels.
    MeasurementError
        With every problem of the file; layers that grow beyond the stated noise are among them.
    """
    levels = all_levels_of(site)
    return levels.of_cycle(levels.chosen_cycle(cycle))


def maps_of(site: Site, levels: Levels) -> list[SweMap] | None:
    """The shear-wave maps of these levels, in order; None where the site has none. Raises as `read_maps`."""
    if site.swe_maps is None:
        return None
    maps = read_maps(site.swe_maps, levels.n_in_file)
    return [maps[k] for k in levels.rows]


def cycles_of(site: Site, levels: Levels) -> CycleStudy:
    """The site's cycles, judged by the noise that its case states; levels : of all cycles."""
    return study_cycles(levels, force_deviation=site.noise.force, depth_deviation=site.noise.depth)
