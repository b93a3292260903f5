"""Relaxation from a load-cell record: how the force falls within each hold.

Each hold is reduced from thousands of samples to the mean forces of its first half second and of periods
that double in length (0.5 to 1 s, 1 to 2 s, ... to the end), and these to ln of each over the next. They are
compared with the elastic force at the recorded depth, with the relaxation and drainage terms of an
explanation.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from limbcli.diagnosis.explanations import decisions
from limbcli.effects.curves import Curves, force_at
from limbcli.effects.reading import Reading, borne_at_zero, relaxed, true_depth
from limbcli.measurement.indentation import Levels, Trace
from limbcli.model import Array, IntArray

STEP_S = 0.25  # s, time step of the grid
_RAMP_SHARE = 0.2  # slope of the force, as a fraction of the steepest ramps, above which it is a ramp
_DEPTH_SHARE = 0.05  # the same for a depth record, whose steps vary more in size
# Slope of the force, as a fraction of the steepest ramps, above which it is a ramp although the recorded
# depth is steady: in very stiff tissue a step is smaller than the depth's reading error. Relaxation is less
# steep.
_FORCE_SHARE = 0.4
_RAMP_SD = 5.0  # slope in standard deviations of its own noise from which it counts as a ramp
_PAUSE_S, _PAUSE_SAMPLES = 1.0, 5.0  # s, sampling intervals: longer gaps are pauses, with unknown motion
_MOVED_SHARE = 0.15  # relative error of the force change that movement within a hold explains
_FIRST_S = 0.5  # s, first period of a hold whose mean force is used
_LEAST_HOLD_S, _LEAST_FORCE = 3.0, 1.0  # s, N: shortest hold, smallest mean force of a hold that is used
# Standard deviation of ln of the force at the start of a hold over that at its end, from other causes
# (assumed); it accumulates from ratio to ratio.
_FLOOR = 0.006


@dataclass(frozen=True, eq=False)
class HeldForces:
    """A record on a grid of `STEP_S`, and the force ratios read from its holds.

    depth (n,) mm; windows (n_features, 2, 2): from, to (exclusive) on the grid, of the two windows
    that are compared; y (n_features,): ln of the mean force in the first window over that in the second;
    covariance (n_features, n_features): of these
    """

    depth: Array
    windows: IntArray
    y: Array
    covariance: Array

    def __len__(self) -> int:
        return len(self.y)

    @property
    def place(self) -> IntArray:
        """Place (n_features,) of each ratio within its hold, from 0."""
        found = np.zeros(len(self), dtype=np.int64)
        for k, goes_on in enumerate(_with_next(self.windows)[:-1].tolist(), 1):
            found[k] = found[k - 1] + 1 if goes_on else 0
        return found

    def fallen(self, curves: Curves) -> float:
        """Total fall of the forces beyond the elastic prediction over all holds, in standard deviations."""
        off = self.y - self.predict(curves, Reading())
        return float(np.sum(off) / np.sqrt(np.sum(self.covariance)))

    def predict(self, curves: Curves, reading: Reading) -> Array:
        """Prediction of `y` (n_features,) by a model."""
        return fall(self.force(curves, reading), self.windows)

    def force(self, curves: Curves, reading: Reading) -> Array:
        """Prediction of the recorded force (n,) in N on the grid by a model."""
        depth = true_depth(curves, self.depth, reading)
        force = relaxed(force_at(curves, depth), curves, depth, reading, relaxing)
        return reading.force_gain * (force - borne_at_zero(curves, reading)) + reading.force_zero


def relaxing(elastic: Array, tau: float, _rest: float = 0.0) -> Array:
    """Integral of exp(-(t - s)/tau) dF_e (n,) on the grid, linear within each step and level before.

    >>> np.round(relaxing(np.array([0.0, 1.0, 1.0]), 0.25), 4)
    array([0.    , 0.6321, 0.2325])
    """
    from scipy.signal import lfilter  # takes half a second to import

    kept = float(np.exp(-STEP_S / tau))
    fresh = tau / STEP_S * (1.0 - kept)
    return np.asarray(lfilter([fresh], [1.0, -kept], np.diff(elastic, prepend=elastic[0])))


def fall(force: Array, windows: IntArray) -> Array:
    """ln of the mean force in the first window over that in the second (n_features,)."""
    sums = np.concatenate([[0.0], np.cumsum(force)])
    means = (sums[windows[:, :, 1]] - sums[windows[:, :, 0]]) / (windows[:, :, 1] - windows[:, :, 0])
    means = np.maximum(means, 1e-6)
    return np.asarray(np.log(means[:, 0] / means[:, 1]))


def held_forces(trace: Trace, levels: Levels) -> tuple[HeldForces | None, str]:
    """Force ratios of the holds of a record, or None and the reason why there are none. Without a recorded
    depth, holds are matched to the levels and must show a falling force, as a constant one may have been
    regulated."""
    time = np.arange(trace.time[0], trace.time[-1], STEP_S)
    if len(time) * STEP_S < _LEAST_HOLD_S:
        return None, "the record is shorter than one hold"
    force = _binned(trace.time, trace.force, time)
    recorded = trace.depth is not None and np.isfinite(trace.depth).mean() > 0.9
    steering = _binned(trace.time, trace.depth, time) if recorded and trace.depth is not None else force
    steady = is_steady(steering, share=_DEPTH_SHARE if recorded else _RAMP_SHARE)
    if recorded:
        steady &= is_steady(force, share=_FORCE_SHARE)
    # interpolated values in a pause of the record are not a hold
    after = np.clip(np.searchsorted(trace.time, time + 0.5 * STEP_S), 1, len(trace.time) - 1)
    pause = max(_PAUSE_S, _PAUSE_SAMPLES * float(np.median(np.diff(trace.time))))
    read = np.asarray(trace.time[after] - trace.time[after - 1] <= pause)
    holds = stretches(steady & read)
    if not holds:
        return None, f"the record has no hold of {_LEAST_HOLD_S:g} s"
    depth = steering if recorded else _depth_of_levels(holds, force, levels, len(time))
    if depth is None:
        return None, f"the record has no depth, and its {len(holds)} holds are not the levels"
    # The first hold after a pause is excluded: it relaxes from an unrecorded movement.
    before = [0, *(end for _, end in holds)]
    seen = [(a, b) for (a, b), last in zip(holds, before[:-1], strict=True) if read[last:a].all()]
    windows, means = _windows(seen, force)
    if not len(windows):
        return None, "no hold has an appreciable force"
    covariance = _covariance(trace, windows, means, depth if recorded else None)
    found = HeldForces(depth, windows, fall(force, windows), covariance)
    if not recorded:
        fallen = float(np.sum(found.y) / np.sqrt(np.sum(found.covariance)))
        if fallen < decisions.FALLEN_SD:
            return None, "the record has no depth, and its force is steady: it may have been held by hand"
    return found, ""


def is_steady(signal: Array, *, share: float = _RAMP_SHARE) -> NDArray[np.bool_]:
    """Where a signal (n,) on the grid is not ramping: slope at most `share` of the steepest ramps."""
    slope = np.abs(np.gradient(signal))
    noise = 1.4826 * float(np.median(slope))
    slope = np.maximum(slope, np.maximum(np.roll(slope, 1), np.roll(slope, -1)))
    limit = max(share * float(np.quantile(slope, 0.98)), _RAMP_SD * noise)
    return np.asarray(slope <= limit)


def stretches(steady: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Intervals [from, to) of the grid that are steady for at least 3 s."""
    edges = np.flatnonzero(np.diff(np.r_[0, steady.astype(int), 0]))
    pairs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [(a, b) for a, b in pairs if (b - a) * STEP_S >= _LEAST_HOLD_S]


