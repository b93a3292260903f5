"""A site's measurement channel by channel: rows, values, and each reading's own standard deviation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, fields, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from limbcli.case import StatedNoise
from limbcli.diagnosis.data.held_forces import HeldForces
from limbcli.diagnosis.data.windows import Windows
from limbcli.diagnosis.explanations.forward_model import Mask
from limbcli.diagnosis.explanations.noise import NoisePart
from limbcli.effects.curves import Curves
from limbcli.effects.reading import Protocol, Reading
from limbcli.measurement.elastography import SweMap
from limbcli.measurement.indentation import Levels
from limbcli.measurement.speed_noise import SpeedNoise, mean_speed_deviation
from limbcli.model import Array, IntArray
from limbcli.site_model.layer_readings import LayerReadings

LAYER = "layer"  # channel of the layers' thicknesses
TRAVEL_DEVIATION = 0.1  # mm, standard deviation of a travel read on a guide's scale
FEWEST_SMOOTH = 4  # fewest levels for a smooth depth-force curve
_STEEP, _STRAIGHT = 0.01, 10.0  # range of `SmoothDepth.unit`, as a multiple of the largest force
THICKNESS_DEVIATION = 1.0  # mm, standard deviation of skin-bone distance: MRI voxel size and posture


class Row(NamedTuple):
    """One datum: channel, level, part of the window (or -1)."""

    channel: str
    level: int
    part: int = -1


@dataclass(frozen=True, eq=False)
class SiteRows:
    """Data in a row (n,): channel, level, part of the window (or -1), value, own standard deviation."""

    channel: NDArray[np.str_]
    level: IntArray
    part: IntArray
    y: Array
    own: Array

    @staticmethod
    def of(
        channel: str, level: ArrayLike, part: ArrayLike = -1, *, y: ArrayLike = np.nan, own: ArrayLike = 0.0
    ) -> SiteRows:
        """Data of one channel; part, y, own : of each, or of all."""
        levels = np.asarray(level, dtype=np.int64)
        parts, values, deviations = (
            np.broadcast_to(np.asarray(each, dtype=kind), levels.shape)
            for each, kind in ((part, np.int64), (y, float), (own, float))
        )
        return SiteRows(np.full(len(levels), channel), levels, parts, values, deviations)

    @staticmethod
    def together(several: Sequence[SiteRows]) -> SiteRows:
        names = [each.name for each in fields(SiteRows)]
        return SiteRows(*(np.concatenate([getattr(each, name) for each in several]) for name in names))

    def __len__(self) -> int:
        return len(self.level)

    def __iter__(self) -> Iterator[Row]:
        return map(Row, self.channel.tolist(), self.level.tolist(), self.part.tolist())

    def among(self, *channels: str) -> Mask:
        """Mask (n,) of the data of these channels."""
        return np.isin(self.channel, channels)

    def channels(self) -> list[str]:
        return list(dict.fromkeys(self.channel.tolist()))

    def where(self, mask: Mask) -> SiteRows:
        return SiteRows(*(getattr(self, each.name)[mask] for each in fields(SiteRows)))


@dataclass(frozen=True, eq=False)
class ExtraMeasurement:
    """A further measurement.

    see : its prediction by a model; y, deviation (n,) : measured values and their standard deviations
    model_error : covariance (n, n) of the model's error in it; None: no further error
    """

    name: str
    see: Callable[[Curves, Reading, Protocol], Array]
    y: Array
    deviation: Array
    model_error: Array | None = None


@dataclass(frozen=True, eq=False)
class SiteReadings:
    """What was measured at a site: its levels and what belongs to them, and the noise stated for them.

    usable : parts (n_parts,) of a map that the model shows at every level; None: all
    layers : readings of the layers that the models track
    """

    levels: Levels
    noise: StatedNoise
    _: KW_ONLY
    windows: Windows
    maps: Sequence[SweMap] | None = None
    usable: Mask | None = None
    layers: LayerReadings | None = None
    held: HeldForces | None = None
    extras: Sequence[ExtraMeasurement] = ()

    @cached_property
    def keep(self) -> IntArray:
        """Indices (n_levels used,) of the levels that have a force and a depth, those of the protocol."""
        return known_levels(self.levels)

    @cached_property
    def protocol(self) -> Protocol:
        return readings(self.levels)

    @cached_property
    def travel_from(self) -> int:
        """Reference level of the travel, the first that has one: a guide's scale has an arbitrary origin."""
        known = np.flatnonzero(np.isfinite(self.levels.probe_travel[self.keep]))
        return int(known[0]) if len(known) else 0


def known_levels(levels: Levels) -> IntArray:
    """Indices of the levels that have a force and a depth."""
    known = np.isfinite(levels.force) & np.isfinite(levels.depth)
    return np.asarray(np.flatnonzero(known), dtype=np.int64)


def readings(levels: Levels) -> Protocol:
    """The levels that have a force and a depth."""
    known = known_levels(levels)
    unloading = tuple((~levels.loading[known]).tolist())
    return Protocol(levels.force[known], levels.depth[known], levels.hold[known], unloading=unloading)


def deepest(protocol: Protocol) -> float:
    """Largest depth (mm) of a smooth curve through the readings, limited to the largest reading."""
    smooth, read = SmoothDepth.through(protocol), float(np.max(protocol.depth, initial=0.0))
    if len(protocol) < FEWEST_SMOOTH:
        return read
    return min(float(np.max(smooth.at(protocol.force))), read)


