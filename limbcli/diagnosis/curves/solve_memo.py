"""Memo of a site's solves for its diagnosis: curves, deformations, levels, held forces, by the key of their
model."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from limbcli.effects.curves import Curves
from limbcli.model import Array
from limbcli.solvers.solve_folder import SolveFolder


@dataclass(frozen=True, eq=False)
class SolvedCurves:
    """Curves, the work of their solve, and the number of depths it reached."""

    curves: Curves
    work: int
    n_reached: int

    @staticmethod
    def of(stored: Any) -> SolvedCurves:
        curves = Curves(
            stored["depth"], stored["force"], stored["log_speed"], stored["window_depth"],
            float(stored["thickness"]), stored.get("log_line", None),
        )  # fmt: skip
        return SolvedCurves(curves, int(stored["work"]), int(stored["n_reached"]))

    def arrays(self) -> dict[str, Any]:
        found = {**vars(self), **{each.name: getattr(self.curves, each.name) for each in fields(Curves)}}
        return {name: each for name, each in found.items() if name != "curves" and each is not None}


class SolveMemo(SolveFolder):
    """Memo of a site's simulations for its diagnosis."""

    def curves(self, key: str, *, n_depths: int) -> SolvedCurves | None:
        """None if there are none, or they have another number of depths."""
        found = self.read(key, SolvedCurves.of)
        return found if found is not None and len(found.curves.depth) == n_depths + 1 else None

    def displacements(self, key: str) -> Array | None:
        """Displacements (n_depths, n_nodes, 3) of the tissue's nodes in mm, stored in single precision."""
        return self.read(f"{key}-nodes", lambda stored: np.asarray(stored["values"], dtype=float))

    def keep_displacements(self, key: str, values: Array) -> None:
        self.write(f"{key}-nodes", {"values": values.astype(np.float32)})
