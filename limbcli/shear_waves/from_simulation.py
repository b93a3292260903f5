"""Shear-wave speed under the probe at simulated levels: maps as the scanner shows them, and their means."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.errors import MeasurementError
from limbcli.measurement.elastography import SweMap
from limbcli.model import Array, IntArray, LimbModel
from limbcli.shear_waves.pixels import Window, predict_map
from limbcli.shear_waves.speed import element_speeds
from limbcli.solvers.integration_points import IntegrationPoints
from limbcli.solvers.solver import Simulation, Table

_MOVED = ("ux", "uy", "uz")
MEAN_WINDOW = Window(pixel=2.0)
AT_REST = -1


@dataclass(frozen=True, eq=False)
class PointStates:
    """Position and deformation of the tissue at the integration points of the recorded elements.

    Integration points are used because speed grows faster than linearly with strain, so that the speed at an
    element's mean strain is too low.

    items (n,) : number of the element, over all blocks, that contains each point; rest (n, 3) mm, unloaded
    """

    items: IntArray
    rest: Array
    _points: tuple[IntegrationPoints, ...]
    _displacements: NodeDisplacements

    @staticmethod
    def of(model: LimbModel, simulation: Simulation) -> PointStates:
        """
        Raises MeasurementError if the simulation recorded no elements, or not the displacements of all of
        their nodes.
        """
        elements = _largest(simulation.elements.values())
        found, items, first = [], [], 0
        for block in model.mesh.blocks:
            here = elements.items[(elements.items >= first) & (elements.items < first + len(block.cells))]
            if len(here):
                cells = replace(block, cells=block.cells[here - first])
                found.append(IntegrationPoints.of(model.mesh.points, cells))
                items.append(np.repeat(here, found[-1].volume.shape[1]))
            first += len(block.cells)
        moved = NodeDisplacements.of(simulation.nodes.values(), found, n_points=len(model.mesh.points))
        rest = np.concatenate([each.rest.reshape(-1, 3) for each in found])
        return PointStates(np.concatenate(items), rest, tuple(found), moved)

    def at(self, row: int) -> tuple[Array, Array]:
        """Positions (n, 3) mm and deformation gradients (n, 3, 3) at a time of the simulation, or at
        AT_REST.
        """
        if row == AT_REST:
            return self.rest, np.broadcast_to(np.eye(3), (len(self.rest), 3, 3))
        u = self._displacements.at(row)
        places = [each.places(u).reshape(-1, 3) for each in self._points]
        gradients = [each.gradients(u).reshape(-1, 3, 3) for each in self._points]
        return np.concatenate(places), np.concatenate(gradients)


@dataclass(frozen=True, eq=False)
class NodeDisplacements:
    """Displacements of a simulation at all nodes of the model; 0 where they were not recorded.

    items (n,) : recorded nodes; values (n_times, n, 3) mm; n_points : number of nodes of the model
    """

    items: IntArray
    values: Array
    n_points: int

    @staticmethod
    def of(
        tables: Iterable[Table], needed: Iterable[IntegrationPoints], *, n_points: int
    ) -> NodeDisplacements:
        """
        Raises MeasurementError if no table holds the displacements of all the nodes that are needed.
        """
        nodes = np.unique(np.concatenate([np.zeros(0, np.int64), *(each.cells.ravel() for each in needed)]))
        for each in tables:
            if set(_MOVED) <= set(each.fields) and np.isin(nodes, each.items).all():
                values = np.stack([each.column(name) for name in _MOVED], axis=-1)
                return NodeDisplacements(each.items, values, n_points)
        raise _not_recorded("the displacements of all nodes")

    def at(self, row: int) -> Array:
        """Displacements (n_points, 3) mm."""
        u = np.zeros((self.n_points, 3))
        u[self.items] = self.values[row]
        return u


def level_maps(
    model: LimbModel, simulation: Simulation, rows: Sequence[int] | IntArray, *, density_kg_per_m3: float,
    window: Window = MEAN_WINDOW, pixels: Sequence[tuple[Array, Array] | None] | None = None,
    face_depths: Array | None = None,
) -> list[SweMap]:  # fmt: skip
    """The map that the scanner would show at each row of the simulation's times (AT_REST: unloaded).

    It is evaluated at the integration points of the recorded elements, from the recorded displacements of
    their nodes.

    pixels : for each level those of its measured map (lateral, depth mm), or None for those of the window
    face_depths : (n_times,) mm, depth of the top of the window if it is not that of the probe (probe not in
        contact)

    Raises MeasurementError if the window contains no tissue at some level.
    """
    states = PointStates.of(model, simulation)
    depths, maps = simulation.probe_depth() if face_depths is None else face_depths, []
    for k, row in enumerate(rows):
        depth = float(depths[row]) if row != AT_REST else 0.0
        positions, F = states.at(int(row))
        own = pixels[k] if pixels is not None else None
        # the points within reach of any pixel
        half, deep = window.half_width, window.depth_to
        if own is not None:
            half, deep = float(np.abs(own[0]).max()), float(own[1].max())
        reach = 2 * window.smoothing + 6.0
        near = np.abs(positions[:, 0]) <= half + reach
        near &= np.abs(positions[:, 1]) <= window.slice_reach
        near &= positions[:, 2] >= -depth - deep - reach
        speed = element_speeds(model, F[near], states.items[near], density_kg_per_m3=density_kg_per_m3)
        maps.append(predict_map(positions[near], speed, face_height=-depth, window=window, pixels=own))
    return maps


def mean_speeds(
    model: LimbModel, simulation: Simulation, rows: IntArray, *, density_kg_per_m3: float,
    face_depths: Array | None = None,
) -> Array:  # fmt: skip
    """Mean predicted speed over the scanner's window, m/s (n_levels,); arguments as in `level_maps`."""
    maps = level_maps(
        model, simulation, rows, density_kg_per_m3=density_kg_per_m3, window=MEAN_WINDOW,
        face_depths=face_depths,
    )  # fmt: skip
    return np.array([float(each.speed_m_per_s.mean()) for each in maps])


def _largest(tables: Iterable[Table]) -> Table:
    """The table with the most elements."""
    found = max(tables, key=lambda each: len(each.items), default=None)
    if found is None or not len(found.items):
        raise _not_recorded("elements")
    return found


def _not_recorded(what: str) -> MeasurementError:
    return MeasurementError(
        f"the simulation did not record {what}",
        where="shear-wave prediction",
        fix="run it again with limbcli's templates: they request elements under the probe, and all "
        "displacements",
    )
