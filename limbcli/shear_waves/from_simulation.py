"""Shear-wave speed under the probe at simulated levels: maps as the scanner would show, and their means."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import MeasurementError
from limbcli.measurement.elastography import SweMap
from limbcli.model import Array, IntArray, LimbModel
from limbcli.shear_waves.pixels import Window, predict_map
from limbcli.shear_waves.speed import element_speeds
from limbcli.solvers.base import Simulation, Table

_GRADIENT = ("Fxx", "Fxy", "Fxz", "Fyx", "Fyy", "Fyz", "Fzx", "Fzy", "Fzz")
_MOVED = ("ux", "uy", "uz")
MEAN_WINDOW = Window(pixel=2.0)
AT_REST = -1


@dataclass(frozen=True, eq=False)
class ElementStates:
    """Where a simulation's recorded elements are and how they are deformed.

    items (n,) : their numbers over all blocks; rest (n, 3) mm : the mean of their corners, unloaded
    gradient (n_times, n, 3, 3)
    """

    items: IntArray
    rest: Array
    gradient: Array
    _corners: IntArray
    _moved: Array

    @staticmethod
    def of(model: LimbModel, simulation: Simulation) -> ElementStates:
        """
        Raises
        ------
        MeasurementError
            If the simulation recorded no deformation gradients, or no displacements.
        """
        elements = _with_fields(simulation.elements.values(), _GRADIENT)
        nodes = _with_fields(simulation.nodes.values(), _MOVED)
        corners = np.concatenate([_corners(block.cells) for block in model.mesh.blocks])[elements.items]
        place = np.full(len(model.mesh.points), -1)
        place[nodes.items] = np.arange(len(nodes.items))
        gradient = np.stack([elements.column(name) for name in _GRADIENT], axis=-1)
        return ElementStates(
            elements.items,
            model.mesh.points[corners].mean(axis=1),
            gradient.reshape(*gradient.shape[:2], 3, 3),
            place[corners],
            np.stack([nodes.column(name) for name in _MOVED], axis=-1),
        )

    def positions(self, row: int) -> Array:
        """Of the elements' middles (n, 3) mm at one of the simulation's times."""
        return np.asarray(self.rest + self._moved[row][self._corners].mean(axis=1))


def level_maps(
    model: LimbModel,
    simulation: Simulation,
    rows: Sequence[int] | IntArray,
    *,
    density_kg_per_m3: float,
    window: Window = MEAN_WINDOW,
    pixels: Sequence[tuple[Array, Array] | None] | None = None,
    face_depths: Array | None = None,
) -> list[SweMap]:
    """The map that the scanner would show at each row of the simulation's times (AT_REST: unloaded).

    pixels : for each level those of its measured map (lateral, depth mm), or None for the window's.
    face_depths : (n_times,) mm at which the window hangs, where that is not the probe's (it stands clear)
    The model's element record must hold the deformation gradient, its node record the displacements.

    Raises
    ------
    MeasurementError
        If the window holds no tissue at some level.
    """
    states = ElementStates.of(model, simulation)
    depths, maps = simulation.probe_depth() if face_depths is None else face_depths, []
    for k, row in enumerate(rows):
        loaded = row != AT_REST
        depth = float(depths[row]) if loaded else 0.0
        positions = states.positions(row) if loaded else states.rest
        F = states.gradient[row] if loaded else np.broadcast_to(np.eye(3), (len(states.rest), 3, 3))
        own = pixels[k] if pixels is not None else None
        near = _near(positions, depth, window, own)
        speed = element_speeds(model, F[near], states.items[near], density_kg_per_m3=density_kg_per_m3)
        maps.append(predict_map(positions[near], speed, face_height=-depth, window=window, pixels=own))
    return maps


def mean_speeds(
    model: LimbModel, simulation: Simulation, rows: IntArray, *, density_kg_per_m3: float,
    window: Window = MEAN_WINDOW, face_depths: Array | None = None,
) -> Array:  # fmt: skip
    """Mean over the scanner's window of the predicted speed, m/s (n_levels,); as `level_maps`."""
    maps = level_maps(
        model, simulation, rows, density_kg_per_m3=density_kg_per_m3, window=window, face_depths=face_depths
    )
    return np.array([float(each.speed_m_per_s.mean()) for each in maps])


def _with_fields(tables: Iterable[Table], fields: tuple[str, ...]) -> Table:
    for each in tables:
        if set(fields) <= set(each.fields):
            return each
    raise MeasurementError(
        f"the simulation recorded no {fields[0]} .. {fields[-1]}",
        where="shear-wave prediction",
        fix="run it again with our templates: they ask for displacements and deformation gradients",
    )


def _corners(cells: IntArray) -> IntArray:
    return cells[:, np.minimum(np.arange(4), cells.shape[1] - 1)]


def _near(
    positions: Array, depth: float, window: Window, pixels: tuple[Array, Array] | None
) -> NDArray[np.bool_]:
    """The elements that some pixel may look at."""
    half, deep = window.half_width, window.depth_to
    if pixels is not None:
        half, deep = float(np.abs(pixels[0]).max()), float(pixels[1].max())
    reach = 2 * window.smoothing + 6.0
    near = np.abs(positions[:, 0]) <= half + reach
    near &= np.abs(positions[:, 1]) <= window.elevation + reach
    return near & (positions[:, 2] >= -depth - deep - reach)