@dataclass(frozen=True)
class SmoothDepth:
    """depth = start + rate ln(1 + F/unit), in mm, mm, N: a force that grows linearly, then exponentially."""

    start: float
    rate: float
    unit: float

    @staticmethod
    def through(protocol: Protocol) -> SmoothDepth:
        """Least-squares fit to the depths, the noisier reading.

        >>> force = np.linspace(0.0, 20.0, 11)
        >>> found = SmoothDepth.through(Protocol(force, 3.0 * np.log1p(force / 2.0), force))
        >>> round(found.rate, 2), round(found.unit, 2)
        (3.0, 2.0)
        """
        largest = max(float(np.max(protocol.force, initial=0.0)), 1e-3)
        if len(protocol) < FEWEST_SMOOTH or np.ptp(protocol.force) <= 0:
            rate = max(float(np.ptp(protocol.depth)), 1e-9) / np.log1p(1.0 / _STRAIGHT)
            return SmoothDepth(0.0, rate, _STRAIGHT * largest)
        best, found = np.inf, SmoothDepth(0.0, 1e-9, largest)
        for unit in largest * np.geomspace(_STEEP, _STRAIGHT, 61):
            x = SmoothDepth(0.0, 1.0, unit).place(protocol.force)
            rate, start = np.polyfit(x, protocol.depth, 1)
            left = float(np.sum((protocol.depth - start - rate * x) ** 2))
            if rate > 0 and left < best:
                best, found = left, SmoothDepth(float(start), float(rate), float(unit))
        return found

    def at(self, force: Array) -> Array:
        """mm at these forces."""
        return self.start + self.rate * self.place(force)

    def slope(self, force: Array) -> Array:
        """N/mm at these forces."""
        return np.asarray((np.maximum(force, 0.0) + self.unit) / self.rate)

    def place(self, force: Array) -> Array:
        """Coordinate along the curve: ln(1 + F/unit)."""
        return np.log1p(np.maximum(force, 0.0) / self.unit)


def measured_rows(seen: SiteReadings) -> SiteRows:
    """The data of all channels that a measurement has."""
    levels, protocol, layers, held = seen.levels, seen.protocol, seen.layers, seen.held
    # every level except those at 0 N and 0 mm, which are zero by definition
    used = np.flatnonzero((protocol.force != 0.0) | (protocol.depth != 0.0))
    found = [SiteRows.of("force", used, y=protocol.force[used], own=seen.noise.force), _speed_rows(seen)]
    travel, zero = levels.probe_travel[seen.keep], seen.travel_from  # the latter itself yields no datum
    used = np.flatnonzero(np.isfinite(travel) & (np.arange(len(travel)) != zero))
    moved = travel[used] - travel[zero : zero + 1]
    found.append(SiteRows.of("travel", used, y=moved, own=TRAVEL_DEVIATION))
    first = levels.skin_bone[seen.keep[:1]]
    first = first[np.isfinite(first)]
    found.append(SiteRows.of("skin-bone", np.arange(len(first)), y=first, own=THICKNESS_DEVIATION))
    if layers is not None:
        table = layers.thickness[seen.keep, : layers.n_counted].T
        layer, level = np.nonzero(np.isfinite(table) & (seen.keep > 0))
        found.append(SiteRows.of(LAYER, level, layer, y=table[layer, level], own=layers.deviation))
    if held is not None:  # each place within a hold is a series; `HeldForces` has the covariance
        found.append(SiteRows.of("hold", np.arange(len(held)), held.place, y=held.y))
    found += [
        SiteRows.of(each.name, np.arange(len(each.y)), y=each.y, own=each.deviation) for each in seen.extras
    ]
    return SiteRows.together(found)


def _speed_rows(seen: SiteReadings) -> SiteRows:
    """Parts of the maps (`MapNoise` gives their covariance), or the mean speeds where there are no maps."""
    levels, noise, windows, maps, keep = seen.levels, seen.noise, seen.windows, seen.maps, seen.keep
    if maps is not None and len(maps) == len(levels):
        tables = np.array([windows.log_means(maps[k]) for k in keep]).reshape(-1, 2, 1 + windows.n_parts)
        means, counts = tables[:, 0, 1:], tables[:, 1, 1:]
        shown = np.isfinite(means) if seen.usable is None else np.isfinite(means) & seen.usable
        level, part = np.nonzero(shown)
        own = noise.swe_pixel_fraction / np.sqrt(np.maximum(counts[shown], 1))
        return SiteRows.of("map", level, part + 1, y=means[shown], own=own)
    speeds = levels.swe_mean_m_per_s[keep]
    used = np.flatnonzero(np.isfinite(speeds))
    counted = replace(levels, swe_pixels=np.nan_to_num(levels.swe_pixels, nan=1.0))
    stated = SpeedNoise(noise.swe_level_fraction, noise.swe_pixel_fraction)
    own = mean_speed_deviation(counted, stated, with_scatter=False)[keep][used]
    return SiteRows.of("swe", used, 0, y=np.log(speeds[used]), own=own)


def within(name: str, mask: Mask, covariance: Array, source: str) -> NoisePart:
    """A noise part that affects only the data of a mask (n,), with this covariance."""
    whole = np.zeros((len(mask), len(mask)))
    whole[np.ix_(mask, mask)] = covariance
    return NoisePart(name, whole, source)
