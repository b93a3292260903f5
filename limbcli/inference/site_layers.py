"""Layer thicknesses of a site at given force from its simulated layer borders, with derivatives.

A border is a material line; its depth below the skin is simulated at the knots and interpolated at the
simulated depth of each reading's force. A thickness is the difference between the two borders of a layer.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from limbcli.inference.monotone_interpolation import pchip_sample
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

        knots : (n_knots,) mm from 0
        borders, borders_by : mm below the skin, of all borders at the second knot, at the third, ..., and
            derivatives by ln shape ((n_knots - 1) n_borders, n_shape)
        at, at_by : (n,) simulated depths of the readings' forces (mm), and derivatives (n, 2 + n_shape)
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
