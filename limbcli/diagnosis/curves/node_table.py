"""Evaluation of solved displacements: deformation, and curves of force, speed and layer borders.

Evaluated at the integration points of each cell, not from cell means: speeds grow faster than linearly with
strain, so that mean strains give too low a speed, the more so the larger the cells.
A table's values (n_depths, n_nodes, 3) are displacements of the tissue's nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.diagnosis.curves.site_solver import Solve
from limbcli.diagnosis.data.layer_rows import BorderLines
from limbcli.diagnosis.data.windows import Windows
from limbcli.effects.curves import Curves
from limbcli.effects.frozen_deformation import SolvedDeformation, frozen_speed, strain_concentrations
from limbcli.effects.stiffness_places import Stiffness
from limbcli.effects.tissue import thickness
from limbcli.model import Array, IntArray, LimbModel, LogRecord
from limbcli.solvers.integration_points import IntegrationPoints

_FILE = "displacements.csv"


@dataclass(frozen=True, eq=False)
class NodeTable:
    """Evaluates displacements of the tissue's nodes.

    nodes : indices of these; borders : layer borders to track
    """

    nodes: IntArray
    windows: Windows
    density_kg_per_m3: float
    borders: BorderLines | None = None

    @staticmethod
    def of(
        model: LimbModel, windows: Windows, density_kg_per_m3: float, borders: BorderLines | None = None
    ) -> NodeTable:
        nodes = np.unique(model.mesh.solid_blocks[0].cells)
        return NodeTable(nodes, windows, density_kg_per_m3, borders)

    def records(self, model: LimbModel) -> tuple[LogRecord, ...]:
        """Required output of a simulation."""
        displacements = LogRecord("node", ("ux", "uy", "uz"), _FILE, self.nodes)
        return (displacements,) if self.borders is None else (displacements, self.borders.record(model))

    def values(self, solve: Solve) -> Array:
        """Displacements at the levels reached, in the precision of the memo, so that a resumed diagnosis
        continues with the same numbers."""
        return solve.result.simulation.nodes[_FILE].values[solve.result.rows].astype(np.float32).astype(float)

    def kinematics(self, model: LimbModel, depth: Array, values: Array) -> SolvedDeformation:
        """The tissue's deformation at these depths (mm, n), the first of which is 0."""
        points = IntegrationPoints.of(model.mesh.points, model.mesh.solid_blocks[0])
        displacement = np.zeros((len(depth), len(model.mesh.points), 3))
        displacement[1:, self.nodes] = values
        rest = points.rest.reshape(-1, 3)
        F = np.array([points.gradients(u) for u in displacement])
        seen = [
            self.windows.seen(
                model, points.places(u).reshape(-1, 3), rest, gradient.reshape(-1, 3, 3), depth=float(d)
            )
            for u, gradient, d in zip(displacement, F, depth, strict=True)
        ]
        return SolvedDeformation(depth, F, points.rest, points.volume, tuple(seen))

    def curves(
        self, solve: Solve, kinematics: SolvedDeformation, *, in_window: LimbModel,
        stiffness: Sequence[Stiffness] = (), without: Sequence[tuple[float, SolvedDeformation]] = (),
    ) -> Curves:  # fmt: skip
        """Curves down to the level reached.

        in_window : the model used for the wave speeds, without `stiffness`; stiffness : fields that multiply
        its stiffnesses; without : see `strain_concentrations`
        """
        density = self.density_kg_per_m3
        concentrations = strain_concentrations(
            in_window, kinematics, without, stiffness, density_kg_per_m3=density
        )
        speeds = frozen_speed(
            in_window, kinematics, stiffness, density_kg_per_m3=density, concentrations=concentrations
        )
        lines = None
        if self.borders is not None:
            lines = self.borders.log_depths(solve.model, solve.result.simulation, solve.result.rows)
        return Curves(
            kinematics.depth, np.concatenate([[0.0], solve.result.must_points.forces]), speeds,
            self.windows.depths, thickness(solve.model), lines,
        )  # fmt: skip
