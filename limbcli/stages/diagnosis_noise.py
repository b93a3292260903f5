"""The noise of a site's data: what was stated of the readings, and what is known of the model's own error.

Depth is the noisy reading, force and speeds are compared at the measured depth; its error then
moves force, speeds and travel of a level together, which the covariance holds:
residual of the force -K e_d, of ln speed -s e_d, of the travel -e_d (K, s: measured slopes).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.case import Noise as StatedNoise
from limbcli.diagnostics.noise import NoisePart, common, correlated, independent
from limbcli.effects.reading import Protocol
from limbcli.measurement.indentation import Levels
from limbcli.model import Array, IntArray
from limbcli.stages.diagnosis_rows import Row

GAIN_OF_SPEEDS = "gain of all speeds"
COMMON_GAIN = 0.03  # of all speeds alike: calibration of the scanner (assumed; nobody states it)
PART_ERROR = 0.025  # of a part's mean speed, at every level: the model's resolution (assumed)
FEWEST_SMOOTH = 4
_STEEP, _STRAIGHT = 0.01, 10.0  # of the largest force: where a curve's even part ends
_WITH_DEPTH = ("force", "swe", "map", "travel", "skin-bone")


@dataclass(frozen=True, eq=False)
class ModelError:
    """An error of the model: ln force (n_levels,), ln speed (n_levels, n_parts), one deviation each.

    correlation None : one common factor; else that between neighbouring levels
    depth : mm, of the depth at every level alike; strain : fraction, of all depths by one factor
    """

    name: str
    log_force: Array
    log_speed: Array
    correlation: float | None = None
    depth: float = 0.0
    strain: float = 0.0


def noise_parts(
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
        shift = each.depth + each.strain * protocol.depth[np.minimum(levels, len(protocol) - 1)]
        direction = direction + shift * np.where(is_travel, 0.0, slope)
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
    """How each datum changes with depth (n,), from smooth curves through the measured values.

    Depth and speeds are smoothed over the force, which is read without much error: over a depth with errors
    the slope of a steep curve comes out too low.
    """
    out = np.zeros(len(rows))
    smooth = SmoothDepth.through(protocol)
    groups: dict[tuple[str, int], list[int]] = {}
    for k, row in enumerate(rows):
        groups.setdefault((row.channel, row.part), []).append(k)
    for (channel, _), members in groups.items():
        if channel not in _WITH_DEPTH:
            continue
        force = protocol.force[[rows[k].level for k in members]]
        place = smooth.place(force)
        if channel == "travel":
            out[members] = 1.0
        elif channel == "force":
            out[members] = (np.maximum(force, 0.0) + smooth.unit) / smooth.rate
        elif channel != "skin-bone" and len(members) >= 3 and np.ptp(place) > 0:
            curve = np.polynomial.Polynomial.fit(place, y[members], 2 if len(members) > 4 else 1)
            out[members] = curve.deriv()(place) / smooth.rate
    return out


def readings(levels: Levels) -> Protocol:
    """The levels that have a force and a depth."""
    known = np.isfinite(levels.force) & np.isfinite(levels.depth)
    return Protocol(levels.force[known], levels.depth[known], levels.hold[known])


def deepest(protocol: Protocol) -> float:
    """mm that the probe went in, of a smooth curve through the readings, but no deeper than they are."""
    smooth, read = SmoothDepth.through(protocol), float(np.max(protocol.depth, initial=0.0))
    if len(protocol) < FEWEST_SMOOTH:
        return read
    return min(float(np.max(smooth.at(protocol.force))), read)


@dataclass(frozen=True)
class SmoothDepth:
    """depth = start + rate ln(1 + F/unit), as a force has it that first grows evenly and then exponentially;
    mm, mm, N."""

    start: float
    rate: float
    unit: float

    @staticmethod
    def through(protocol: Protocol) -> SmoothDepth:
        """By least squares over the depths, the noisier reading.

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
            x = _place(protocol.force, unit)
            rate, start = np.polyfit(x, protocol.depth, 1)
            left = float(np.sum((protocol.depth - start - rate * x) ** 2))
            if rate > 0 and left < best:
                best, found = left, SmoothDepth(float(start), float(rate), float(unit))
        return found

    def at(self, force: Array) -> Array:
        """mm at these forces."""
        return self.start + self.rate * self.place(force)

    def place(self, force: Array) -> Array:
        """Where forces are along the curve: ln(1 + F/unit)."""
        return _place(force, self.unit)


def _place(force: Array, unit: float) -> Array:
    return np.log1p(np.maximum(force, 0.0) / unit)
