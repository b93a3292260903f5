"""Depth, wave speeds and layers of a site at given force from its simulated curves, with derivatives.

Force is controlled and depth is the noisy reading, so the residual is a depth. A layer's border is a material
line whose depth below the skin is simulated at the knots; a thickness lies between two borders.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from limbcli.inference.monotone_interpolation import pchip_inverse, pchip_sample
from limbcli.inference.prediction import Prediction
from limbcli.model import Array, IntArray
from limbcli.numbers.whitening import Whitener


@dataclass(frozen=True, eq=False)
class LayerData:
    """Thickness readings.

    force : (n,) N
    layer : (n,) index of the layer, from 0 at the skin
    thickness, covariance : (n,) mm and (n, n) mm^2
    rest : (n_borders,) depths of the layers' lower borders below the skin before loading (mm)
    """

    force: Array
    layer: IntArray
    thickness: Array
    covariance: Array
    rest: Array

    def __len__(self) -> int:
        return len(self.force)

    @cached_property
    def _whiten(self) -> Whitener:
        return Whitener.of(self.covariance)

    def whitened(self, values: Array) -> Array:
        """Values (n, ...) mm, whitened by the Cholesky factor of the covariance."""
        return self._whiten(values) if len(self) else values

    def without(self, gone: NDArray[np.bool_]) -> LayerData:
        """The data without some readings: (n,) bool."""
        keep = ~gone
        return LayerData(
            self.force[keep], self.layer[keep], self.thickness[keep],
            self.covariance[np.ix_(keep, keep)], self.rest,
        )  # fmt: skip

    def predicted(
        self, knots: Array, borders: Array, borders_by: Array, at: Array, at_by: Array
    ) -> tuple[Array, Array]:
        """Thickness (n,) mm and its derivatives (n, 2 + n_shape) by ln c, ln gain, ln shape.

        borders : mm below the skin, of all borders at the second of the knots (mm, from 0), at the third,
            ...; at : (n,) simulated depths of the readings' forces (mm); each with its derivatives
        """
        n, n_shape = len(self.rest), borders_by.shape[1]
        if not len(self):
            return np.zeros(0), np.zeros((0, 2 + n_shape))
        depths = np.vstack([self.rest, borders.reshape(-1, n)])
        depths_by = np.concatenate([np.zeros((1, n, n_shape)), borders_by.reshape(-1, n, n_shape)])
        values, slopes = np.zeros((2, len(self), n + 1))
        by_shape = np.zeros((len(self), n + 1, n_shape))
        inside = np.clip(at, 0.0, knots[-1])
        for j in range(n):
            sample = pchip_sample(knots, depths[:, j], inside)
            values[:, j + 1] = sample.values
            slopes[:, j + 1] = np.where((at > 0.0) & (at < knots[-1]), sample.slopes, 0.0)
            by_shape[:, j + 1] = sample.weights @ depths_by[:, j]
        rows = np.arange(len(self))

        def layer(table: Array) -> Array:
            return np.asarray(table[rows, self.layer + 1] - table[rows, self.layer])

        found = layer(slopes)[:, None] * at_by
        found[:, 2:] += layer(by_shape)
        return layer(values), found


NO_LAYERS = LayerData(np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 0)), np.zeros(0))


@dataclass(frozen=True, eq=False)
class SiteMeasurement:
    """Measurement of one site or state, and the depths of its simulated levels, `knots` (n_knots,) mm,
    increasing.

    force, depth : (n,) levels past first touch, with one standard deviation each
    speed_force, log_speed, speed_deviation : (n_speeds,) force (N), ln speed and its deviation, first touch
        included
    gain_deviation : relative standard deviation of the simulated force (mesh, element)
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
    layers: LayerData = NO_LAYERS

    def weights_at(self, stiffness: Array) -> Array:
        """sqrt(sigma_d^2 + (sigma_F / (dF/dd))^2) (n,): deviation of depth at given force, mm; stiffness :
        N/mm"""
        return np.sqrt(self.depth_deviation**2 + (self.force_deviation / stiffness) ** 2)

    def without(self, levels: NDArray[np.bool_]) -> SiteMeasurement:
        """The measurement without some force levels ((n,) bool) and the speeds and layers at their forces."""
        speeds = ~np.isin(self.speed_force, self.force[levels])
        return replace(
            self, force=self.force[~levels], depth=self.depth[~levels],
            speed_force=self.speed_force[speeds], log_speed=self.log_speed[speeds],
            speed_deviation=self.speed_deviation[speeds],
            layers=self.layers.without(np.isin(self.layers.force, self.force[levels])),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class SitePrediction:
    """Predicted depth (n,) mm at the measured forces, log_speed (n_speeds,) and layers (n_layers,) mm, each
    with its derivative by (ln c, ln gain, ln shape)."""

    depth: Array
    depth_slope: Array
    stiffness: Array
    log_speed: Array
    log_speed_slope: Array
    layers: Array
    layers_slope: Array


RestSpeed = float | Callable[[Array], tuple[float, Array]]
"""ln of the speed in unloaded tissue, or a function: shape -> that value and its derivatives by ln shape."""


def predict_site(
    answer: Prediction, data: SiteMeasurement, shape: Array, *, c_ratio: float, gain: float,
    log_speed_0: RestSpeed,
) -> SitePrediction:  # fmt: skip
    """Prediction of a site's measurement from its curve simulated with this shape.

    answer : forces at the knots (N); then speeds there (m/s), unless the data have none; then, where the data
        have layers, the depths below the skin (mm) of all borders at the first knot, ...; for c_ratio 1 and
        gain 1
    log_speed_0 : ln of the speed in unloaded tissue at c_ratio 1, sqrt(c / (2 rho)) but for laws with fibres

    `stiffness` (n,) of the result is dF/dd at the forces (N/mm).
    """
    n = len(data.knots)
    by_log = answer.slopes * shape
    knots = np.concatenate([[0.0], data.knots])
    force = np.concatenate([[0.0], answer.values[:n]]) * c_ratio * gain
    force_by = np.vstack([np.zeros(len(shape)), by_log[:n]]) * c_ratio * gain
    wanted, m = np.concatenate([data.force, data.speed_force, data.layers.force]), len(data.force)
    reached = invert(knots, force, wanted)
    stiffness, reached_by = _implicit(knots, force, force_by, reached, wanted)
    of_speeds, of_layers = slice(m, m + len(data.speed_force)), slice(m + len(data.speed_force), None)
    last = len(answer.values) - n * len(data.layers.rest)  # speeds may be missing before them
    layers = data.layers.predicted(
        knots, answer.values[last:], by_log[last:], reached[of_layers], reached_by[of_layers]
    )
    at, at_by = reached[of_speeds], reached_by[of_speeds]
    depth = reached[:m], reached_by[:m], stiffness[:m]
    if not len(data.speed_force):
        return SitePrediction(*depth, np.zeros(0), np.zeros((0, 2 + len(shape))), *layers)
    rest, rest_by = _value_and_slopes(log_speed_0, shape)
    of_curve = slice(n, 2 * n)
    speed = np.concatenate([[rest], np.log(answer.values[of_curve])])
    speed_by = np.vstack([rest_by, by_log[of_curve] / answer.values[of_curve, None]])
    sample = pchip_sample(knots, speed, np.clip(at, 0.0, knots[-1]))
    slope = np.where((at > 0.0) & (at < knots[-1]), sample.slopes, 0.0)
    log_speed = sample.values + 0.5 * np.log(c_ratio)
    log_speed_by = slope[:, None] * at_by
    log_speed_by[:, 2:] += sample.weights @ speed_by
    log_speed_by[:, 0] += 0.5
    return SitePrediction(*depth, log_speed, log_speed_by, *layers)


def _value_and_slopes(log_speed_0: RestSpeed, shape: Array) -> tuple[float, Array]:
    return log_speed_0(shape) if callable(log_speed_0) else (log_speed_0, np.zeros(len(shape)))


def rest_speed_by_c(log_speed_0: RestSpeed) -> Callable[[Array], tuple[float, Array]]:
    """ln of the speed in unloaded tissue, which grows with the root of c, by (c / c0, shape...)."""

    def at(place: Array) -> tuple[float, Array]:
        known, slopes = _value_and_slopes(log_speed_0, place[1:])
        return known + 0.5 * float(np.log(place[0])), np.concatenate([[0.5], slopes])

    return at


def invert(knots: Array, force: Array, wanted: Array) -> Array:
    """Depths at which the PCHIP curve through (knots, force) reaches `wanted`; extrapolated linearly beyond
    its end.

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
    end_by = (force_by[-1] - force_by[-2]) / (knots[-1] - knots[-2])
    by_shape = sample.weights @ force_by + np.outer(np.maximum(depth - knots[-1], 0.0), end_by)
    rise = np.column_stack([wanted, wanted, by_shape])
    moved = -rise / slope[:, None]
    moved[wanted <= 0.0] = 0.0
    return slope, moved
