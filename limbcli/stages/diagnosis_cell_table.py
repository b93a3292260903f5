"""What a diagnosis reads off a solved table of cells: curves of force and speed, and the deformation.

A table's values (n_depths, n_cells, 12): middles of the tissue's cells, then their deformation gradients.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.effects.frozen import Kinematics
from limbcli.effects.reading import Curves
from limbcli.effects.tissue import thickness
from limbcli.effects.waves import log_speed
from limbcli.errors import MeasurementError
from limbcli.measurement.swe_prediction import predict_map
from limbcli.model import Array, IntArray, LimbModel, LogRecord
from limbcli.stages.diagnosis_cells import centers, volumes
from limbcli.stages.diagnosis_windows import Windows
from limbcli.stages.indentation_model import TISSUE

FILE = "windows.csv"
_CENTER = ("x", "y", "z")
_GRADIENT = tuple(f"F{a}{b}" for a in "xyz" for b in "xyz")


@dataclass(frozen=True, eq=False)
class CellTable:
    """cells : of the tissue, counted over the model; near : of them, those near the scanner's window"""

    cells: IntArray
    near: IntArray
    windows: Windows
    density_kg_per_m3: float

    @property
    def record(self) -> LogRecord:
        """What a simulation must write."""
        return LogRecord("element", (*_CENTER, *_GRADIENT), FILE, self.cells)

    def kinematics(self, model: LimbModel, depth: Array, values: Array) -> Kinematics:
        """The deformation of every tissue cell at these depths (mm, n)."""
        n = len(self.cells)
        F = np.concatenate([np.broadcast_to(np.eye(3), (1, n, 3, 3)), values[:, :, 3:].reshape(-1, n, 3, 3)])
        places = np.concatenate([centers(model, self.cells)[None], values[:, :, :3]])
        parts = [self.windows.members(at, -d) for at, d in zip(places, depth, strict=True)]
        return Kinematics(depth, F, volumes(model), tuple(zip(*parts, strict=True)))

    def curves(
        self, model: LimbModel, in_window: LimbModel, depths: Array, forces: Array, values: Array
    ) -> Curves:
        """Forces (N, n) and speeds over depths (mm, n); in_window: the model as the waves meet it."""
        return Curves(
            np.concatenate([[0.0], depths]), np.concatenate([[0.0], forces]),
            self.log_speeds(in_window, depths, values), self.windows.depths, thickness(model),
        )  # fmt: skip

    def log_speeds(self, model: LimbModel, depths: Array, values: Array) -> Array:
        """ln speeds (n + 1, n_parts): at rest, and at every depth."""
        rest = np.zeros((len(self.near), 12))
        rest[:, :3] = centers(model, self.cells)[self.near]
        rest[:, [3, 7, 11]] = 1.0
        rows = [self._speeds(model, 0.0, rest)]
        rows += [self._speeds(model, d, table[self.near]) for d, table in zip(depths, values, strict=True)]
        return np.array(rows)

    def _speeds(self, model: LimbModel, depth: float, table: Array) -> Array:
        F = table[:, 3:].reshape(-1, 3, 3)
        speed = np.exp(log_speed(model, TISSUE, F, self.near, density_kg_per_m3=self.density_kg_per_m3))
        try:
            swe = predict_map(table[:, :3], speed, face_height=-depth, window=self.windows.window)
        except MeasurementError:
            return np.full(len(self.windows.depths), np.nan)
        return self.windows.log_means(swe)[0]
