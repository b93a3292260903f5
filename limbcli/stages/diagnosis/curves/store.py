"""Disk cache of a site's solved curves and deformations, by a key of their model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from limbcli.atomic_files import atomic_file
from limbcli.effects.curves import Curves
from limbcli.model import Array
from limbcli.solvers.restart import solved_arrays, solved_of

if TYPE_CHECKING:
    from limbcli.solvers.restart import Solved

_UNREADABLE = (OSError, ValueError, KeyError, EOFError, BadZipFile)  # treated as missing and solved again


@dataclass(frozen=True, eq=False)
class KeptCurves:
    """Curves, the work of their solve, and the number of depths it reached."""

    curves: Curves
    work: int
    n_reached: int


@dataclass(frozen=True)
class CurveStore:
    """folder : of the cache; None: nothing is cached"""

    folder: Path | None

    def curves(self, key: str, *, n_depths: int) -> KeptCurves | None:
        """Cached curves; None if there are none, or they have another number of depths."""
        if self.folder is None:
            return None
        try:
            with np.load(self.folder / f"{key}.npz") as stored:
                if len(stored["depth"]) != n_depths + 1:
                    return None
                curves = Curves(
                    stored["depth"], stored["force"], stored["log_speed"], stored["window_depth"],
                    float(stored["thickness"]), stored.get("log_line", None),
                )  # fmt: skip
                return KeptCurves(curves, int(stored["work"]), int(stored["n_reached"]))
        except _UNREADABLE:
            return None

    def keep_curves(self, key: str, curves: Curves, *, work: int, n_reached: int) -> None:
        if self.folder is None:
            return
        lines = {} if curves.log_line is None else {"log_line": curves.log_line}
        with atomic_file(self.folder / f"{key}.npz") as path:
            np.savez(
                path, depth=curves.depth, force=curves.force, log_speed=curves.log_speed,
                window_depth=curves.window_depth, thickness=curves.thickness, work=work, n_reached=n_reached,
                **lines,  # type: ignore[arg-type]
            )  # fmt: skip

    def displacements(self, key: str) -> Array | None:
        """Displacements (n_depths, n_nodes, 3) of the tissue's nodes in mm."""
        path = None if self.folder is None else self.folder / f"{key}-nodes.npz"
        if path is None or not path.is_file():
            return None
        try:
            with np.load(path) as stored:
                return np.asarray(stored["values"], dtype=float)
        except _UNREADABLE:
            return None

    def levels(self, key: str) -> Solved | None:
        """Converged levels, used as initial guesses of later solves."""
        path = None if self.folder is None else self.folder / f"{key}-levels.npz"
        if path is None or not path.is_file():
            return None
        try:
            with np.load(path, allow_pickle=False) as stored:
                return solved_of(stored)
        except _UNREADABLE:
            return None

    def keep_levels(self, key: str, solved: Solved) -> None:
        if self.folder is None:
            return
        with atomic_file(self.folder / f"{key}-levels.npz") as path:
            np.savez(path, **solved_arrays(solved))

    def keep_displacements(self, key: str, values: NDArray[np.float32]) -> None:
        if self.folder is not None:
            with atomic_file(self.folder / f"{key}-nodes.npz") as path:
                np.savez(path, values=values)
