"""A site's measurement as input of the diagnosis: stacked channels, noise, groups; several sites joined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag

from limbcli.diagnosis.data.noise_parts import (
    GAIN_OF_SPEEDS,
    STRAIN,
    KnownErrors,
    MapNoise,
    depth_slopes,
    noise_parts,
)
from limbcli.diagnosis.data.rows import (
    FEWEST_SMOOTH,
    LAYER,
    SiteReadings,
    SiteRows,
    SmoothDepth,
    measured_rows,
)
from limbcli.diagnosis.data.windows import Windows
from limbcli.diagnosis.explanations.forward_model import Data, Mask
from limbcli.diagnosis.explanations.noise import ASSUMED, Noise, NoisePart, common
from limbcli.effects.curves import Curves, depth_at, force_at
from limbcli.effects.reading import Protocol, Reading, Readout, borne_at_zero, read, relaxed, true_depth
from limbcli.model import Array, IntArray

_STRAIN_STEP = 0.01  # relative step of the derivative with respect to all strains
_SPEED_STEP = 1e-3  # the same of that with respect to ln of all speeds
_DEPTH_OUTLIER_SD = 4.0  # largest error of a depth reading that is corrected, in its standard deviations
_LEAST_N = 0.2  # N, smallest force from which a depth is determined
# Channels that a measurement may have, as they are called where a misfit is localised.
_CHANNELS = {
    "force": "force", "swe": "mean speed", "map": "speed maps", "travel": "probe travel",
    "skin-bone": "skin-bone distance", "layer": "layers", "hold": "force decay in holds",
}  # fmt: skip
_BY_LEVELS = ("force", "swe", "map")  # channels that are divided into thirds, and held out as blocks


@dataclass(frozen=True, eq=False, kw_only=True)
class SiteData:
    """The data of one site, and the layout of a prediction for them.

    seen : the measurement; model : what is known of the models' errors
    slope (n,) : change of each datum with depth
    """

    name: str
    seen: SiteReadings
    model: KnownErrors
    rows: SiteRows
    data: Data
    slope: Array

    @property
    def protocol(self) -> Protocol:
        return self.seen.protocol

    @property
    def channels(self) -> tuple[str, ...]:
        """Those that were measured; mean speeds are part of maps."""
        several = self.rows.channels()
        return (*several, *(("swe",) if "map" in several else ()))

    @property
    def missing(self) -> tuple[str, ...]:
        return tuple(each for each in _CHANNELS if each not in self.channels)

    def with_share(self, name: str, share: float) -> SiteData:
        """The data with the noise part `name` scaled to this fraction of its assumed size."""
        return replace(self, data=replace(self.data, noise=self.data.noise.with_share(name, share)))

    def with_strain_of(self, curves: Curves, reading: Reading) -> SiteData:
        """The data with the error common to all strains along the derivative of these curves, of unchanged
        size. The slopes of smooth curves through the readings, by which it was first computed, differ from a
        model's by up to a tenth: many parts of maps would find a factor of all depths by that."""
        part = next((each for each in self.data.noise.parts if each.name == STRAIN), None)
        by_depth = self.slope * self.protocol.depth[self._levels]
        first = np.where(self.rows.among("travel"), 0.0, by_depth)
        if part is None or not first.any():
            return self
        more, less = (
            self.predict(curves, replace(reading, depth_gain=reading.depth_gain * (1 + step)))
            for step in (_STRAIN_STEP, -_STRAIN_STEP)
        )
        direction = np.where(first != 0.0, (more - less) / (2 * _STRAIN_STEP), 0.0)
        deviation = next((each.strain for each in self.model.errors if each.name == STRAIN), 0.0)
        noise, new = self.data.noise, common(STRAIN, deviation * direction, source=part.source)
        parts = (new if each is part else each for each in noise.parts)
        return replace(self, data=replace(self.data, noise=noise.with_parts(parts)))

    def predict(self, curves: Curves, reading: Reading) -> Array:
        """The prediction (n,) of every datum at the depths that were read.

        Depth is the noisy reading, and in thin or stiff tissue its error is too large to linearise the curves
        at the depth read. Curves are therefore evaluated where they have the measured force, and extrapolated
        to the depth read along the measured slopes, consistent with the noise model: an error of depth then
        shifts the data in proportion. Parts of maps are evaluated where smooth curves through the readings
        have the measured force, which rests on no model's force, and extrapolated along the slopes of the
        model without effects.
        """
        further = self._further(curves, reading)
        moved = replace(self.protocol, depth=self.protocol.depth + further)
        speeds = "map" not in self._places or bool(reading.after)  # those of maps are read below
        out = self._laid_out(read(curves, moved, reading, with_speeds=speeds), curves, reading)
        out = out - self.slope * further[self._levels]
        if "travel" in self._places:
            out[self._places["travel"][0]] += further[self.seen.travel_from]
        if "map" in self._places:
            places, levels, parts = self._places["map"]
            smoothed = replace(self.protocol, depth=self.protocol.depth + self._to_smooth)
            out[places] = read(curves, smoothed, reading).log_speed[levels, parts]
            out[places] -= self.slope[places] * self._to_smooth[levels]
        return out

    def amplification(self, curves: Curves, reading: Reading) -> Array:
        """Change (n,) of each shown ln speed per change of it in the tissue; 1 for other data."""
        more, less = (
            self.predict(curves, replace(reading, log_speed_shift=reading.log_speed_shift + step))
            for step in (_SPEED_STEP, -_SPEED_STEP)
        )
        return np.where(self.rows.among("swe", "map"), (more - less) / (2 * _SPEED_STEP), 1.0)

    @cached_property
    def _to_smooth(self) -> Array:
        """Distance (n_levels,) in mm from the depth read to that of a smooth curve through the readings,
        limited as `_further`; 0 in unloading and with few levels. At the depths read, maps whose speeds rise
        steeply would be off by more than the noise model allows, and a fit would find less of what makes them
        steep."""
        found = np.zeros(len(self.protocol))
        loading = ~np.array(self.protocol.unloading or np.zeros(len(found)), dtype=bool)
        if loading.sum() < FEWEST_SMOOTH or self.seen.noise.depth <= 0:
            return found
        force, depth, hold = (
            each[loading] for each in (self.protocol.force, self.protocol.depth, self.protocol.hold)
        )
        smooth = SmoothDepth.through(Protocol(force, depth, hold)).at(self.protocol.force)
        most = _DEPTH_OUTLIER_SD * self.seen.noise.depth
        off = np.clip(smooth - self.protocol.depth, -most, most)
        return np.where(loading & (self.protocol.depth > 0), off, found)

    @cached_property
    def _levels(self) -> IntArray:
        """Level of every datum (n,); 0 for data without a level, whose slope is 0."""
        return np.where(self.rows.level < len(self.protocol), self.rows.level, 0)

    def _further(self, curves: Curves, reading: Reading) -> Array:
        """Distance (n_levels,) in mm from the depth read to where the model has the measured force, limited
        to `_DEPTH_OUTLIER_SD` standard deviations of the depth."""
        found = np.zeros(len(self.protocol))
        if self.seen.noise.depth <= 0:
            return found
        depth = true_depth(curves, self.protocol.depth, reading)
        elastic = force_at(curves, depth)
        borne = relaxed(elastic, curves, depth, reading, self.protocol.remembered)
        wanted = (self.protocol.force - reading.force_zero) / reading.force_gain
        wanted = wanted + borne_at_zero(curves, reading)
        known = (depth > 0) & (elastic > _LEAST_N) & (borne > _LEAST_N) & (wanted > _LEAST_N)
        if not known.any():
            return found
        there = depth_at(curves, elastic[known] * wanted[known] / borne[known])
        most = _DEPTH_OUTLIER_SD * self.seen.noise.depth
        found[known] = np.clip((there - depth[known]) / reading.depth_gain, -most, most)
        return found

    def _laid_out(self, shown: Readout, curves: Curves, reading: Reading) -> Array:
        stretched = reading.depth_gain if self.model.bone_as_shown else 1.0
        seen: dict[str, Array] = {
            "force": shown.force, "travel": shown.travel - shown.travel[self.seen.travel_from],
            "skin-bone": np.array([shown.thickness * stretched]),
        }  # fmt: skip
        if self.seen.held is not None:
            seen["hold"] = self.seen.held.predict(curves, reading)
        seen |= {each.name: each.see(curves, reading, self.protocol) for each in self.seen.extras}
        out = np.empty(len(self.rows))
        for channel, (places, levels, parts) in self._places.items():
            if channel in ("swe", "map"):
                out[places] = shown.log_speed[levels, parts]
            elif channel == LAYER:
                out[places] = shown.layers[levels, parts]
            else:
                out[places] = seen[channel][levels]
        return out

    @cached_property
    def _places(self) -> dict[str, tuple[IntArray, IntArray, IntArray]]:
        """For each channel: the indices of its data, and their levels and parts."""
        places = {name: np.flatnonzero(self.rows.among(name)) for name in self.rows.channels()}
        return {name: (k, self.rows.level[k], self.rows.part[k]) for name, k in places.items()}


