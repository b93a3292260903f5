"""Detect the holds in a load-cell record, and evaluate each of them.

A hold is an interval in which the force, smoothed over half a second, stays within a tolerance of its
mid-range for at least a given time. Its mean is reported with a standard error that accounts for the
correlation of adjacent samples (batch means), and with the drift that persists at its end.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from limbcli.errors import MeasurementError
from limbcli.measurement.trace import Trace
from limbcli.model import Array, IntArray

_FEWEST_SAMPLES = 3
# smallest number of depth or travel readings in a hold, for a mean with a standard error
_FEWEST_READINGS = 2
SMOOTHING_S = 0.5
_BATCHES = 10
_DROPOUT_FACTOR = 3.0
_CREEP_SIGNIFICANCE = 4.0
# g: largest deviation from 1 g; cheap accelerometers are off by some hundredths, wrong units by far more
_GRAVITY_OFF = 0.15
_SPIKE = 8.0  # robust standard deviations from the hold's median beyond which a sample is a spike


@dataclass(frozen=True, kw_only=True)
class Hold:
    """One hold: its time, its mean force, and how unsteady it was.

    force_se : standard error of the mean, N; force_sd : standard deviation of single samples, N
    drift_n_per_s : slope over the second half, N/s
    overshoot : N by which the force exceeded the hold in the two seconds before it
    n_dropouts : gaps of more than three sampling intervals; n_spikes : samples rejected as spikes
    depth, depth_drift_mm_per_s : mean and slope of the depth, None if the hold has fewer than two readings
    probe_travel : its mean, mm, None likewise
    """

    start_s: float
    end_s: float
    force: float
    force_se: float
    force_sd: float
    drift_n_per_s: float
    overshoot: float
    n_dropouts: int
    n_spikes: int
    depth: float | None
    depth_se: float | None
    depth_drift_mm_per_s: float | None
    probe_travel: float | None
    creeping: bool

    @property
    def duration_s(self) -> float:
        return self.end_s - self.start_s


def find_holds(trace: Trace, *, tolerance: float = 0.1, duration_s: float = 5.0) -> list[Hold]:
    """All holds of a record, in order of time.

    tolerance : N, half the width of the band in which the smoothed force must stay
    duration_s : smallest duration of a hold

    Raises MeasurementError if there is none, stating the longest interval found.
    """
    good = np.isfinite(trace.force)
    if good.sum() < _FEWEST_SAMPLES:
        raise MeasurementError(
            f"{int(good.sum())} of {len(good)} samples of the record contain a force",
            where=str(trace.path),
            fix="give the column of the force (columns) and its decimal mark",
        )
    time, force = trace.time[good], trace.force[good]
    smooth = _smoothed(time, force, SMOOTHING_S)
    stretches = _steady_stretches(smooth, 2 * tolerance)
    chosen = _longest_first(time, stretches, duration_s)
    if not chosen:
        longest = max((time[b] - time[a] for a, b in stretches), default=0.0)
        raise MeasurementError(
            f"no hold of {duration_s:g} s within +-{tolerance:g} N; the longest lasts {longest:.1f} s, the "
            f"record spans {force.min():.3g} to {force.max():.3g} N",
            where=str(trace.path),
            fix="hold longer or more steadily, or state hold_s, hold_tolerance_n and force_unit as they were",
            longest_s=float(longest),
        )
    depth, travel = (None if each is None else each[good] for each in (trace.depth, trace.probe_travel))
    resolution = _resolution(force)
    return [_describe(time, force, depth, travel, a, b, resolution) for a, b in chosen]


def _smoothed(time: Array, force: Array, window_s: float) -> Array:
    """Median (against spikes), then mean, over a centred window."""
    step = float(np.median(np.diff(time)))
    n = max(1, round(window_s / step)) | 1
    if n < 3 or len(force) < n:
        return force
    padded = np.pad(median_filter(force, size=n, mode="nearest"), n // 2, mode="edge")
    return np.convolve(padded, np.full(n, 1.0 / n), mode="valid")


def _steady_stretches(force: Array, width: float) -> list[tuple[int, int]]:
    """All maximal index ranges [a, b] in which the force varies by at most `width` N."""
    high: deque[int] = deque()
    low: deque[int] = deque()
    found, a = [], 0
    for b in range(len(force)):
        while high and force[high[-1]] <= force[b]:
            high.pop()
        while low and force[low[-1]] >= force[b]:
            low.pop()
        high.append(b)
        low.append(b)
        if force[high[0]] - force[low[0]] > width:
            found.append((a, b - 1))
            while force[high[0]] - force[low[0]] > width:
                a += 1
                while high[0] < a:
                    high.popleft()
                while low[0] < a:
                    low.popleft()
    found.append((a, len(force) - 1))
    return found


def _longest_first(time: Array, stretches: list[tuple[int, int]], duration_s: float) -> list[tuple[int, int]]:
    """Non-overlapping ranges of at least `duration_s`, the longest preferred, in order of time."""
    chosen: list[tuple[int, int]] = []
    for a, b in sorted(stretches, key=lambda each: time[each[0]] - time[each[1]]):
        for c, d in chosen:
            if c <= b and a <= d:  # remove the part that is already taken
                a, b = (d + 1, b) if a >= c else (a, c - 1)
        if b > a and time[b] - time[a] >= duration_s:
            chosen.append((a, b))
    return sorted(chosen)


def _describe(
    time: Array, force: Array, depth: Array | None, travel: Array | None, a: int, b: int, resolution: float
) -> Hold:
    inside = a + np.flatnonzero(_sane(force[a : b + 1], resolution))
    # samples of the adjacent ramps at the ends are not counted as spikes
    a, b = int(inside[0]), int(inside[-1])
    gaps = int((np.diff(time[a : b + 1]) > _DROPOUT_FACTOR * float(np.median(np.diff(time)))).sum())
    t, f = time[inside], force[inside]
    late = t >= 0.5 * (t[0] + t[-1])
    drift, drift_se = _slope(t[late], f[late])
    before = (time < t[0]) & (time >= t[0] - 2.0)
    overshoot = float(force[before].max() - f.mean()) if before.any() else 0.0
    depth_mean = depth_se = depth_drift = None
    creeping = abs(drift) > _CREEP_SIGNIFICANCE * drift_se and abs(drift) * (t[-1] - t[0]) > f.std()
    d = _known(depth, inside)
    if d is not None:
        known = np.isfinite(d)
        depth_mean, depth_se = float(d[known].mean()), _standard_error(d[known])
        depth_drift, slope_se = _slope(t[late & known], d[late & known])
        creeping = creeping or abs(depth_drift) > _CREEP_SIGNIFICANCE * slope_se
    way = _known(travel, inside)
    return Hold(
        start_s=float(t[0]),
        end_s=float(t[-1]),
        force=float(f.mean()),
        force_se=_standard_error(f),
        force_sd=float(f.std(ddof=1)),
        drift_n_per_s=drift,
        overshoot=max(0.0, overshoot),
        n_dropouts=gaps,
        n_spikes=b + 1 - a - len(inside),
        depth=depth_mean,
        depth_se=depth_se,
        depth_drift_mm_per_s=depth_drift,
        probe_travel=None if way is None else float(np.nanmean(way)),
        creeping=bool(creeping),
    )


def _known(readings: Array | None, inside: IntArray) -> Array | None:
    """A hold's readings (n,), with NaN where sampled less often than the force; None if there are too few."""
    found = None if readings is None else readings[inside]
    return None if found is None or np.isfinite(found).sum() < _FEWEST_READINGS else found


