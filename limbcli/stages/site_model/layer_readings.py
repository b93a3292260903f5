"""The layers of a site as they are compared with a simulation: what was read, where it lies, its noise.

A thickness is determined by the two borders of its layer, material lines that were marked at first touch. The
border at the bone adds nothing beyond the depth, so the layer that lies on it is shown, but not counted.
The reading at first touch errs as the others do, and where it says that a line begins decides where it
is later: with that, readings of one layer have covariance s^2 (1 + g g'), g = thickness over that at
first touch.
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

_LEAST_DEVIATION = 0.02  # mm: no image shows more


@dataclass(frozen=True, eq=False)
class LayerReadings:
    """names : of the layers from the skin inward; thickness (n_levels, n_layers) mm, NaN where not read;
    deviation : mm, one of a thickness; on_bone : whether the last of them lies on the bone."""

    names: tuple[str, ...]
    thickness: Array
    deviation: float
    on_bone: bool

    @property
    def n_counted(self) -> int:
        """Layers that are counted: all but the one on the bone."""
        return len(self.names) - self.on_bone

    @cached_property
    def rest(self) -> Array:
        """mm (n_layers,) of the layers' lower borders below the skin at first touch."""
        return np.cumsum(self.thickness[0])

    def lines(self, model: LimbModel) -> MaterialLines:
        """The borders as material lines of a model; the one at the bone stays with it.

        Raises
        ------
        MeasurementError
            If they do not lie in the model's tissue.
        """
        places = self.rest.copy()
        if self.on_bone:
            places[-1] = np.nan
        return material_lines(model, places)

    def predicted(self, lines: MaterialLines, u_z: Array) -> Array:
        """mm (..., n_layers) of all layers, by the displacements of the nodes that carry the borders."""
        borders = lines.below_skin(u_z)
        if self.on_bone:
            borders[..., -1] += self.rest[-1] - lines.rest[-1]
        return np.diff(borders, axis=-1, prepend=0.0)

    def used(self, levels: Levels) -> NDArray[np.bool_]:
        """(n_levels, n_counted): readings under load that are counted."""
        known = np.isfinite(self.thickness[:, : self.n_counted])
        under_load = levels.loading & (np.arange(len(levels)) > 0)
        return np.asarray(known & under_load[:, None])

    def growth(self, thickness: Array, layer: int) -> Array:
        """How much a reading moves with that at first touch: thickness (n,) over the one there."""
        return np.asarray(thickness / self.thickness[0, layer])

    def covariance(self, thickness: Array, layer: int) -> Array:
        """mm^2 (n, n) of readings of one layer, of these thicknesses (n,)."""
        g = self.growth(thickness, layer)
        return self.deviation**2 * (np.eye(len(g)) + np.outer(g, g))


def layer_readings(levels: Levels, site: Site) -> LayerReadings | None:
    """The site's layers; None where none were read, or not at first touch."""
    names = tuple(name for name, each in levels.layers.items() if np.isfinite(each[0]))
    if not names or len(names) < len(levels.layers) or not levels.begins_at_zero:
        return None
    thickness = np.column_stack([levels.layers[name] for name in names])
    return LayerReadings(names, thickness, max(site.noise.layer, _LEAST_DEVIATION), names[-1] == "muscle")
