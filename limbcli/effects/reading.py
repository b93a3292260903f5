"""From what happens in the tissue to what is written down: the measurement's own side of a model.

`Curves` is what a simulation says of a site; a `Reading` is how instruments and
operator distort it; `read` gives what levels.csv should then hold. Measurement
effects are pure changes of the `Reading`, as tissue effects are of the `LimbModel`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from limbcli.model import Array, IntArray
from limbcli.monotone import Monotone

_FAR = 10.0  # of ln depth beyond a curve's ends


@dataclass(frozen=True, eq=False)
class Curves:
    """A simulated indentation over the probe's depth.

    depth (n,) mm from 0; force (n,) N; log_speed (n, n_windows) ln of m/s, NaN where no
    wave runs, or (n, 0); window_depth (n_windows,) mm below the face; thickness: skin to bone
    along the beam, mm, NaN where the beam meets no bone
    log_line (n, n_lines) ln of mm below the skin of the borders of layers on the beam; None: not followed
    """

    depth: Array
    force: Array
    log_speed: Array
    window_depth: Array
    thickness: float = float("nan")
    log_line: Array | None = None

    @property
    def columns(self) -> Array:
        """(n, n_windows + n_lines): ln speeds, then ln depths of lines."""
        lines = [] if self.log_line is None else [self.log_line]
        return np.column_stack([self.log_speed, *lines])

    def with_columns(self, table: Array) -> dict[str, Array | None]:
        """What of these curves such a table replaces."""
        n = self.log_speed.shape[1]
        return {"log_speed": table[:, :n], "log_line": None if self.log_line is None else table[:, n:]}

    @cached_property
    def force_curve(self) -> Monotone:
        return Monotone.through(self.depth, self.force)

    @cached_property
    def depth_curve(self) -> Monotone:
        """ln depth over ln force, at depths > 0 whose force is larger than all before."""
        rising = np.flatnonzero(np.diff(np.maximum.accumulate(self.force), prepend=0.0) > 0)
        x, y = np.log(self.force[rising]), np.log(np.maximum(self.depth[rising], 1e-9))
        if len(rising) < 2:  # too few to tell: force as depth to the power of 1.5, through what there is
            x0, y0 = (x[0], y[0]) if len(rising) else (0.0, 0.0)
            x, y = np.array([x0, x0 + 1.5]), np.array([y0, y0 + 1.0])
        return Monotone.through(x, y)


@dataclass(frozen=True, eq=False)
class Protocol:
    """The levels as they were taken: force N, depth mm (n_levels,), and how long each was held (s)."""

    force: Array
    depth: Array
    hold: Array
    ramp: float = 1.0

    def __len__(self) -> int:
        return len(self.depth)

    @property
    def unloading(self) -> list[bool]:
        """Levels (n_levels,) that are read on the way back."""
        deepest = int(np.argmax(self.depth)) if len(self) else 0
        return [k > deepest for k in range(len(self))]


@dataclass(frozen=True, eq=False)
class Readout:
    """What would be shown at the levels: force, travel (n,), log_speed (n, n_windows); thickness at
    the first; layers (n, n_lines) mm, from the skin to the first line and from line to line."""

    force: Array
    log_speed: Array
    travel: Array
    thickness: float
    layers: Array = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True)
class Reading:
    """How the truth is read. The defaults are a faithful reading.

    force_zero N, force_gain : shown = gain * true + zero
    depth_zero mm, depth_gain : true = gain * (shown + zero)
    preload N : force already on the probe when force and depth were set to zero
    compliance mm/N : of limb and bone support, seen in the probe's travel only
    log_speed_shift : of every speed; speed_slope 1/mm : relative loss per depth beyond the window's middle
    guided : 1e4 Hz^2 / f^2 of the shear waves, guided by probe and bone
    prony : (share, time constant s) of relaxing stress beside the lasting one
    after : further changes of the readout, by effects of a user's own
    """

    force_zero: float = 0.0
    force_gain: float = 1.0
    depth_zero: float = 0.0
    depth_gain: float = 1.0
    preload: float = 0.0
    compliance: float = 0.0
    log_speed_shift: float = 0.0
    speed_slope: float = 0.0
    guided: float = 0.0
    prony: tuple[tuple[float, float], ...] = ()
    after: tuple[Callable[[Readout, Curves, Protocol], Readout], ...] = field(default=())


def read(
    curves: Curves, protocol: Protocol, reading: Reading = Reading(), *, with_speeds: bool = True
) -> Readout:
    """What would be written down at the levels' depths; speeds NaN where they are not asked for.

    >>> c = Curves(np.linspace(0, 10, 6), np.linspace(0, 20, 6), np.zeros((6, 0)), np.zeros(0))
    >>> p = Protocol(np.array([0.0, 8.0]), np.array([0.0, 4.0]), np.zeros(2))
    >>> read(c, p, Reading(force_zero=1.0)).force
    array([1., 9.])
    """
    depth = true_depth(curves, protocol.depth, reading)
    elastic = force_at(curves, depth)
    force = relaxed(elastic, protocol, reading)
    if reading.preload:
        force = force - reading.preload
    if with_speeds:
        speed = _speeds(curves, depth, reading)
    else:
        speed = np.full((len(depth), curves.log_speed.shape[1]), np.nan)
    shown = Readout(
        force=reading.force_gain * force + reading.force_zero,
        log_speed=speed,
        travel=protocol.depth + reading.compliance * protocol.force,
        thickness=curves.thickness - (max(float(depth[0]), 0.0) if len(depth) else 0.0),
        layers=_layers_at(curves, depth),
    )
    for change in reading.after:
        shown = change(shown, curves, protocol)
    return shown


def relaxed(elastic: Array, protocol: Protocol, reading: Reading) -> Array:
    """N borne at the end of each hold (n_levels,), by what the tissue bears when all has relaxed."""
    return elastic if not reading.prony else _relaxed(elastic, protocol, reading.prony)


def true_depth(curves: Curves, shown: Array, reading: Reading) -> Array:
    """Depth of the probe since first touch (mm) where the record shows `shown`."""
    depth = reading.depth_gain * (shown + reading.depth_zero)
    if reading.preload:
        depth = depth + depth_of_force(curves, reading.preload)
    return depth


def force_at(curves: Curves, depth: Array) -> Array:
    """N at any depth: 0 before touch, PCHIP within the simulation, its last slope beyond."""
    curve = curves.force_curve
    end = curves.depth[-1]
    inside = curve(np.clip(depth, 0.0, end))
    return np.asarray(inside + np.maximum(depth - end, 0.0) * curve.slope(end))


def log_force_at(curves: Curves, depth: Array) -> Array:
    """ln N at depths > 0: a curve through ln force over ln depth, a power of depth below and beyond."""
    x, y = np.log(curves.depth[1:]), np.log(np.maximum(curves.force[1:], 1e-9))
    at = np.log(np.maximum(depth, 1e-6))
    if len(x) < 2:
        return np.asarray(y[0] + 1.5 * (at - x[0]))
    curve = Monotone.through(x, y)
    first, last = (y[1] - y[0]) / (x[1] - x[0]), (y[-1] - y[-2]) / (x[-1] - x[-2])
    inside = curve(np.clip(at, x[0], x[-1]))
    return np.asarray(inside + first * np.minimum(at - x[0], 0.0) + last * np.maximum(at - x[-1], 0.0))


def depth_at(curves: Curves, force: Array) -> Array:
    """mm at forces > 0: a curve through ln depth over ln force, a power of force below and beyond."""
    curve, at = curves.depth_curve, np.log(np.maximum(force, 1e-9))
    x, y = curve.knots, curve.values
    first, last = (y[1] - y[0]) / (x[1] - x[0]), (y[-1] - y[-2]) / (x[-1] - x[-2])
    inside = curve(np.clip(at, x[0], x[-1]))
    beyond = first * np.minimum(at - x[0], 0.0) + last * np.maximum(at - x[-1], 0.0)
    return np.exp(inside + np.clip(beyond, -_FAR, _FAR))


def continued(curves: Curves, depths: Sequence[float], *, like: Curves | None = None) -> Curves:
    """The curves on to further depths: the force as the last power of depth, ln speeds as the last line.

    like : curves that reach further; then their course, and the difference to it as its last line
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
    return replace(
        curves,
        depth=np.concatenate([curves.depth, further]),
        force=np.concatenate([curves.force, np.exp(log_force)]),
        **curves.with_columns(np.vstack([curves.columns, table])),  # type: ignore[arg-type]
    )