def _binned(at: Array, values: Array, grid: Array) -> Array:
    """Means over the bins of the grid; empty bins are interpolated linearly."""
    index = np.clip(((at - grid[0]) / STEP_S).astype(int), 0, len(grid) - 1)
    known = np.isfinite(values)
    count = np.bincount(index[known], minlength=len(grid))
    total = np.bincount(index[known], weights=values[known], minlength=len(grid))
    there = count > 0
    return np.interp(np.arange(len(grid)), np.flatnonzero(there), total[there] / count[there])


def _depth_of_levels(holds: list[tuple[int, int]], force: Array, levels: Levels, n: int) -> Array | None:
    """Depth (n,) on the grid by each hold's level (the first may be missing); None if they do not match."""
    wanted = levels.depth[np.isfinite(levels.depth)]
    if len(holds) == len(wanted) - 1 and float(np.mean(force[slice(*holds[0])])) > 0.5 * levels.force[1]:
        wanted = wanted[1:]
    if len(holds) != len(wanted):
        return None
    at = [each for a, b in holds for each in (a, b - 1)]
    return np.interp(np.arange(n), at, np.repeat(wanted, 2))


def _windows(holds: list[tuple[int, int]], force: Array) -> tuple[IntArray, Array]:
    """Consecutive periods of the holds (n_features, 2, 2), and their holds' mean force (n_features,)."""
    windows, means = [], []
    for a, b in holds:
        mean = float(np.mean(force[a:b]))
        if mean < _LEAST_FORCE:
            continue
        pairs = list(pairwise(periods(a, b)))
        windows += pairs
        means += [mean] * len(pairs)
    return np.array(windows, dtype=np.int64).reshape(-1, 2, 2), np.array(means)


