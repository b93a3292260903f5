"""Initial guesses from the levels of a solve on another mesh of the same body.

Displacements and volume ratios are interpolated; boundary values are set afterwards by
`Kinematics.prescribed`. The interpolation error varies from cell to cell, so the residual of such a guess
is large although its displacements are close to the solution: a few iterations smooth it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from limbcli.fem.elements.element import shape
from limbcli.fem.motion.state import RoughState
from limbcli.fem.system import System
from limbcli.model import Array, IntArray, LimbModel

_CANDIDATES = 12  # cells with the nearest centroids among which the one containing a point is sought


@dataclass(frozen=True, eq=False)
class OtherMesh:
    """Converged levels on another tetrahedral mesh.

    points (n_points, 3) : mm, reference configuration; cells (n_cells, 4 or 10)
    displacements : (n_points, 3) mm, by time
    """

    points: Array
    cells: IntArray
    displacements: Mapping[float, Array]

    @classmethod
    def of(cls, model: LimbModel, displacements: Mapping[float, Array]) -> OtherMesh | None:
        """From a model's tissue; None unless it consists of a single kind of tetrahedra."""
        blocks = model.mesh.solid_blocks
        if len({each.kind for each in blocks}) != 1 or blocks[0].kind not in ("tet4", "tet10"):
            return None
        return cls(model.mesh.points, np.concatenate([each.cells for each in blocks]), displacements)

    def guess(self, system: System, time: float) -> RoughState | None:
        """The level at `time`, interpolated to the mesh of `system`; None if it was not solved."""
        if time not in self.displacements:
            return None
        u_there = self.displacements[time]
        moved = [np.unique(group.cells) for group in system.groups]
        nodes = np.unique(np.concatenate(moved))
        u = np.zeros_like(system.X)
        u[nodes] = self._at(system.X[nodes], u_there)
        ratios = self._volume_ratios(u_there)
        corners = self.cells[:, :4]
        volumes = []
        for group in system.groups:
            places, shares = self._located(system.X[group.cells[:, :4]].mean(axis=1))
            middle = np.einsum("ni,ni->n", shares, ratios[corners[places]])
            volumes.append(np.repeat(middle[:, None], group.weight.shape[1], axis=1))
        return RoughState(time, u, system.start.bodies, (), tuple(volumes))

    def _at(self, places: Array, values: Array) -> Array:
        cells, shares = self._located(places)
        N, _ = shape(self._kind, shares[:, 1:])
        return np.asarray(np.einsum("nk,nkj->nj", N, values[self.cells[cells]]))

    def _located(self, places: Array) -> tuple[IntArray, Array]:
        """The cell (n,) that contains each place, or the nearest one, and barycentric coordinates (n, 4).

        Places outside all candidates (curved surfaces differ between meshes) are clipped to the cell.
        """
        _, near = self._middles.query(places, k=min(_CANDIDATES, len(self.cells)))
        near = near.reshape(len(places), -1)
        origin, inverse = self._frames
        best, cells, shares = np.full(len(places), -np.inf), near[:, 0].copy(), np.zeros((len(places), 4))
        for each in near.T:
            along = np.einsum("nij,nj->ni", inverse[each], places - origin[each])
            found = np.column_stack([1.0 - along.sum(axis=1), along])
            inside = found.min(axis=1)
            better = inside > best
            best[better], cells[better], shares[better] = inside[better], each[better], found[better]
        shares = np.maximum(shares, 0.0)
        return cells, shares / shares.sum(axis=1, keepdims=True)

    def _volume_ratios(self, u: Array) -> Array:
        """Volume ratios (n_points,) at the corner nodes: volume-weighted means of the adjacent cells."""
        corners, ratio = self.cells[:, :4], np.linalg.det(np.eye(3) + self._gradients(u))
        total, weight = np.zeros(len(self.points)), np.zeros(len(self.points))
        np.add.at(total, corners, np.repeat((ratio * self._volumes)[:, None], 4, axis=1))
        np.add.at(weight, corners, np.repeat(self._volumes[:, None], 4, axis=1))
        return total / np.where(weight > 0, weight, 1.0)

    def _gradients(self, u: Array) -> Array:
        """du/dX (n_cells, 3, 3) at the centroid of each cell."""
        _, dN = shape(self._kind, np.full((1, 3), 0.25))
        along = np.einsum("cni,nj->cij", u[self.cells], dN[0])
        return np.asarray(along @ self._frames[1])

    @property
    def _kind(self) -> str:
        return "tet10" if self.cells.shape[1] == 10 else "tet4"

    @cached_property
    def _middles(self) -> cKDTree:
        return cKDTree(self.points[self.cells[:, :4]].mean(axis=1))

    @cached_property
    def _frames(self) -> tuple[Array, Array]:
        """First corner (n_cells, 3) of each cell, and the map (n_cells, 3, 3) from an offset to
        barycentric coordinates."""
        corners = self.points[self.cells[:, :4]]
        edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
        return corners[:, 0], np.asarray(np.linalg.inv(edges), float)

    @cached_property
    def _volumes(self) -> Array:
        """Cell volumes (n_cells,), mm^3."""
        return np.asarray(1.0 / (6.0 * np.abs(np.linalg.det(self._frames[1]))))
