"""True values at each level of a protocol, from a simulated indentation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from limbcli.errors import SolveError
from limbcli.measurement.elastography import SweMap
from limbcli.model import Array
from limbcli.phantom.protocol import LoadingProtocol, TrueLevels, depth_at_force
from limbcli.shear_waves.pixels import Window, predict_map

# (deformation gradients of some elements, their indices among the recorded ones) -> m/s
Speed = Callable[[Array, NDArray[np.bool_]], Array]


@dataclass(frozen=True, eq=False)
class Indentation:
    """A simulated indentation: states from first touch on (n_states of them).

    depth, force : (n_states,) mm and N
    positions : (n_states, n_points, 3) of the tissue in the site's frame (mm)
    deformation_gradient : (n_states, n_points, 3, 3)
    borders : (n_states, 2) lower borders of skin and fat below the skin (mm), if recorded
    """

    depth: Array
    force: Array
    positions: Array
    deformation_gradient: Array
    borders: Array | None = None

    def at(self, depth: float) -> tuple[Array, Array]:
        """Positions and deformation gradients at a depth, interpolated linearly between the two nearest
        states."""
        after = int(np.clip(np.searchsorted(self.depth, depth), 1, len(self.depth) - 1))
        low, high = self.depth[after - 1], self.depth[after]
        share = (depth - low) / (high - low)

        def between(values: Array) -> Array:
            return np.asarray((1 - share) * values[after - 1] + share * values[after])

        return between(self.positions), between(self.deformation_gradient)


def true_levels(
    simulated: Indentation, speed: Speed, *, protocol: LoadingProtocol, skin_bone: float | None,
    window: Window = Window(),
) -> TrueLevels:  # fmt: skip
    """Depth and speed map at each force step that the simulation reaches.

    Raises SolveError if it reaches fewer than three steps.
    """
    forces = protocol.forces(reached=float(simulated.force[-1]))
    if len(forces) < 3:
        raise SolveError(
            f"the simulation reaches {simulated.force[-1]:.2f} N at {simulated.depth[-1]:.1f} mm: "
            f"{len(forces)} levels of {protocol.step:g} N",
            where="simulated measurement",
            fix="choose stiffer tissue, a larger strain (--max-strain) or smaller steps (--step-n)",
            reached_n=float(simulated.force[-1]),
        )
    depths = depth_at_force(simulated.depth, simulated.force, forces)
    maps = tuple(_map(*simulated.at(depth), speed, face_height=-depth, window=window) for depth in depths)
    borders = None
    if simulated.borders is not None:
        borders = np.asarray(PchipInterpolator(simulated.depth, simulated.borders)(depths))
    return TrueLevels(force=forces, depth=depths, maps=maps, skin_bone=skin_bone, borders=borders)


def _map(positions: Array, F: Array, speed: Speed, *, face_height: float, window: Window) -> SweMap:
    """Speed map from the elements near the window only."""
    reach = window.half_width + 2 * window.smoothing
    near = (np.abs(positions[:, 0]) <= reach) & (
        np.abs(positions[:, 1]) <= window.elevation + 2 * window.smoothing
    )
    near &= positions[:, 2] >= face_height - window.depth_to - 2 * window.smoothing
    return predict_map(positions[near], speed(F[near], near), face_height=face_height, window=window)
