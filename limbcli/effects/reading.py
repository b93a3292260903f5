"""From the state of the tissue to what is recorded: the measurement side of a model.

`Curves` is the simulation of a site; a `Reading` describes how instruments and operator distort it; `read`
gives what levels.csv should then contain. Measurement effects are pure changes of the `Reading`, as tissue
effects are of the `LimbModel`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from limbcli.effects.curves import Curves, depth_of_force, force_at
from limbcli.effects.drainage import Drainage
from limbcli.inference.monotone_interpolation import columns_through
from limbcli.model import Array


@dataclass(frozen=True, eq=False)
class Protocol:
    """The levels as measured: force (N) and depth (mm) (n_levels,), and how long each was held (s).

    unloading : whether each level was read during unloading; empty: none was
    """

    force: Array
    depth: Array
    hold: Array
    ramp: float = 1.0
    unloading: tuple[bool, ...] = ()

    def __len__(self) -> int:
        return len(self.depth)

    @property
    def deepest(self) -> Protocol:
        """Protocol of the deepest level alone, loaded directly and not held."""
        k = int(np.argmax(self.depth))
        return Protocol(self.force[k : k + 1], self.depth[k : k + 1], np.zeros(1), self.ramp)

    def remembered(self, values: Array, tau: float, rest: float) -> Array:
        """int exp(-(t - s)/tau) dv/ds ds at the end of each hold (n_levels,), of values v (n_levels,).

        Each step is a ramp of `ramp` seconds, linear in v and starting from `rest`, followed by its hold.
        """
        held = np.where(np.isfinite(self.hold), self.hold, 0.0)
        ramp_kept = tau / self.ramp * -np.expm1(-self.ramp / tau)
        found, state, before = np.empty(len(values)), 0.0, rest
        for k, now in enumerate(values.tolist()):
            state = state * np.exp(-self.ramp / tau) + (now - before) * ramp_kept
            state *= np.exp(-held[k] / tau)
            before = now
            found[k] = state
        return found


Memory = Callable[[Array, float, float], Array]
"""(values v, tau in s, v at rest) -> int exp(-(t - s)/tau) dv/ds ds where v is given."""


@dataclass(frozen=True, eq=False)
class Readout:
    """What would be recorded at the levels.

    force, travel : (n,) travel is counted since depth 0
    log_speed : (n, n_windows)
    thickness : at the first level
    layers : (n, n_lines) mm, from the skin to the first line and from line to line
    """

    force: Array
    log_speed: Array
    travel: Array
    thickness: float
    layers: Array = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True)
class Reading:
    """How the truth is read. The defaults are an undistorted reading.

    force_zero, force_gain : N and factor; shown = gain * true + zero
    depth_zero, depth_gain : mm and factor; true = gain * (shown + zero)
    touches_at_zero : the true depth is 0 where depth 0 is shown

    The depth gain applies to all distances along the beam, including the thickness; layers begin where they
    were shown.

    preload : N on the probe when force and depth were set to zero, after relaxation (of draining tissue,
        before it drained)
    compliance : mm/N of limb and bone support, visible only in the probe's travel
    log_speed_shift : added to ln of each speed
    speed_slope : 1/mm, relative decrease of speed per depth below the face beyond `reads_right_at` (mm)
    guided : 1e4 Hz^2 / f^2 of the shear waves guided by probe and bone
    prony : (share, time constant in s) of the relaxing stress, relative to the equilibrium stress
    c : MPa, of the tissue being read, needed for its drainage; 0: not given
    draining : (drainage of the site, permeability times c in mm^2/s)
    after : further changes of the readout by user-defined effects
    """

    force_zero: float = 0.0
    force_gain: float = 1.0
    depth_zero: float = 0.0
    depth_gain: float = 1.0
    touches_at_zero: bool = False
    preload: float = 0.0
    compliance: float = 0.0
    log_speed_shift: float = 0.0
    speed_slope: float = 0.0
    reads_right_at: float = 0.0
    guided: float = 0.0
    prony: tuple[tuple[float, float], ...] = ()
    c: float = 0.0
    draining: tuple[tuple[Drainage, float], ...] = ()
    after: tuple[Callable[[Readout, Curves, Protocol], Readout], ...] = field(default=())


def read(
    curves: Curves, protocol: Protocol, reading: Reading = Reading(), *, with_speeds: bool = True
) -> Readout:
    """What would be recorded at the depths of the levels; speeds are NaN without `with_speeds`.

    >>> c = Curves(np.linspace(0, 10, 6), np.linspace(0, 20, 6), np.zeros((6, 0)), np.zeros(0))
    >>> p = Protocol(np.array([0.0, 8.0]), np.array([0.0, 4.0]), np.zeros(2))
    >>> read(c, p, Reading(force_zero=1.0)).force
    array([1., 9.])
    """
    depth = true_depth(curves, protocol.depth, reading)
    force = relaxed(force_at(curves, depth), curves, depth, reading, protocol.remembered)
    force = force - borne_at_zero(curves, reading)
    if with_speeds:
        speed = _speeds(curves, depth, reading)
    else:
        speed = np.full((len(depth), curves.log_speed.shape[1]), np.nan)
    # Travel along the guide: the true indentation, whatever the depth errors, with what limb and bone move.
    since = true_depth(curves, np.zeros(1), reading)
    shown = Readout(
        force=reading.force_gain * force + reading.force_zero,
        log_speed=speed,
        travel=true_depth(curves, protocol.depth, reading) - since + reading.compliance * protocol.force,
        thickness=(curves.thickness - (max(float(depth[0]), 0.0) if len(depth) else 0.0))
        / reading.depth_gain,
        layers=_layers_at(curves, depth),
    )
    for change in reading.after:
        shown = change(shown, curves, protocol)
    return shown


def relaxed(elastic: Array, curves: Curves, depth: Array, reading: Reading, memory: Memory) -> Array:
    """Force (N) at the end of each hold, or at all times of a record (n,), with relaxation and drainage.

    elastic : (n,) of fully relaxed but undrained tissue: `force_at` of these curves and depths
    depth : (n,) of the probe since first touch (mm); memory : of what was loaded as these depths were

    Under a preload the tissue is assumed to be in equilibrium beforehand.
    """
    force = elastic
    for share, tau in reading.prony:  # F_e + sum_i g_i int exp(-(t - s)/tau_i) dF_e/ds ds (g0 = 1)
        force = force + share * memory(elastic, tau, reading.preload)
    if not reading.draining:
        return force
    pressed, rest = np.maximum(depth, 0.0), _depth_at_zero(curves, reading)
    for drainage, rate in reading.draining:
        kept = [memory(pressed, tau, rest) for tau in drainage.times(rate).tolist()]
        force = force * drainage.left(pressed, np.column_stack(kept), rate)
    return force


def borne_at_zero(curves: Curves, reading: Reading) -> float:
    """Force (N) on the probe when the force was set to zero: the part of a preload that remains at
    equilibrium."""
    force = reading.preload
    if not (force and reading.draining):
        return force
    rest = np.array([_depth_at_zero(curves, reading)])
    for drainage, rate in reading.draining:
        force *= float(drainage.left(rest, np.zeros((1, len(drainage.spread))), rate)[0])
    return force


def _depth_at_zero(curves: Curves, reading: Reading) -> float:
    """Depth since first touch (mm) at which a preload holds the probe."""
    return depth_of_force(curves, reading.preload) if reading.preload else 0.0


def true_depth(curves: Curves, shown: Array, reading: Reading) -> Array:
    """Depth of the probe since first touch (mm) where the record shows `shown`."""
    depth = reading.depth_gain * (shown + reading.depth_zero)
    if reading.touches_at_zero:
        depth = np.where(shown == 0.0, 0.0, depth)
    return depth + _depth_at_zero(curves, reading)


def _speeds(curves: Curves, depth: Array, reading: Reading) -> Array:
    if not curves.log_speed.shape[1]:
        return np.zeros((len(depth), 0))
    speed = columns_through(curves.depth, curves.log_speed, depth) + reading.log_speed_shift
    if reading.prony:
        speed = speed + 0.5 * np.log1p(sum(share for share, _ in reading.prony))
    if reading.guided:
        speed = speed + _guided(speed, curves.thickness - depth, reading.guided)
    if reading.speed_slope:
        beyond = curves.window_depth - reading.reads_right_at
        speed = speed + np.log(np.maximum(1.0 - reading.speed_slope * beyond, 0.05))
    return np.asarray(speed)


def _layers_at(curves: Curves, depth: Array) -> Array:
    """Layer thicknesses (n_levels, n_lines) at depths (mm)."""
    if curves.log_line is None:
        return np.zeros((len(depth), 0))
    return np.diff(np.exp(columns_through(curves.depth, curves.log_line, depth)), axis=1, prepend=0.0)


def _guided(log_speed: Array, height: Array, per_f2: float) -> Array:
    """ln of 1/sqrt(1 - (lambda/2h)^2), lambda = v/f: (v/2h)^2/f^2 with v in mm/s."""
    v_mm_per_s = 1e3 * np.exp(log_speed)
    ratio = (v_mm_per_s / (2.0 * height[:, None])) ** 2 * per_f2 * 1e-4
    return -0.5 * np.log1p(-np.minimum(ratio, 0.9))
