"""Several measurements of one place (another orientation, a repeat) as one data set.

The tissue is the same; the noise is independent except for the scanner's gain on all speeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag

from limbcli.diagnostics.model.forward_model import Data
from limbcli.diagnostics.model.noise import ASSUMED, Noise, NoisePart, common
from limbcli.model import Array
from limbcli.stages.diagnosis.data.noise import GAIN_OF_SPEEDS
from limbcli.stages.diagnosis.data.site_data import SiteData


def joined(sites: Sequence[SiteData]) -> Data:
    """The data of all sites, concatenated; those of a single site unchanged."""
    if len(sites) == 1:
        return sites[0].data
    y = np.concatenate([site.data.y for site in sites])
    channel = tuple(f"{name} {site.name}" for site in sites for name in site.data.channel)
    order = np.concatenate([site.data.order for site in sites])
    series = tuple(f"{name} {site.name}" for site in sites for name in site.data.series)
    place = np.concatenate(
        [
            np.full((len(site.data), 2), np.nan) if site.data.place is None else site.data.place
            for site in sites
        ]
    )
    return Data(y, channel, order, _noise(sites), _groups(sites), _blocks(sites), series, place)


def slices(sites: Sequence[SiteData]) -> list[slice]:
    """Position of each site's data in the joint data."""
    ends = np.cumsum([0, *(len(site.data) for site in sites)])
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


def _noise(sites: Sequence[SiteData]) -> Noise:
    names = dict.fromkeys(part.name for site in sites for part in site.data.noise.parts)
    parts = []
    for name in names:
        found = [_part(site, name) for site in sites]
        source = _least_known([part.source for part in found if part is not None])
        if name == GAIN_OF_SPEEDS:
            directions = [_direction(part, len(site.data)) for part, site in zip(found, sites, strict=True)]
            parts.append(common(name, np.concatenate(directions), source=source))
            continue
        blocks = [
            np.zeros((len(site.data), len(site.data))) if part is None else part.covariance
            for part, site in zip(found, sites, strict=True)
        ]
        parts.append(NoisePart(name, block_diag(*blocks), source))
    return Noise(tuple(parts))


def _least_known(sources: Sequence[str]) -> str:
    """Source of the joint noise: assumed if that of any site is."""
    return ASSUMED if ASSUMED in sources else sources[0]


def _part(site: SiteData, name: str) -> NoisePart | None:
    return next((part for part in site.data.noise.parts if part.name == name), None)


def _direction(part: NoisePart | None, n: int) -> Array:
    return np.zeros(n) if part is None or part.direction is None else part.direction


def _groups(sites: Sequence[SiteData]) -> dict[str, np.ndarray]:
    groups = {}
    for site, inside in zip(sites, slices(sites), strict=True):
        n = slices(sites)[-1].stop
        whole = np.zeros(n, dtype=bool)
        whole[inside] = True
        groups[f"site {site.name}"] = whole
        for name, mask in site.data.groups.items():
            wide = np.zeros(n, dtype=bool)
            wide[inside] = mask
            groups[f"{site.name}: {name}"] = wide
    return groups


def _blocks(sites: Sequence[SiteData]) -> dict[str, np.ndarray]:
    n = slices(sites)[-1].stop
    blocks: dict[str, np.ndarray] = {}
    for site, inside in zip(sites, slices(sites), strict=True):
        for name, mask in site.data.blocks.items():
            wide = blocks.setdefault(name, np.zeros(n, dtype=bool))
            wide[inside] = mask
        whole = np.zeros(n, dtype=bool)
        whole[inside] = True
        blocks[f"site {site.name}"] = whole
    return blocks
