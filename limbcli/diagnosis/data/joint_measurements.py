"""Several measurements of one place (another orientation, a repeat) as one data set.

The tissue is the same; the noise is independent except for the scanner's gain on all speeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag

from limbcli.diagnosis.data.noise_parts import GAIN_OF_SPEEDS
from limbcli.diagnosis.data.site_data import SiteData
from limbcli.diagnosis.explanations.model.forward_model import Data, Mask
from limbcli.diagnosis.explanations.model.noise_covariance import ASSUMED, Noise, NoisePart, common


def joined(sites: Sequence[SiteData]) -> Data:
    """The data of all sites, concatenated; those of a single site unchanged."""
    if len(sites) == 1:
        return sites[0].data
    several = [site.data for site in sites]
    channel, series = (
        tuple(f"{name} {site.name}" for site in sites for name in getattr(site.data, field))
        for field in ("channel", "series")
    )
    place = [np.full((len(data), 2), np.nan) if data.place is None else data.place for data in several]
    groups, blocks = _groups_and_blocks(sites)
    return Data(
        np.concatenate([data.y for data in several]), channel,
        np.concatenate([data.order for data in several]), _noise(several), groups=groups, blocks=blocks,
        series=series, place=np.concatenate(place),
    )  # fmt: skip


def slices(sites: Sequence[SiteData]) -> list[slice]:
    """Position of each site's data in the joint data."""
    ends = np.cumsum([0, *(len(site.data) for site in sites)])
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


def _noise(several: Sequence[Data]) -> Noise:
    parts = []
    for name in dict.fromkeys(part.name for data in several for part in data.noise.parts):
        absent = [NoisePart(name, np.zeros((n, n)), "", np.zeros(n)) for n in map(len, several)]
        found = [
            next((part for part in data.noise.parts if part.name == name), none)
            for data, none in zip(several, absent, strict=True)
        ]
        sources = [part.source for part in found if part.source]
        source = ASSUMED if ASSUMED in sources else sources[0]  # the least known
        if name == GAIN_OF_SPEEDS:
            directions = [part.direction for part in found if part.direction is not None]
            parts.append(common(name, np.concatenate(directions), source=source))
        else:
            parts.append(NoisePart(name, block_diag(*(part.covariance for part in found)), source))
    stated = [data.noise.stated for data in several]
    return Noise(tuple(parts), ASSUMED if ASSUMED in stated else stated[0])


def _groups_and_blocks(sites: Sequence[SiteData]) -> tuple[dict[str, Mask], dict[str, Mask]]:
    """Groups are of one site each; blocks of the same name are held out at all sites together."""
    places = slices(sites)
    nothing = np.zeros(places[-1].stop, dtype=bool)

    def wide(inside: slice, mask: Mask | bool = True) -> Mask:
        found = nothing.copy()
        found[inside] = mask
        return found

    groups: dict[str, Mask] = {}
    blocks: dict[str, Mask] = {}
    for site, inside in zip(sites, places, strict=True):
        groups[f"site {site.name}"] = wide(inside)
        groups |= {f"{site.name}: {name}": wide(inside, mask) for name, mask in site.data.groups.items()}
        for name, mask in site.data.blocks.items():
            blocks[name] = blocks.get(name, nothing) | wide(inside, mask)
        blocks[f"site {site.name}"] = wide(inside)
    return groups, blocks