def periods(a: int, b: int) -> list[tuple[int, int]]:
    """Periods [from, to) of a hold on the grid: its first half second, then each as long as all before it.

    The last one goes to the end of the hold, and is at least half as long as all before it.

    >>> [(STEP_S * start, STEP_S * end) for start, end in periods(0, round(19.0 / STEP_S))]
    [(0.0, 0.5), (0.5, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 8.0), (8.0, 19.0)]
    >>> [(STEP_S * start, STEP_S * end) for start, end in periods(0, round(3.0 / STEP_S))]
    [(0.0, 0.5), (0.5, 1.0), (1.0, 2.0), (2.0, 3.0)]
    """
    first = round(_FIRST_S / STEP_S)
    ends = [first]
    while 3 * ends[-1] <= b - a:
        ends.append(2 * ends[-1])
    edges = [a, *(a + end for end in ends), b]
    return list(pairwise(edges))


def _with_next(windows: IntArray) -> NDArray[np.bool_]:
    """Whether the second window (n_features,) of a pair is the first of the next one."""
    return np.append(np.all(windows[:-1, 1] == windows[1:, 0], axis=1), False)


def _covariance(trace: Trace, windows: IntArray, force: Array, moving: Array | None) -> Array:
    """Covariance (n_features, n_features) of the ln force ratios, of which two successive ones share a
    window: scatter of the force samples, of the depth samples and of movement (`moving`, the recorded depth
    on the grid) times the stiffness, and the floor."""
    rate = 1.0 / float(np.median(np.diff(trace.time)))
    samples = np.maximum((windows[:, :, 1] - windows[:, :, 0]) * STEP_S * rate, 1.0)
    of_samples = (_scatter(trace.force) / force[:, None]) ** 2 / samples
    moved = np.zeros(len(force))
    if moving is not None and trace.depth is not None:
        deepest = float(np.nanmax(trace.depth))
        stiffness = 1.5 * float(np.nanmax(trace.force)) / max(deepest, 1.0)  # N/mm, of a power of depth
        places = np.array([[moving[a:b].mean() for a, b in pair] for pair in windows])
        moved = (stiffness * _MOVED_SHARE * np.abs(places[:, 0] - places[:, 1]) / force) ** 2
        of_samples += (stiffness * _scatter(trace.depth) / force[:, None]) ** 2 / samples
    shared = np.where(_with_next(windows), of_samples[:, 1], 0.0)[:-1]
    own = of_samples.sum(axis=1) + 2 * moved + floors(windows)
    return np.asarray(np.diag(own) - np.diag(shared, 1) - np.diag(shared, -1))


def floors(windows: IntArray) -> Array:
    """Variance (n_features,) of ln force ratios from other causes, in equal parts for those of one hold."""
    hold = np.cumsum(np.append(0, ~_with_next(windows)[:-1]))
    return np.asarray(_FLOOR**2 / np.bincount(hold)[hold])


def _scatter(values: Array) -> float:
    """Standard deviation of single samples, estimated from successive differences."""
    known = values[np.isfinite(values)]
    return float(1.4826 * np.median(np.abs(np.diff(known))) / np.sqrt(2)) if len(known) > 2 else 0.0
