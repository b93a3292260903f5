"""Layer readings of a site for comparison with a simulation: thicknesses, positions and noise.

A thickness is determined by the two borders of its layer, material lines that were marked at first touch. The
border at the bone carries no information beyond the depth, so the layer on the bone is shown but does not
enter the likelihood. The reading at first touch has the same noise as the others, and it determines where
the material lines start and hence their later positions: readings of one layer therefore have the covariance
s^2 (1 + g g'), where g is the thickness divided by that at first touch.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from limbcli.case import Site
from limbcli.measurement.levels import Levels
from limbcli.model import Array, LimbModel
from limbcli.solvers.material_lines import MaterialLines, material_lines

_LEAST_DEVIATION = 0.02  # mm, lower limit of a thickness reading's standard deviation: the image resolution


@dataclass(frozen=True, eq=False)
class LayerReadings:
    """names : of the layers from the skin inward; thickness (n_levels, n_layers) : mm, NaN where not read;
    deviation : standard deviation of a thickness, mm; on_bone : whether the last layer lies on the bone."""

    names: tuple[str, ...]
    thickness: Array
    deviation: float
    on_bone: bool

    @property
    def n_counted(self) -> int:
        """Number of layers that enter the likelihood: all but the one on the bone."""
        return len(self.names) - self.on_bone

    @cached_property
    def rest(self) -> Array:
        """Depths (n_layers,) of the layers' lower borders below the skin at first touch, mm."""
        return np.cumsum(self.thickness[0])

    def lines(self, model: LimbModel) -> MaterialLines:
        """The borders as material lines of a model; the one at the bone is attached to the bone.

        Raises MeasurementError if a border does not lie in the model's tissue.
        """
        places = self.rest.copy()
        if self.on_bone:
            places[-1] = np.nan
        return material_lines(model, places)

    def predicted(self, lines: MaterialLines, u_z: Array) -> Array:
        """Thickness (..., n_layers) of all layers, mm, from the z displacements of the borders' nodes."""
        borders = lines.below_skin(u_z)
        if self.on_bone:
            borders[..., -1] += self.rest[-1] - lines.rest[-1]
        return np.diff(borders, axis=-1, prepend=0.0)

    def used(self, levels: Levels) -> NDArray[np.bool_]:
        """Mask (n_levels, n_counted) of the readings under load that enter the likelihood."""
        known = np.isfinite(self.thickness[:, : self.n_counted])
        under_load = levels.loading & (np.arange(len(levels)) > 0)
        return np.asarray(known & under_load[:, None])

    def growth(self, thickness: Array, layer: int) -> Array:
        """Sensitivity to the reading at first touch: thickness (n,) divided by that at first touch."""
        return np.asarray(thickness / self.thickness[0, layer])

    def covariance(self, thickness: Array, layer: int) -> Array:
        """Covariance (n, n), mm^2, of the readings of one layer at these thicknesses (n,)."""
        g = self.growth(thickness, layer)
        return self.deviation**2 * (np.eye(len(g)) + np.outer(g, g))


def layer_readings(levels: Levels, site: Site) -> LayerReadings | None:
    """The site's layer readings; None if there are none, or not all layers were read at first touch."""
    names = tuple(name for name, each in levels.layers.items() if np.isfinite(each[0]))
    if not names or len(names) < len(levels.layers) or not levels.begins_at_zero:
        return None
    thickness = np.column_stack([levels.layers[name] for name in names])
    return LayerReadings(names, thickness, max(site.noise.layer, _LEAST_DEVIATION), names[-1] == "muscle")
