"""Memo of a site's solves on disk: curves, deformations, levels, held forces, by the key of their model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from limbcli.effects.curves import Curves
from limbcli.files.atomic import atomic_file
from limbcli.files.unpacking import DAMAGED, read_npz
from limbcli.model import Array
from limbcli.solvers.restart import solved_arrays, solved_of

if TYPE_CHECKING:
    from limbcli.solvers.restart import Solved

T = TypeVar("T")


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


@dataclass(frozen=True, eq=False)
class SolveMemo:
    """folder : of the files; None: only levels are remembered, and only in this run"""

    folder: Path | None
    _levels: dict[str, Solved] = field(default_factory=dict)

    def curves(self, key: str, *, n_depths: int) -> SolvedCurves | None:
        """None if there are none, or they have another number of depths."""
        found = self.read(key, SolvedCurves.of)
        return found if found is not None and len(found.curves.depth) == n_depths + 1 else None

    def keep_curves(self, key: str, solved: SolvedCurves) -> None:
        self.write(key, solved.arrays())

    def displacements(self, key: str) -> Array | None:
        """Displacements (n_depths, n_nodes, 3) of the tissue's nodes in mm, stored in single precision."""
        return self.read(f"{key}-nodes", lambda stored: np.asarray(stored["values"], dtype=float))

    def keep_displacements(self, key: str, values: Array) -> None:
        self.write(f"{key}-nodes", {"values": values.astype(np.float32)})

    def levels(self, key: str) -> Solved | None:
        """Converged levels, used as initial guesses of later solves."""
        if key not in self._levels and (found := self.read(f"{key}-levels", solved_of)) is not None:
            self._levels[key] = found
        return self._levels.get(key)

    def keep_levels(self, key: str, solved: Solved) -> None:
        self._levels[key] = solved
        self.write(f"{key}-levels", solved_arrays(solved))

    def read(self, name: str, parse: Callable[[Any], T]) -> T | None:
        if self.folder is None:
            return None
        try:
            return parse(read_npz(self.folder / f"{name}.npz"))
        except DAMAGED:  # treated as missing, and solved again
            return None

    def write(self, name: str, arrays: dict[str, Any]) -> None:
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
            with atomic_file(self.folder / f"{name}.npz") as path:
                np.savez(path, **arrays)
