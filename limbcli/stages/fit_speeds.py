"""Mean shear-wave speed under the probe at every simulated level."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from limbcli.measurement.acoustoelasticity import OgdenTerms, wave_speed_m_per_s
from limbcli.measurement.swe_prediction import Window, predict_map
from limbcli.model import Array, IntArray, LimbModel, Material
from limbcli.solvers.base import Simulation

_GRADIENT = ("Fxx", "Fxy", "Fxz", "Fyx", "Fyy", "Fyz", "Fzx", "Fzy", "Fzz")
MEAN_WINDOW = Window(pixel=2.0)


def speed_terms(material: Material) -> OgdenTerms:
    """The terms that the small-on-large formula needs; neo-Hooke is Ogden's with m = 2."""
    if material.law == "neo_hooke":
        mu = float(material.parameters["mu"])  # type: ignore[arg-type]
        return OgdenTerms(np.array([2 * mu]), np.array([2.0]))
    return OgdenTerms.of(material)


def mean_speeds(
    model: LimbModel,
    simulation: Simulation,
    material: Material,
    rows: Array,
    *,
    density_kg_per_m3: float,
    window: Window = MEAN_WINDOW,
) -> Array:
    """Mean over the scanner's window of the predicted speed, m/s (n_levels,).

    rows : int (n_levels,) of the simulation's times. The model's element record must hold the
    deformation gradient, its node record the displacements.
    """
    elements = next(iter(simulation.elements.values()))
    nodes = next(iter(simulation.nodes.values()))
    corners = np.concatenate([_corners(block.cells) for block in model.mesh.blocks])[elements.items]
    place = np.full(len(model.mesh.points), -1)
    place[nodes.items] = np.arange(len(nodes.items))
    moved = np.stack([nodes.column(name) for name in ("ux", "uy", "uz")], axis=-1)
    gradient = np.stack([elements.column(name) for name in _GRADIENT], axis=-1)
    rest = model.mesh.points[corners].mean(axis=1)
    depths, terms, speeds = simulation.probe_depth(), speed_terms(material), []
    for row in rows:
        positions = rest + moved[row][place[corners]].mean(axis=1)
        F = gradient[row].reshape(-1, 3, 3)
        near = _near(positions, float(depths[row]), window)
        speed = wave_speed_m_per_s(F[near], terms, density_kg_per_m3=density_kg_per_m3)
        found = predict_map(positions[near], speed, face_height=-float(depths[row]), window=window)
        speeds.append(float(found.speed_m_per_s.mean()))
    return np.array(speeds)


def _corners(cells: IntArray) -> IntArray:
    return cells[:, np.minimum(np.arange(4), cells.shape[1] - 1)]


def _near(positions: Array, depth: float, window: Window) -> NDArray[np.bool_]:
    reach = 2 * window.smoothing + 6.0
    near = np.abs(positions[:, 0]) <= window.half_width + reach
    near &= np.abs(positions[:, 1]) <= window.elevation + reach
    return near & (positions[:, 2] >= -depth - window.depth_to - reach)
