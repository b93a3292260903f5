"""The measurement of a site as the diagnosis takes it: stacked channels, their noise, their parts.

Depth is the noisy reading, force and speeds are compared at the measured depth; its error then
moves force, speeds and travel of a level together, which the covariance holds:
residual of the force -K e_d, of ln speed -s e_d, of the travel -e_d (K, s: measured slopes).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from limbcli.case import Noise as StatedNoise
from limbcli.diagnostics.bench import Data
from limbcli.diagnostics.noise import Noise, NoisePart, common, correlated, independent
from limbcli.effects.reading import Curves, Protocol, Reading, read
from limbcli.measurement.elastography import SweMap
from limbcli.measurement.indentation import Levels
from limbcli.model import Array, IntArray
from limbcli.stages.diagnosis_holds import HeldForces
from limbcli.stages.diagnosis_windows import Windows

GAIN_OF_SPEEDS = "gain of all speeds"
COMMON_GAIN = 0.03  # of all speeds alike: calibration of the scanner (assumed; nobody states it)
PART_ERROR = 0.025  # of a part's mean speed, at every level: the model's resolution (assumed)
MAP_ERROR = 0.015  # of a part's mean speed, from level to level (assumed)
TRAVEL_DEVIATION = 0.1  # mm, of a guide with a scale
THICKNESS_DEVIATION = 1.0  # mm: a voxel of the MRI, and posture
_FEWEST_SPEEDS = 4
_WITH_DEPTH = ("force", "swe", "map", "travel", "skin-bone")


@dataclass(frozen=True, eq=False)
class Row:
    """One datum: channel, level, part of the window (or -1)."""

    channel: str
    level: int
    part: int = -1


@dataclass(frozen=True, eq=False)
class Extra:
    """A further measurement: its name, what a model says of it, what was measured and one deviation (n,)."""

    name: str
    see: Callable[[Curves, Reading, Protocol], Array]
    y: Array
    deviation: Array


@dataclass(frozen=True, eq=False)
class SiteData:
    """What was measured at one site, and how a prediction is laid out beside it."""

    name: str
    protocol: Protocol
    rows: tuple[Row, ...]
    data: Data
    channels: tuple[str, ...] = ()
    missing: tuple[str, ...] = field(default=())
    held: HeldForces | None = None
    extras: tuple[Extra, ...] = ()

    def predict(self, curves: Curves, reading: Reading) -> Array:
        """The prediction (n,) of every datum."""
        shown = read(curves, self.protocol, reading)
        out = np.empty(len(self.rows))
        falls = None if self.held is None else self.held.predict(curves, reading)
        more = {each.name: each.see(curves, reading, self.protocol) for each in self.extras}
        for k, row in enumerate(self.rows):
            if row.channel == "force":
                out[k] = shown.force[row.level]
            elif row.channel in ("swe", "map"):
                out[k] = shown.log_speed[row.level, row.part]
            elif row.channel == "travel":
                out[k] = shown.travel[row.level]
            elif row.channel == "hold" and falls is not None:
                out[k] = falls[row.level]
            elif row.channel in more:
                out[k] = more[row.channel][row.level]
            else:
                out[k] = shown.thickness
        return out


def site_data(
    name: str, levels: Levels, noise: StatedNoise, *, windows: Windows, maps: list[SweMap] | None = None,
    model_error: Sequence[ModelError] = (), held: HeldForces | None = None, extras: Sequence[Extra] = (),
) -> SiteData:  # fmt: skip
    """Stack the channels that this measurement has.

    model_error : known differences between models, over all rows of the levels
    """
    keep = np.asarray(np.flatnonzero(np.isfinite(levels.force) & np.isfinite(levels.depth)), dtype=np.int64)
    protocol = Protocol(levels.force[keep], levels.depth[keep], levels.hold[keep])
    rows, y, own = _force(protocol, noise)
    for more in (
        _speeds(levels, keep, noise, windows, maps),
        _travel(levels, keep),
        _skin_bone(levels, keep),
        _holds(held),
        _extras(extras),
    ):
        rows, y, own = rows + more[0], y + more[1], own + more[2]
    parts = _noise(protocol, tuple(rows), np.array(y), np.array(own), noise, keep, model_error)
    channel = tuple(row.channel for row in rows)
    order = np.array([float(row.level) for row in rows])
    series = tuple(f"{row.channel} {row.part}" if row.part >= 0 else row.channel for row in rows)
    data = Data(
        np.array(y), channel, order, Noise(tuple(parts)), _groups(rows, protocol, windows), _blocks(rows),
        series,
    )  # fmt: skip
    present = tuple(dict.fromkeys(channel))
    extra = ("swe",) if "map" in present else ()
    channels = (*present, *extra)
    wanted = ("force", "swe", "map", "travel", "skin-bone", "hold")
    return SiteData(
        name,
        protocol,
        tuple(rows),
        data,
        channels,
        tuple(c for c in wanted if c not in channels),
        held,
        tuple(extras),
    )


@dataclass(frozen=True, eq=False)
class ModelError:
    """An error of the model: ln force (n_levels,), ln speed (n_levels, n_parts), one deviation each.

    correlation None : one common factor; else that between neighbouring levels
    depth : mm, of the depth at every level alike
    """

    name: str
    log_force: Array
    log_speed: Array
    correlation: float | None = None
    depth: float = 0.0


Stacked = tuple[list[Row], list[float], list[float]]


def _force(protocol: Protocol, noise: StatedNoise) -> Stacked:
    """Every level but those at 0 N and 0 mm, which are so by definition."""
    used = [k for k in range(len(protocol)) if protocol.force[k] != 0.0 or protocol.depth[k] != 0.0]
    return (
        [Row("force", k) for k in used],
        [float(protocol.force[k]) for k in used],
        [noise.force] * len(used),
    )


def _speeds(
    levels: Levels, keep: IntArray, noise: StatedNoise, windows: Windows, maps: list[SweMap] | None
) -> Stacked:
    rows: list[Row] = []
    y: list[float] = []
    own: list[float] = []
    if maps is not None and len(maps) == len(levels):
        for level, number in enumerate(keep.tolist()):
            means, counts = windows.log_means(maps[number])
            for part in range(1, len(means)):
                if np.isfinite(means[part]):
                    rows.append(Row("map", level, part))
                    y.append(float(means[part]))
                    own.append(
                        float(np.hypot(MAP_ERROR, noise.swe_pixel_fraction / np.sqrt(max(counts[part], 1))))
                    )
        return rows, y, own
    speeds = levels.swe_mean_m_per_s[keep]
    if np.isfinite(speeds).sum() < _FEWEST_SPEEDS:
        return rows, y, own
    for level in np.flatnonzero(np.isfinite(speeds)).tolist():
        pixels = levels.swe_pixels[int(keep[level])]
        cells = max(pixels, 1.0) if np.isfinite(pixels) else 1.0
        rows.append(Row("swe", int(level), 0))
        y.append(float(np.log(speeds[level])))
        own.append(float(np.hypot(noise.swe_level_fraction, noise.swe_pixel_fraction / np.sqrt(cells))))
    return rows, y, own


def _travel(levels: Levels, keep: IntArray) -> Stacked:
    travel = levels.probe_travel[keep]
    used = [int(k) for k in np.flatnonzero(np.isfinite(travel))]
    return [Row("travel", k) for k in used], [float(travel[k]) for k in used], [TRAVEL_DEVIATION] * len(used)


def _skin_bone(levels: Levels, keep: IntArray) -> Stacked:
    first = levels.skin_bone[int(keep[0])] if len(keep) else np.nan
    if not np.isfinite(first):
        return [], [], []
    return [Row("skin-bone", 0)], [float(first)], [THICKNESS_DEVIATION]


def _holds(held: HeldForces | None) -> Stacked:
    if held is None:
        return [], [], []
    return [Row("hold", k) for k in range(len(held))], held.y.tolist(), held.deviation.tolist()


def _extras(extras: Sequence[Extra]) -> Stacked:
    rows = [Row(each.name, k) for each in extras for k in range(len(each.y))]
    y = [float(value) for each in extras for value in each.y]
    return rows, y, [float(value) for each in extras for value in each.deviation]


def _noise(
    protocol: Protocol, rows: tuple[Row, ...], y: Array, own: Array, noise: StatedNoise,
    keep: IntArray, model_error: Sequence[ModelError],
) -> list[NoisePart]:  # fmt: skip
    source = noise.source
    parts = [independent("measurement: own error of each reading", own, source=source)]
    slope = depth_slopes(protocol, rows, y)
    levels = np.array([row.level for row in rows])
    exact = [k for k in range(len(protocol)) if protocol.force[k] == 0.0 and protocol.depth[k] == 0.0]
    by_depth = np.zeros((len(rows), len(rows)))
    for level in range(len(protocol)):
        direction = np.where((levels == level) & (level not in exact), slope, 0.0) * noise.depth
        by_depth += np.outer(direction, direction)
    parts.append(NoisePart("measurement: depth, in all channels of a level", by_depth, source))
    is_map = np.array([row.channel == "map" for row in rows])
    if is_map.any():
        common_to_level = np.zeros((len(rows), len(rows)))
        for level in range(len(protocol)):
            direction = np.where(is_map & (levels == level), noise.swe_level_fraction, 0.0)
            common_to_level += np.outer(direction, direction)
        parts.append(NoisePart("measurement: speeds of a level", common_to_level, source))
        places = np.array([row.part for row in rows])
        together = (places[:, None] == places[None, :]) & is_map[:, None] & is_map[None, :]
        parts.append(NoisePart("model: parts of the window", PART_ERROR**2 * together, "assumed"))
    speeds = np.array([row.channel in ("swe", "map") for row in rows], dtype=float)
    if speeds.any():
        parts.append(common(GAIN_OF_SPEEDS, COMMON_GAIN * speeds, source="assumed"))
    is_travel = np.array([row.channel == "travel" for row in rows])
    for each in model_error:
        direction = _model_direction(rows, y, each.log_force[keep], each.log_speed[keep])
        if each.depth:
            direction = direction + each.depth * np.where(is_travel, 0.0, slope)
        if each.correlation is None:
            parts.append(common(each.name, direction, source="computed"))
        else:
            along = levels.astype(float)
            parts.append(
                correlated(each.name, direction, along, correlation=each.correlation, source="computed")
            )
    return parts


def _model_direction(rows: tuple[Row, ...], y: Array, log_force: Array, log_speed: Array) -> Array:
    out = np.zeros(len(rows))
    for k, row in enumerate(rows):
        if row.channel == "force":
            out[k] = y[k] * log_force[row.level]
        elif row.channel in ("swe", "map"):
            out[k] = np.nan_to_num(log_speed[row.level, row.part])
    return out


def depth_slopes(protocol: Protocol, rows: tuple[Row, ...], y: Array) -> Array:
    """How each datum changes with depth (n,), from smooth curves through the measured values."""
    out = np.zeros(len(rows))
    groups: dict[tuple[str, int], list[int]] = {}
    for k, row in enumerate(rows):
        groups.setdefault((row.channel, row.part), []).append(k)
    for (channel, _), members in groups.items():
        if channel not in _WITH_DEPTH:
            continue
        depth = protocol.depth[[rows[k].level for k in members]]
        if channel == "travel":
            out[members] = 1.0
        elif channel != "skin-bone" and len(members) >= 3 and np.ptp(depth) > 0:
            degree = 2 if channel == "force" and len(members) > 3 else 1
            curve = np.polynomial.Polynomial.fit(depth, y[members], degree)
            slope = curve.deriv()(depth)
            out[members] = np.maximum(slope, 0.0) if channel == "force" else slope
    return out


def _groups(rows: list[Row], protocol: Protocol, windows: Windows) -> dict[str, np.ndarray]:
    """Channels; thirds of the levels by channel; the way back; parts of the window."""
    groups: dict[str, np.ndarray] = {}
    names = {"force": "force", "swe": "mean speed", "map": "speed maps", "travel": "probe travel",
             "skin-bone": "skin-bone distance", "hold": "fall of the force in holds"}  # fmt: skip
    level = np.array([row.level for row in rows])
    for channel in dict.fromkeys(row.channel for row in rows):
        mask = np.array([row.channel == channel for row in rows])
        groups[names.get(channel, channel)] = mask
        if channel in ("force", "swe", "map"):
            for k, label in enumerate(("first", "middle", "last")):
                third = (level * 3 // max(len(protocol), 1)) == k
                groups[f"{names[channel]}, {label} third of the levels"] = mask & third
    if any(protocol.unloading):
        back = np.array([row.channel == "force" and protocol.unloading[row.level] for row in rows])
        groups["force, unloading"] = back
    for part, label in enumerate(windows.names()):
        mask = np.array([row.channel == "map" and row.part == part for row in rows])
        if mask.any() and part:
            groups[f"speed maps, {label}"] = mask
    return groups


def _blocks(rows: list[Row]) -> dict[str, np.ndarray]:
    level = np.array([row.level for row in rows])
    blocks = {f"levels {k + 1}, {k + 4}, ...": level % 3 == k for k in range(3)}
    channels = list(dict.fromkeys(row.channel for row in rows))
    if len(channels) > 1:
        for channel in channels:
            if channel in ("swe", "map", "force"):
                blocks[f"channel {channel}"] = np.array([row.channel == channel for row in rows])
    return blocks
