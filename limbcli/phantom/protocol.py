"""Measurement protocol: force steps, each held, and the true values at each level."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from limbcli.errors import SolveError
from limbcli.measurement.elastography import SweMap
from limbcli.model import Array


@dataclass(frozen=True)
class LoadingProtocol:
    """Force-controlled steps (N) up to a force or a strain, each held, and the sampling of the load cell.

    max_strain : largest depth as a fraction of the skin-bone distance under the probe
    first : force at the first level (N)
    """

    step: float = 2.0
    max_force: float = 12.0
    max_strain: float = 0.45
    hold: float = 6.0
    ramp: float = 1.0
    sampling_hz: float = 60.0
    first: float = 0.0

    def forces(self, *, reached: float) -> Array:
        """Forces of the levels from the first upwards, as far as the simulation reached.

        >>> LoadingProtocol(step=2.0, max_force=20.0).forces(reached=7.0)
        array([0., 2., 4., 6.])
        """
        top = min(self.max_force, reached) + 1e-9 - self.first
        return np.asarray(self.first + self.step * np.arange(int(top // self.step) + 1), dtype=float)


@dataclass(frozen=True, eq=False)
class TrueLevels:
    """True values at each level: force (N), depth (mm) and speed map.

    skin_bone : distance under the probe's centre before loading (mm), or None if the beam meets no bone
    borders : (n_levels, 2) lower borders of skin and fat below the skin (mm), or None if unknown
    """

    force: Array
    depth: Array
    maps: tuple[SweMap, ...]
    skin_bone: float | None
    borders: Array | None = None


def depth_at_force(depth: Array, force: Array, targets: Array) -> Array:
    """Depths at which a simulated curve reaches given forces.

    The curve is PCHIP through the simulated points and is inverted exactly (by bisection), so that evaluating
    the same curve at the result reproduces the force. The curve may begin with depths at which the probe does
    not yet touch the mesh (force 0).

    Raises SolveError if the force does not increase with depth, or never reaches a target.

    >>> depth_at_force(np.arange(5.0), np.arange(5.0) ** 2, np.array([0.0, 9.0])).round(9)
    array([0., 3.])
    """
    growth = np.where(force[1:] > 0, np.diff(force), 1.0)
    if np.any(growth <= 0):
        k = int(np.argmin(growth))
        raise SolveError(
            f"the simulated force does not increase between {depth[k]:.2f} and {depth[k + 1]:.2f} mm",
            where="simulated measurement",
            fix="choose another mesh or smaller depth",
            depth_mm=float(depth[k]),
        )
    if targets.max() > force[-1] * (1 + 1e-12):
        raise SolveError(
            f"the simulation reaches {force[-1]:.2f} N at {depth[-1]:.2f} mm, not {targets.max():g} N",
            where="simulated measurement",
            fix="request a smaller force or a larger depth",
        )
    curve = PchipInterpolator(depth, force)
    low = np.full(len(targets), depth[0])
    high = np.full(len(targets), depth[-1])
    for _ in range(60):
        middle = (low + high) / 2
        below = curve(middle) < targets
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    found = (low + high) / 2
    return np.asarray(np.where(targets <= force[0], depth[0], found))
