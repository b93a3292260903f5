"""Integration points of a solved mesh: positions, deformation gradients and volumes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.fem.elements.element import reference_gradients, shape
from limbcli.fem.elements.quadrature import rule
from limbcli.model import Array, Block, IntArray

# F is linear in a straight-sided tet10, so four points determine it; other kinds use their default rule.
_RULES = {"tet10": "TET10G4"}


@dataclass(frozen=True, eq=False)
class IntegrationPoints:
    """The q integration points of each cell of a block.

    cells (n_cells, n_nodes); rest (n_cells, q, 3) : reference positions, mm; volume (n_cells, q) : mm^3
    """

    cells: IntArray
    rest: Array
    volume: Array
    _shape: Array
    _slope: Array

    @staticmethod
    def of(points: Array, block: Block) -> IntegrationPoints:
        """Integration points of a block. points (n_points, 3) : the mesh's reference positions, mm"""
        chosen = rule(_RULES.get(block.kind, block.kind))
        values, _ = shape(block.kind, chosen[0])
        slope, volume = reference_gradients(points, block.cells, block.kind, chosen)
        rest = np.einsum("qn,cni->cqi", values, points[block.cells], optimize=True)
        return IntegrationPoints(block.cells, rest, volume, values, slope)

    def gradients(self, displacement: Array) -> Array:
        """F (n_cells, q, 3, 3) of displacements (n_points, 3) mm of the mesh's points."""
        moved = displacement[self.cells]
        return np.asarray(np.eye(3) + np.einsum("cni,cqnj->cqij", moved, self._slope, optimize=True))

    def places(self, displacement: Array) -> Array:
        """Deformed positions (n_cells, q, 3), mm."""
        return self.rest + np.einsum("qn,cni->cqi", self._shape, displacement[self.cells], optimize=True)
