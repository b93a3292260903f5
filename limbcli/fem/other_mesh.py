"""First guesses from the levels of a solve on another mesh of the same body.

Displacements and volume ratios are interpolated; what is held takes its place when the state is prescribed.
From cell to cell such a guess is rough, so that its residual is large, and yet it is near on the whole: few
iterations smooth it.
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

_CANDIDATES = 12  # cells whose middles are nearest: one of them holds the point, or is next to it


@dataclass(frozen=True, eq=False)
class OtherMesh:
    """Solved levels on another mesh of tetrahedra.

    points (n_points, 3) : mm, at rest; cells (n_cells, 4 or 10)
    displacements : (n_points, 3) mm, by time
    """

    points: Array
    cells: IntArray
    displacements: Mapping[float, Array]

    @classmethod
    def of(cls, model: LimbModel, displacements: Mapping[float, Array]) -> OtherMesh | None:
        """Of a model's tissue; None where it is not of one kind of tetrahedra."""
        blocks = model.mesh.solid_blocks
        if len({each.kind for each in blocks}) != 1 or blocks[0].kind not in ("tet4", "tet10"):
            return None
        return cls(model.mesh.points, np.concatenate([each.cells for each in blocks]), displacements)

    def guess(self, system: System, time: float) -> RoughState | None:
        """The level at `time` on the mesh of `system`; None where it was not solved."""
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
        """The cell (n,) that each place is in, or nearest to, and its barycentric coordinates (n, 4) there:
        those of the cell's border for what lies outside, as bent surfaces differ between meshes."""
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
        """(n_points,) at the corners: the mean of the cells', by their volumes."""
        corners, ratio = self.cells[:, :4], np.linalg.det(np.eye(3) + self._gradients(u))
        total, weight = np.zeros(len(self.points)), np.zeros(len(self.points))
        np.add.at(total, corners, np.repeat((ratio * self._volumes)[:, None], 4, axis=1))
        np.add.at(weight, corners, np.repeat(self._volumes[:, None], 4, axis=1))
        return total / np.where(weight > 0, weight, 1.0)

    def _gradients(self, u: Array) -> Array:
        """du/dX (n_cells, 3, 3) in the middle of every cell."""
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
        """First corners (n_cells, 3), and from there places to barycentric coordinates (n_cells, 3, 3)."""
        corners = self.points[self.cells[:, :4]]
        edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
        return corners[:, 0], np.asarray(np.linalg.inv(edges), float)

    @cached_property
    def _volumes(self) -> Array:
        """mm3 (n_cells,)."""
        return np.asarray(1.0 / (6.0 * np.abs(np.linalg.det(self._frames[1]))))