def _logs_at(curves: Curves, depth: Array) -> Array:
    """ln force, ln speeds and ln lines (n, 1 + n_parts + n_lines) at depths > 0."""
    speeds = [np.interp(depth, curves.depth, column) for column in curves.columns.T]
    return np.column_stack([log_force_at(curves, depth), *speeds])


def depth_of_force(curves: Curves, force: float) -> float:
    """mm at which the simulated curve reaches a force.

    >>> c = Curves(np.linspace(0, 10, 6), np.linspace(0, 20, 6), np.zeros((6, 0)), np.zeros(0))
    >>> round(depth_of_force(c, 4.0), 6)
    2.0
    """
    curve, end = curves.force_curve, float(curves.depth[-1])
    if force >= curves.force[-1]:
        return min(end + (force - float(curves.force[-1])) / max(float(curve.slope(end)), 1e-9), 2.0 * end)
    k = int(np.argmax(curves.force > force)) if force > 0 else 1
    low, high = float(curves.depth[k - 1]), float(curves.depth[k])
    if force <= 0:
        return low
    for _ in range(40):
        middle = 0.5 * (low + high)
        if float(curve(middle)) < force:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def _speeds(curves: Curves, depth: Array, reading: Reading) -> Array:
    if not curves.log_speed.shape[1]:
        return np.zeros((len(depth), 0))
    speed = _at_depths(curves, depth) + reading.log_speed_shift
    if reading.prony:
        speed = speed + 0.5 * np.log1p(sum(share for share, _ in reading.prony))
    if reading.guided:
        speed = speed + _guided(speed, curves.thickness - depth, reading.guided)
    if reading.speed_slope:
        beyond_middle = curves.window_depth - curves.window_depth.mean()
        speed = speed + np.log(np.maximum(1.0 - reading.speed_slope * beyond_middle, 0.05))
    return np.asarray(speed)


