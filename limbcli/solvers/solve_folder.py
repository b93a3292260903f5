"""A folder of what was solved, by the key of the model: forces, levels, whatever a caller stores of a solve.

Files that are missing or damaged are solved again; deleting the folder loses only computing time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from limbcli.files.atomic import atomic_file
from limbcli.files.unpacking import DAMAGED, read_npz
from limbcli.solvers.restart import solved_arrays, solved_of

if TYPE_CHECKING:
    from limbcli.solvers.restart import Solved

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class SolveFolder:
    """folder : of the files; None: only levels are remembered, and only in this run"""

    folder: Path | None
    _levels: dict[str, Solved] = field(default_factory=dict)

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