def _sane(force: Array, resolution: float) -> NDArray[np.bool_]:
    """Mask of samples that are not spikes: within eight robust standard deviations of the hold's median.

    The standard deviation is at least the resolution: if most samples have the same value it would be 0, and
    the next value that the load cell can show would be a spike.
    """
    off = np.abs(force - np.median(force))
    return np.asarray(off <= _SPIKE * max(1.4826 * float(np.median(off)), resolution))


def _resolution(force: Array) -> float:
    """Typical step (N) between the distinct values of a record (n,).

    >>> round(_resolution(np.array([0.0, 0.1, 0.1, 0.2, 0.3, 40.0])), 6)
    0.1
    """
    steps = np.diff(np.unique(force))
    return max(float(np.median(steps)), 1e-6) if len(steps) else 1e-6


def _standard_error(values: Array) -> float:
    """Standard error of the mean of correlated samples, from the spread of batch means."""
    means = [float(each.mean()) for each in np.array_split(values, _BATCHES) if len(each)]
    return float(np.std(means, ddof=1) / np.sqrt(len(means)))


def _slope(time: Array, values: Array) -> tuple[float, float]:
    """Slope of a line and its standard error, from batch means (so that correlation does not reduce it)."""
    if len(values) < _BATCHES:
        return 0.0, float("inf")
    t = np.array([each.mean() for each in np.array_split(time, _BATCHES)])
    v = np.array([each.mean() for each in np.array_split(values, _BATCHES)])
    centred = t - t.mean()
    slope = float(centred @ v / (centred @ centred))
    rest = v - v.mean() - slope * centred
    return slope, float(np.sqrt(rest @ rest / (_BATCHES - 2) / (centred @ centred)))


