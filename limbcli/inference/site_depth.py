"""A site's depth and wave speed at given force, by its simulated curves, with their derivatives.

Force is controlled and depth is the noisy reading, so the residual is a depth: measured
minus the depth at which the simulation reaches the measured force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limbcli.inference.interpolation import pchip_inverse, pchip_sample
from limbcli.inference.prediction import Curve
from limbcli.model import Array


@dataclass(frozen=True, eq=False)
class SiteData:
    """One site's measurement beside its simulation's levels.

    knots (n_knots,) mm: depths of the simulated levels, increasing
    force, depth (n,): levels past first touch; speed_force (n_speeds,) N with ln speed
    (n_speeds,) and its deviation, first touch included; all deviations one standard deviation
    gain_deviation : of the simulated force, relative (mesh, element)
    """

    name: str
    knots: Array
    force: Array
    depth: Array
    force_deviation: float
    depth_deviation: float
    speed_force: Array
    log_speed: Array
    speed_deviation: Array
    gain_deviation: float = 0.0

    def without(self, levels: NDArray[np.bool_]) -> SiteData:
        """Some force levels left out: (n,) bool of those to leave out; their speeds go too."""
        gone = np.isin(self.speed_force, self.force[levels])
        keep, speeds = ~levels, ~gone
        return SiteData(
            self.name, self.knots, self.force[keep], self.depth[keep], self.force_deviation,
            self.depth_deviation, self.speed_force[speeds], self.log_speed[speeds],
            self.speed_deviation[speeds], self.gain_deviation,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class SitePrediction:
    """depth (n,) mm at the measured forces, log_speed (n_speeds,), with d / d (ln c, ln gain, ln shape)."""

    depth: Array
    depth_slope: Array
    stiffness: Array
    log_speed: Array
    log_speed_slope: Array


def predict_site(
    curve: Curve, data: SiteData, shape: Array, *, c_ratio: float, gain: float, log_speed_0: float
) -> SitePrediction:
    """What a site's simulation says of its measurement.

    curve : shape -> (forces at the knots (N), speeds at the knots (m/s)), (2 n_knots,), for
        c_ratio 1 and gain 1; forces alone where the data hold no speed
    log_speed_0 : ln of the speed in unloaded tissue at c_ratio 1: sqrt(c / (2 rho))
    stiffness (n,) : dF/dd at the forces, N/mm
    """
    n, answer = len(data.knots), curve(shape, tuple(range(len(shape))))
    assert answer.jacobian is not None
    by_log = answer.jacobian * shape
    knots = np.r_[0.0, data.knots]
    force = np.r_[0.0, answer.values[:n]] * c_ratio * gain
    force_by = np.vstack([np.zeros(len(shape)), by_log[:n]]) * c_ratio * gain
    wanted, m = np.r_[data.force, data.speed_force], len(data.force)
    reached = invert(knots, force, wanted)
    stiffness, reached_by = _implicit(knots, force, force_by, reached, wanted)
    depth, at, at_by = reached[:m], reached[m:], reached_by[m:]
    if not len(data.speed_force):
        none = np.zeros((0, 2 + len(shape)))
        return SitePrediction(depth, reached_by[:m], stiffness[:m], np.zeros(0), none)
    speed = np.r_[log_speed_0, np.log(answer.values[n:])]
    speed_by = np.vstack([np.zeros(len(shape)), by_log[n:] / answer.values[n:, None]])
    sample = pchip_sample(knots, speed, np.clip(at, 0.0, knots[-1]))
    slope = np.where((at > 0.0) & (at < knots[-1]), sample.slopes, 0.0)
    log_speed = sample.values + 0.5 * np.log(c_ratio)
    log_speed_by = slope[:, None] * at_by
    log_speed_by[:, 2:] += sample.weights @ speed_by
    log_speed_by[:, 0] += 0.5
    return SitePrediction(depth, reached_by[:m], stiffness[:m], log_speed, log_speed_by)


def invert(knots: Array, force: Array, wanted: Array) -> Array:
    """Depths at which the PCHIP curve through (knots, force) reaches `wanted`; linear beyond its end.

    >>> invert(np.arange(4.0), 2 * np.arange(4.0), np.array([-1.0, 0.0, 3.0, 8.0]))
    array([0. , 0. , 1.5, 4. ])
    """
    depth = pchip_inverse(knots, force, wanted)
    end = (force[-1] - force[-2]) / (knots[-1] - knots[-2])
    beyond = wanted > force[-1]
    if beyond.any() and end > 0.0:
        depth = np.where(beyond, knots[-1] + (wanted - force[-1]) / end, depth)
    return np.where(wanted <= 0.0, 0.0, depth)


def _implicit(
    knots: Array, force: Array, force_by: Array, depth: Array, wanted: Array
) -> tuple[Array, Array]:
    """dF/dd (n,) at the depths, and d depth / d (ln c, ln gain, ln shape): -(dF/dtheta) / (dF/dd)."""
    inside = np.clip(depth, 0.0, knots[-1])
    sample = pchip_sample(knots, force, inside)
    end = (force[-1] - force[-2]) / (knots[-1] - knots[-2])
    slope = np.where(depth > knots[-1], end, sample.slopes)
    floor = 1e-3 * float(force.max()) / float(knots[-1])
    slope = np.maximum(slope, floor)
    by_shape = sample.weights @ force_by
    rise = np.column_stack([wanted, wanted, by_shape])
    moved = -rise / slope[:, None]
    moved[wanted <= 0.0] = 0.0
    return slope, moved
