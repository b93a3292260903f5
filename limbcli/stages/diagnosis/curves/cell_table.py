"""What a diagnosis reads off a solved table of cells: curves of force and speed, and the deformation.

A table's values (n_depths, n_cells, 12): middles of the tissue's cells, then their deformation gradients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.effects.curves import Curves
from limbcli.effects.frozen import SolvedDeformation, frozen_speed, strain_concentrations
from limbcli.effects.places import Stiffness
from limbcli.effects.tissue import thickness
from limbcli.model import Array, IntArray, LimbModel, LogRecord
from limbcli.stages.diagnosis.curves.cells import centers, volumes
from limbcli.stages.diagnosis.data.windows import Windows

FILE = "windows.csv"
_CENTER = ("x", "y", "z")
_GRADIENT = tuple(f"F{a}{b}" for a in "xyz" for b in "xyz")


@dataclass(frozen=True, eq=False)
class CellTable:
    """cells : of the tissue, counted over the model"""

    cells: IntArray
    windows: Windows
    density_kg_per_m3: float

    @property
    def record(self) -> LogRecord:
        """What a simulation must write."""
        return LogRecord("element", (*_CENTER, *_GRADIENT), FILE, self.cells)

    def kinematics(self, model: LimbModel, depth: Array, values: Array) -> SolvedDeformation:
        """The deformation of every tissue cell at these depths (mm, n), the first of them 0."""
        n = len(self.cells)
        rest = centers(model, self.cells)
        F = np.concatenate([np.broadcast_to(np.eye(3), (1, n, 3, 3)), values[:, :, 3:].reshape(-1, n, 3, 3)])
        places = np.concatenate([rest[None], values[:, :, :3]])
        seen = [
            self.windows.seen(model, at, rest, gradient, depth=float(d))
            for at, gradient, d in zip(places, F, depth, strict=True)
        ]
        return SolvedDeformation(depth, F, volumes(model), tuple(seen))

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
