"""What a diagnosis reads off solved displacements: curves of force and speed, and the deformation.

Read at the integration points of each cell, not at its mean: speeds grow faster than in proportion to strain,
so that those of mean strains are too low, the more the larger the cells.
A table's values (n_depths, n_nodes, 3): displacements of the tissue's nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.effects.curves import Curves
from limbcli.effects.frozen_deformation import SolvedDeformation, frozen_speed, strain_concentrations
from limbcli.effects.places import Stiffness
from limbcli.effects.tissue import thickness
from limbcli.model import Array, IntArray, LimbModel, LogRecord
from limbcli.solvers.integration_points import IntegrationPoints
from limbcli.stages.diagnosis.data.windows import Windows

FILE = "displacements.csv"


@dataclass(frozen=True, eq=False)
class NodeTable:
    """nodes : of the tissue"""

    nodes: IntArray
    windows: Windows
    density_kg_per_m3: float

    @staticmethod
    def of(model: LimbModel, windows: Windows, density_kg_per_m3: float) -> NodeTable:
        return NodeTable(np.unique(model.mesh.solid_blocks[0].cells), windows, density_kg_per_m3)

    @property
    def record(self) -> LogRecord:
        """What a simulation must write."""
        return LogRecord("node", ("ux", "uy", "uz"), FILE, self.nodes)

    def kinematics(self, model: LimbModel, depth: Array, values: Array) -> SolvedDeformation:
        """The tissue's deformation at these depths (mm, n), the first of them 0."""
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
        self, model: LimbModel, in_window: LimbModel, kinematics: SolvedDeformation, forces: Array,
        stiffness: Sequence[Stiffness] = (), without: Sequence[tuple[float, SolvedDeformation]] = (),
    ) -> Curves:  # fmt: skip
        """Forces (N, n) and speeds over depths; in_window: the model as the waves meet it, but for
        `stiffness`, fields that multiply its stiffnesses; without: see `strain_concentrations`."""
        density = self.density_kg_per_m3
        concentrations = strain_concentrations(
            in_window, kinematics, without, stiffness, density_kg_per_m3=density
        )
        speeds = frozen_speed(
            in_window, kinematics, stiffness, density_kg_per_m3=density, concentrations=concentrations
        )
        return Curves(
            kinematics.depth, np.concatenate([[0.0], forces]), speeds, self.windows.depths, thickness(model)
        )