def without_probe_weight(
    trace: Trace, *, probe_mass_kg: float, axis: str = "z", tare_s: tuple[float, float]
) -> Trace:
    """The record with the tare and the probe's own weight subtracted.

    The load cell carries the component of the probe's weight along its axis, m g cos(theta), which changes as
    the probe tilts; its reading in air during `tare_s` is zero force. F = F_read - F_tare - m g (cos(theta) -
    cos(theta_tare)), with cos(theta) from the accelerometer's reading along `axis` ("x", "y", "z"; "-z" if it
    points the other way).

    Raises MeasurementError if there is no accelerometer record, it is not in g, or no sample lies within
    `tare_s`.
    """
    from dataclasses import replace

    from limbcli.numbers.units import GRAVITY_M_PER_S2

    in_air = (trace.time >= tare_s[0]) & (trace.time <= tare_s[1]) & np.isfinite(trace.force)
    if not in_air.any():
        fix = "state tare_s = [from, to], an interval in which the probe hung free"
        what = f"no sample lies within tare_s = [{tare_s[0]:g}, {tare_s[1]:g}] s"
        raise MeasurementError(what, where=str(trace.path), fix=fix)
    force = trace.force - float(np.nanmean(trace.force[in_air]))
    if probe_mass_kg:
        if trace.acceleration_g is None:
            fix = "add accel_x_g, accel_y_g and accel_z_g, or remove probe_mass_kg"
            what = "the probe's weight cannot be subtracted without its orientation"
            raise MeasurementError(what, where=str(trace.path), fix=fix)
        _check_gravity(trace.acceleration_g[in_air], trace)
        sign = -1.0 if axis.startswith("-") else 1.0
        cosine = sign * trace.acceleration_g[:, "xyz".index(axis[-1])]
        known = np.isfinite(cosine)  # an accelerometer is often sampled less often than the force
        cosine = np.interp(trace.time, trace.time[known], cosine[known])
        smooth = _smoothed(trace.time, cosine, SMOOTHING_S)
        turned = smooth - float(np.nanmean(smooth[in_air]))
        force = force - probe_mass_kg * GRAVITY_M_PER_S2 * turned
    return replace(trace, force=force)


def _check_gravity(acceleration_g: Array, trace: Trace) -> None:
    """Check that at rest the accelerometer reads 1 g (n_samples, 3), whatever its orientation."""
    size = np.linalg.norm(acceleration_g, axis=1)
    size = size[np.isfinite(size)]
    felt = float(np.median(size)) if len(size) else 0.0
    if abs(felt - 1.0) > _GRAVITY_OFF:
        what = f"the accelerometer reads {felt:.3g} g while the probe hangs free, not 1 g"
        fix = (
            "give accel_x_g, accel_y_g and accel_z_g in g (from m/s2: divide by 9.80665), their zeros taken "
        )
        raise MeasurementError(what, where=str(trace.path), fix=f"{fix}off, or remove probe_mass_kg")


def missing_levels(holds: list[Hold], *, step: float = 2.0) -> list[float]:
    """Forces (N) of a regular protocol that are missing among the holds, between the lowest and the highest.

    >>> missing_levels([], step=2.0)
    []
    """
    if not holds:
        return []
    found = {round(each.force / step) for each in holds}
    return [k * step for k in range(min(found), max(found)) if k not in found]


def cycles_of_holds(forces: Sequence[float], *, turn: float) -> tuple[list[int], list[str]]:
    """The cycle (from 1) and the phase ("load", "unload") of every hold.

    The force has turned when it has reversed by `turn` from its last extreme. A peak belongs to the loading
    before it; a trough to the loading after it, as its level 0, unless it is the last hold of the record.

    forces : (n_holds,) N, in order of time; turn : N

    >>> cycles_of_holds([0, 2, 4, 2, 0, 2, 4], turn=1.0)
    ([1, 1, 1, 1, 2, 2, 2], ['load', 'load', 'load', 'unload', 'load', 'load', 'load'])
    >>> cycles_of_holds([0, 2, 4, 3.7, 6], turn=1.0)
    ([1, 1, 1, 1, 1], ['load', 'load', 'load', 'load', 'load'])
    """
    turns = _turning_points(forces, turn)
    cycle, phase = np.ones(len(forces), dtype=int), np.full(len(forces), "load", dtype=object)
    for k, start in enumerate(turns):
        rising = k % 2 == 1  # the first turn is a peak
        if rising:
            cycle[start:] += 1
            phase[start:] = "load"
        else:
            phase[start + 1 :] = "unload"
    return [int(each) for each in cycle], [str(each) for each in phase]


def _turning_points(forces: Sequence[float], turn: float) -> list[int]:
    """Holds at which the force turns: peaks and troughs alternately, a peak first.

    >>> _turning_points([0, 2, 4, 2, 0, 2, 4], 1.0)
    [2, 4]
    """
    found: list[int] = []
    extreme, rising = 0, True
    for k, force in enumerate(forces):
        ahead = force - forces[extreme] if rising else forces[extreme] - force
        if ahead >= 0:
            extreme = k
        elif -ahead >= turn:
            found.append(extreme)
            extreme, rising = k, not rising
    return found
