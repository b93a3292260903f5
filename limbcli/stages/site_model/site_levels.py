"""A site's levels, judged by the noise that its case states."""

from __future__ import annotations

from limbcli.case import Site
from limbcli.measurement.indentation import LayerNoise, Levels, read_levels


def layer_noise(site: Site) -> LayerNoise:
    """
    >>> from limbcli.case import Noise
    >>> from types import SimpleNamespace
    >>> layer_noise(SimpleNamespace(noise=Noise(layer=0.1)))
    LayerNoise(thickness=0.1, depth=0.3)
    """
    return LayerNoise(site.noise.layer, site.noise.depth)


def levels_of(site: Site) -> Levels:
    """The site's levels.csv.

    Raises
    ------
    MeasurementError
        With every problem of the file; layers that grow beyond the stated noise are among them.
    """
    return read_levels(site.levels, noise=layer_noise(site))
