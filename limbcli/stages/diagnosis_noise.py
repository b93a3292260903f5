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
from limbcli.model import Array, IntArray
from limbcli.stages.diagnosis_rows import Row

GAIN_OF_SPEEDS = "gain of all speeds"
COMMON_GAIN = 0.03  # of all speeds alike: calibration of the scanner (assumed; nobody states it)
PART_ERROR = 0.025  # of a part's mean speed, at every level: the model's resolution (assumed)
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
    depth_rate = _rate_over_force(protocol)
    groups: dict[tuple[str, int], list[int]] = {}
    for k, row in enumerate(rows):
        groups.setdefault((row.channel, row.part), []).append(k)
    for (channel, _), members in groups.items():
        if channel not in _WITH_DEPTH:
            continue
        levels = [rows[k].level for k in members]
        place = _place(protocol)[levels]
        if channel == "travel":
            out[members] = 1.0
        elif channel == "force":
            per_place = protocol.force[levels] + _force_unit(protocol)
            out[members] = per_place / depth_rate[levels]
        elif channel != "skin-bone" and len(members) >= 3 and np.ptp(place) > 0:
            curve = np.polynomial.Polynomial.fit(place, y[members], 2 if len(members) > 4 else 1)
            out[members] = curve.deriv()(place) / depth_rate[levels]
    return out


def deepest(protocol: Protocol) -> float:
    """mm that the probe went in, of a smooth curve through the readings."""
    along = _depth_over_place(protocol)
    if along is None:
        return float(np.max(protocol.depth, initial=0.0))
    return min(float(np.max(along(_place(protocol)))), float(np.max(protocol.depth)))


def _force_unit(protocol: Protocol) -> float:
    """N: a tenth of the largest force."""
    return max(0.1 * float(np.max(protocol.force, initial=0.0)), 1e-3)


def _place(protocol: Protocol) -> Array:
    """Where each level (n_levels,) is along the curve: ln(1 + F/F1), in which depth is nearly a parabola."""
    return np.log1p(np.maximum(protocol.force, 0.0) / _force_unit(protocol))


def _depth_over_place(protocol: Protocol) -> np.polynomial.Polynomial | None:
    """A parabola through the readings; None of fewer than four."""
    if len(protocol) < 4 or np.ptp(protocol.force) <= 0:
        return None
    return np.polynomial.Polynomial.fit(_place(protocol), protocol.depth, 2)


def _rate_over_force(protocol: Protocol) -> Array:
    """d depth / d place (n_levels,) of that parabola; never below a tenth of the mean."""
    x, along = _place(protocol), _depth_over_place(protocol)
    mean = max(float(np.ptp(protocol.depth)) / max(float(np.ptp(x)), 1e-9), 1e-9)
    return np.full(len(x), mean) if along is None else np.maximum(along.deriv()(x), 0.1 * mean)
