"""A site's measurement channel by channel: rows, values, and each reading's own standard deviation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limbcli.case import StatedNoise
from limbcli.diagnostics.model.noise import NoisePart, common
from limbcli.effects.curves import Curves
from limbcli.effects.reading import Protocol, Reading
from limbcli.measurement.elastography import SweMap
from limbcli.measurement.indentation import Levels
from limbcli.model import Array, IntArray
from limbcli.stages.diagnosis.data.held_forces import HeldForces
from limbcli.stages.diagnosis.data.windows import Windows

TRAVEL_DEVIATION = 0.1  # mm, standard deviation of a travel read on a guide's scale
THICKNESS_DEVIATION = 1.0  # mm, standard deviation of skin-bone distance: MRI voxel size and posture


@dataclass(frozen=True, eq=False)
class Row:
    """One datum: channel, level, part of the window (or -1)."""

    channel: str
    level: int
    part: int = -1


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


Stacked = tuple[list[Row], list[float], list[float]]


def force_rows(protocol: Protocol, noise: StatedNoise) -> Stacked:
    """Every level except those at 0 N and 0 mm, which are zero by definition."""
    used = [k for k in range(len(protocol)) if protocol.force[k] != 0.0 or protocol.depth[k] != 0.0]
    return (
        [Row("force", k) for k in used],
        [float(protocol.force[k]) for k in used],
        [noise.force] * len(used),
    )


def speed_rows(
    levels: Levels, keep: IntArray, noise: StatedNoise, windows: Windows, maps: list[SweMap] | None,
    usable: NDArray[np.bool_] | None = None,
) -> Stacked:  # fmt: skip
    """Parts of the maps (`MapNoise` gives their covariance), or the mean speeds where there are no maps.

    usable : parts (n_parts,) that the model shows at every level; None: all
    """
    rows: list[Row] = []
    y: list[float] = []
    own: list[float] = []
    if maps is not None and len(maps) == len(levels):
        for level, number in enumerate(keep.tolist()):
            means, counts = windows.log_means(maps[number])
            for part in range(1, len(means)):
                if np.isfinite(means[part]) and (usable is None or usable[part - 1]):
                    rows.append(Row("map", level, part))
                    y.append(float(means[part]))
                    own.append(float(noise.swe_pixel_fraction / np.sqrt(max(counts[part], 1))))
        return rows, y, own
    speeds = levels.swe_mean_m_per_s[keep]
    for level in np.flatnonzero(np.isfinite(speeds)).tolist():
        pixels = levels.swe_pixels[int(keep[level])]
        cells = max(pixels, 1.0) if np.isfinite(pixels) else 1.0
        rows.append(Row("swe", int(level), 0))
        y.append(float(np.log(speeds[level])))
        own.append(float(np.hypot(noise.swe_level_fraction, noise.swe_pixel_fraction / np.sqrt(cells))))
    return rows, y, own


def travel_zero(levels: Levels, keep: IntArray) -> int:
    """Reference level of the travel, the first that has one: a guide's scale has an arbitrary origin."""
    known = np.flatnonzero(np.isfinite(levels.probe_travel[keep]))
    return int(known[0]) if len(known) else 0


def travel_rows(levels: Levels, keep: IntArray) -> Stacked:
    """Travel relative to the level `travel_zero`, which itself yields no datum."""
    travel, zero = levels.probe_travel[keep], travel_zero(levels, keep)
    used = [int(k) for k in np.flatnonzero(np.isfinite(travel)) if k != zero]
    return (
        [Row("travel", k) for k in used],
        [float(travel[k] - travel[zero]) for k in used],
        [TRAVEL_DEVIATION] * len(used),
    )


def travel_noise(protocol: Protocol, rows: Sequence[Row], zero: int, noise: StatedNoise) -> list[NoisePart]:
    """Common error of all travels: of the travel reading and the depth at the reference level; a depth of 0
    has no error, as it is zero by definition."""
    mine = np.array([row.channel == "travel" for row in rows], dtype=float)
    if not mine.any():
        return []
    deviation = np.hypot(TRAVEL_DEVIATION, noise.depth if protocol.depth[zero] != 0.0 else 0.0)
    return [common("measurement: zero of the travel", deviation * mine, source=noise.source)]


def thickness_rows(levels: Levels, keep: IntArray) -> Stacked:
    first = levels.skin_bone[int(keep[0])] if len(keep) else np.nan
    if not np.isfinite(first):
        return [], [], []
    return [Row("skin-bone", 0)], [float(first)], [THICKNESS_DEVIATION]


def hold_rows(held: HeldForces | None) -> Stacked:
    """The force ratios of each hold, numbered within it (the part); each part is a series.

    Their covariance is given by `hold_noise`, as the ratios of one hold are correlated.
    """
    if held is None:
        return [], [], []
    rows = [Row("hold", k, part) for k, part in enumerate(held.place.tolist())]
    return rows, held.y.tolist(), [0.0] * len(held)


def extra_rows(extras: Sequence[ExtraMeasurement]) -> Stacked:
    rows = [Row(each.name, k) for each in extras for k in range(len(each.y))]
    y = [float(value) for each in extras for value in each.y]
    return rows, y, [float(value) for each in extras for value in each.deviation]


def hold_noise(held: HeldForces | None, rows: Sequence[Row], source: str) -> list[NoisePart]:
    """Noise of the force ratios in holds, over all rows."""
    if held is None:
        return []
    return [_of_channel("hold", held.covariance, rows, "measurement: forces in holds", source)]


def extra_noise(extras: Sequence[ExtraMeasurement], rows: Sequence[Row]) -> list[NoisePart]:
    """Model error in the extra measurements, over all rows."""
    return [
        _of_channel(each.name, each.model_error, rows, f"model: {each.name}", "computed")
        for each in extras if each.model_error is not None
    ]  # fmt: skip


def _of_channel(channel: str, covariance: Array, rows: Sequence[Row], name: str, source: str) -> NoisePart:
    """A noise part that affects a single channel."""
    at = np.array([k for k, row in enumerate(rows) if row.channel == channel], dtype=np.int64)
    whole = np.zeros((len(rows), len(rows)))
    whole[np.ix_(at, at)] = covariance
    return NoisePart(name, whole, source)