def _layers_at(curves: Curves, depth: Array) -> Array:
    """mm (n_levels, n_lines) at depths."""
    if curves.log_line is None:
        return np.zeros((len(depth), 0))
    return np.diff(np.exp(_one_curve(curves.depth, curves.log_line, depth)), axis=1, prepend=0.0)


def _at_depths(curves: Curves, depth: Array) -> Array:
    """ln speed (n_levels, n_windows) at depths; windows that are known at the same depths all at once."""
    out = np.full((len(depth), curves.log_speed.shape[1]), np.nan)
    known = np.isfinite(curves.log_speed)
    if known.all():
        return _one_curve(curves.depth, curves.log_speed, depth)
    for columns in _equal_columns(known.tobytes(), known.shape[1]):
        at = known[:, columns[0]]
        if at.sum() > 1:
            out[:, columns] = _one_curve(curves.depth[at], curves.log_speed[at][:, columns], depth)
    return out


@lru_cache(maxsize=64)
def _equal_columns(truths: bytes, n_columns: int) -> list[IntArray]:
    """Numbers of the columns of a table of truths that are the same, together.

    >>> table = np.array([[True, False, True], [True, True, True]])
    >>> [each.tolist() for each in _equal_columns(table.tobytes(), 3)]
    [[1], [0, 2]]
    """
    table = np.frombuffer(truths, dtype=np.bool_).reshape(-1, n_columns)
    _, which = np.unique(np.packbits(table, axis=0), axis=1, return_inverse=True)
    order = np.argsort(which, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(which[order])) + 1)


def _one_curve(knots: Array, values: Array, depth: Array) -> Array:
    """PCHIP within the knots, level before them, the last slope beyond."""
    curve = Monotone.through(knots, values)
    inside = np.clip(depth, knots[0], knots[-1])
    beyond = np.maximum(depth - knots[-1], 0.0)
    return np.asarray(curve(inside) + np.multiply.outer(beyond, curve.slope(knots[-1])))


def _guided(log_speed: Array, height: Array, per_f2: float) -> Array:
    """ln of 1/sqrt(1 - (lambda/2h)^2), lambda = v/f: (v/2h)^2/f^2 with v in mm/s."""
    v_mm_per_s = 1e3 * np.exp(log_speed)
    ratio = (v_mm_per_s / (2.0 * height[:, None])) ** 2 * per_f2 * 1e-4
    return -0.5 * np.log1p(-np.minimum(ratio, 0.9))


def _relaxed(elastic: Array, protocol: Protocol, prony: tuple[tuple[float, float], ...]) -> Array:
    """Force at the end of each hold: the lasting one and what has not relaxed yet.

    Each step is a ramp of `ramp` seconds, linear in the elastic force, then its hold.
    F(t) = F_e + sum_i g_i int exp(-(t - s)/tau_i) dF_e/ds ds (g0 = 1).
    """
    held = np.where(np.isfinite(protocol.hold), protocol.hold, 0.0)
    total = elastic.copy()
    for share, tau in prony:
        ramp_kept = tau / protocol.ramp * -np.expm1(-protocol.ramp / tau)
        state, before = 0.0, 0.0
        for k, now in enumerate(elastic):
            state = state * np.exp(-protocol.ramp / tau) + (now - before) * ramp_kept
            state *= np.exp(-held[k] / tau)
            before = float(now)
            total[k] += share * state
    return total