def site_data(name: str, seen: SiteReadings, model: KnownErrors = KnownErrors()) -> SiteData:
    """Stack the channels that this measurement has."""
    protocol, noise, windows = seen.protocol, seen.noise, seen.windows
    smooth, rows = SmoothDepth.through(protocol), measured_rows(seen)
    slope = depth_slopes(protocol, rows, map_slopes=model.map_slopes, layers=seen.layers)
    strain = smooth.at(protocol.force) / model.thickness
    of_maps = None if seen.maps is None else MapNoise.of(windows, seen.maps, noise, strain)
    parts = noise_parts(seen, rows, slope, maps=of_maps, model=model)
    data = Data(
        rows.y, tuple(rows.channel.tolist()), rows.level.astype(float), Noise(tuple(parts), noise.source),
        groups=_groups(rows, protocol, windows), blocks=_blocks(rows),
        series=tuple(f"{row.channel} {row.part}" if row.part >= 0 else row.channel for row in rows),
        place=_place(rows, windows),
    )  # fmt: skip
    return SiteData(name=name, seen=seen, model=model, rows=rows, data=data, slope=slope)


def _groups(rows: SiteRows, protocol: Protocol, windows: Windows) -> dict[str, Mask]:
    """Groups for localisation: channels, thirds of the levels by channel, unloading, regions of the map."""
    groups: dict[str, Mask] = {}
    for channel in rows.channels():
        name = _CHANNELS.get(channel, channel)
        mask = groups[name] = rows.among(channel)
        if channel in _BY_LEVELS:
            third = rows.level * 3 // max(len(protocol), 1)
            for k, label in enumerate(("first", "middle", "last")):
                groups[f"{name}, {label} third of the levels"] = mask & (third == k)
    if any(protocol.unloading):
        level = np.minimum(rows.level, len(protocol) - 1)
        groups["force, unloading"] = rows.among("force") & np.array(protocol.unloading)[level]
    regions, mapped = np.array(windows.names()), rows.among("map")
    for label in dict.fromkeys(regions[1:].tolist()):
        mask = mapped & (regions[np.where(mapped, rows.part, 0)] == label)
        if mask.any():
            groups[f"speed maps, {label}"] = mask
    return groups


def _place(rows: SiteRows, windows: Windows) -> Array:
    """Position (n, 2) in mm of each datum's part of a map; NaN for other data."""
    found, mapped = np.full((len(rows), 2), np.nan), rows.among("map")
    found[mapped] = windows.middles[rows.part[mapped] - 1]
    return found


def _blocks(rows: SiteRows) -> dict[str, Mask]:
    blocks = {f"levels {k + 1}, {k + 4}, ...": rows.level % 3 == k for k in range(3)}
    several = [channel for channel in rows.channels() if len(rows.channels()) > 1]
    return blocks | {f"channel {each}": rows.among(each) for each in several if each in _BY_LEVELS}


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
