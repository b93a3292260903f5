"""Simulated curves of a site over depth, with interpolation and extrapolation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from limbcli.inference.monotone_interpolation import Monotone, columns_through
from limbcli.model import Array

_FAR = 10.0  # limit of the extrapolation of ln depth beyond a curve's ends
_LARGER = 1e-6  # relative increase of force below which it, and so its logarithm, counts as unchanged


@dataclass(frozen=True, eq=False)
class Curves:
    """A simulated indentation over the probe's depth.

    depth : (n,) mm from 0
    force : (n,) N
    log_speed : (n, n_windows) ln of m/s, NaN where no wave propagates, or (n, 0)
    window_depth : (n_windows,) mm below the face
    thickness : skin to bone along the beam (mm), NaN where the beam meets no bone
    log_line : (n, n_lines) ln of the depth below the skin (mm) of layer borders on the beam; None: not
        recorded
    """

    depth: Array
    force: Array
    log_speed: Array
    window_depth: Array
    thickness: float = float("nan")
    log_line: Array | None = None

    @property
    def columns(self) -> Array:
        """Table (n, n_windows + n_lines): ln speeds, then ln depths of lines."""
        lines = [] if self.log_line is None else [self.log_line]
        return np.column_stack([self.log_speed, *lines])

    def with_table(self, depth: Array, force: Array, table: Array) -> Curves:
        """The curves with these depths, forces and `columns`."""
        n = self.log_speed.shape[1]
        lines = None if self.log_line is None else table[:, n:]
        return replace(self, depth=depth, force=force, log_speed=table[:, :n], log_line=lines)

    @cached_property
    def force_curve(self) -> Monotone:
        return Monotone.through(self.depth, self.force)

    @cached_property
    def depth_curve(self) -> Monotone:
        """ln depth over ln force, at depths > 0 whose force exceeds all before by more than rounding."""
        highest = np.maximum.accumulate(self.force)
        rising = np.flatnonzero(np.diff(highest, prepend=0.0) > _LARGER * highest)
        x, y = np.log(self.force[rising]), np.log(np.maximum(self.depth[rising], 1e-9))
        if len(rising) < 2:  # too few for a curve: force as depth to the power of 1.5
            x0, y0 = (x[0], y[0]) if len(rising) else (0.0, 0.0)
            x, y = np.array([x0, x0 + 1.5]), np.array([y0, y0 + 1.0])
        return Monotone.through(x, y)


def force_at(curves: Curves, depth: Array) -> Array:
    """Force (N) at any depth: 0 before touch, PCHIP within the simulation, extrapolated linearly beyond."""
    curve = curves.force_curve
    return curve.with_lines(depth, 0.0, curve.slopes[-1])


def log_force_at(curves: Curves, depth: Array) -> Array:
    """ln N at depths > 0: PCHIP of ln force over ln depth, extrapolated as a power of depth at both ends."""
    x, y = np.log(curves.depth[1:]), np.log(np.maximum(curves.force[1:], 1e-9))
    at = np.log(np.maximum(depth, 1e-6))
    if len(x) < 2:
        return np.asarray(y[0] + 1.5 * (at - x[0]))
    return _as_powers(Monotone.through(x, y), at)


def depth_at(curves: Curves, force: Array) -> Array:
    """Depth (mm) at forces > 0: PCHIP of ln depth over ln force, extrapolated as a power of force at both
    ends."""
    return np.exp(_as_powers(curves.depth_curve, np.log(np.maximum(force, 1e-9)), far=_FAR))


def _as_powers(curve: Monotone, at: Array, *, far: float = np.inf) -> Array:
    """A curve of logarithms, extrapolated along its first and last secants."""
    x, y = curve.knots, curve.values
    first, last = (y[1] - y[0]) / (x[1] - x[0]), (y[-1] - y[-2]) / (x[-1] - x[-2])
    return curve.with_lines(at, first, last, far=far)


def continued(curves: Curves, depths: Sequence[float], *, like: Curves | None = None) -> Curves:
    """The curves extrapolated to further depths: the force as a power of depth, ln speeds linearly.

    like : curves that reach further; then they are followed, and the difference from them is extrapolated
        linearly
    """
    further, last = np.asarray(depths, dtype=float), curves.depth[-2:]
    if like is None:
        columns = curves.columns
        rise = (columns[-1] - columns[-2]) / (last[1] - last[0])
        table = columns[-1] + np.multiply.outer(further - last[1], rise)
        log_force = log_force_at(curves, further)
    else:
        known = np.column_stack([np.log(np.maximum(curves.force[-2:], 1e-9)), curves.columns[-2:]])
        apart = known - _logs_at(like, last)[:, : known.shape[1]]
        rise = (apart[1] - apart[0]) / (last[1] - last[0])
        found = _logs_at(like, further)[:, : known.shape[1]] + apart[1]
        found = found + np.multiply.outer(further - last[1], rise)
        log_force, table = found[:, 0], found[:, 1:]
    depth, force = np.r_[curves.depth, further], np.r_[curves.force, np.exp(log_force)]
    return curves.with_table(depth, force, np.vstack([curves.columns, table]))


def filled(curves: Curves, like: Curves, rows: Sequence[int]) -> Curves:
    """The curves at all depths down to their last, of which they were solved at some.

    The difference from other curves is interpolated; that of ln force is constant before the first depth.

    rows : numbers, from 0 (depth 0) on, of the solved depths among those of `like`
    """
    n, solved = rows[-1] + 1, list(rows)
    depth, base, known = like.depth[:n].copy(), _logs(like)[:n], _logs(curves)
    depth[solved] = curves.depth
    table = base + columns_through(curves.depth, known - base[solved], depth)
    table[solved] = known
    return curves.with_table(depth, np.r_[curves.force[:1], np.exp(table[1:, 0])], table[:, 1:])


def _logs(curves: Curves) -> Array:
    """ln force (NaN at depth 0), ln speeds and ln lines (n, 1 + n_parts + n_lines)."""
    log_force = np.log(np.maximum(curves.force[1:], 1e-9))
    return np.column_stack([np.concatenate([[np.nan], log_force]), curves.columns])


def _logs_at(curves: Curves, depth: Array) -> Array:
    """ln force, ln speeds and ln lines (n, 1 + n_parts + n_lines) at depths > 0."""
    speeds = [np.interp(depth, curves.depth, column) for column in curves.columns.T]
    return np.column_stack([log_force_at(curves, depth), *speeds])


def depth_of_force(curves: Curves, force: float) -> float:
    """Depth (mm) at which the simulated curve reaches a force.

    >>> c = Curves(np.linspace(0, 10, 6), np.linspace(0, 20, 6), np.zeros((6, 0)), np.zeros(0))
    >>> round(depth_of_force(c, 4.0), 6)
    2.0
    """
    curve, end = curves.force_curve, float(curves.depth[-1])
    if force >= curves.force[-1]:
        return min(end + (force - float(curves.force[-1])) / max(float(curve.slopes[-1]), 1e-9), 2.0 * end)
    return float(curve.inverse(np.array([force]))[0]) if force > 0 else float(curves.depth[0])


def without_gaps(curves: Curves) -> Array:
    """ln speed (n, n_windows) with the depths at which a window shows no wave taken from its others.

    Interpolated between these, constant before the first and extrapolated linearly beyond the last; NaN for a
    window with fewer than two.
    """
    return columns_through(curves.depth, curves.log_speed, curves.depth)


def gaps_filled(table: Array) -> Array:
    """Changes (n, n_columns) by depth, with missing ones interpolated over the rows, constant at both ends.

    0 for a column without any.

    >>> nan = np.nan
    >>> gaps_filled(np.array([[nan, nan], [1.0, nan], [nan, nan], [3.0, nan]])).T
    array([[1., 1., 2., 3.],
           [0., 0., 0., 0.]])
    """
    known, out, rows = np.isfinite(table), np.zeros_like(table), np.arange(len(table))
    for k in np.flatnonzero(known.any(axis=0)).tolist():
        here = known[:, k]
        out[:, k] = np.interp(rows, rows[here], table[here, k])
    return out
