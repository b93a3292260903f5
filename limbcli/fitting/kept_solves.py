"""The solves of a site's fits, kept on disk: a fit with another option solves only what is new to it.

A solve is identified by the content of its model, by what was asked of it, and by the program. A fit that
takes the same way as an earlier one finds all of its solves there, and with them the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from limbcli.inference.prediction import Prediction
from limbcli.model import Array, LimbModel
from limbcli.model.npz_file import model_hash
from limbcli.provenance.batch_memory import code_hash, key_of
from limbcli.solvers.solve_folder import SolveFolder

if TYPE_CHECKING:
    from limbcli.solvers.session import Solved

_LETTERS = 24  # of the hash in a file's name
_LEVELS = "*-levels.npz"


@dataclass(frozen=True, eq=False)
class KeptForces:
    """depths (n_levels,) mm, and the forces there with their derivatives."""

    depths: Array
    prediction: Prediction

    @staticmethod
    def of(stored: Any) -> KeptForces:
        forces, jacobian = np.asarray(stored["forces"]), np.asarray(stored["jacobian"])
        if forces.ndim != 1 or jacobian.shape[:1] != forces.shape or stored["depths"].shape != forces.shape:
            raise ValueError("forces and derivatives of different numbers of levels")
        return KeptForces(stored["depths"], Prediction(forces, jacobian))

    def arrays(self) -> dict[str, Any]:
        return {"depths": self.depths, "forces": self.prediction.values, "jacobian": self.prediction.jacobian}


@dataclass(frozen=True, eq=False)
class KeptSolves:
    """folder : of the files; None: nothing is kept"""

    folder: Path | None = None

    @staticmethod
    def of_site(out: Path, site: str) -> KeptSolves:
        return KeptSolves(out / "fit" / f".work-{site}")

    def forces(self, model: LimbModel) -> KeptForces | None:
        """Forces and derivatives of a model of the search."""
        return self._files.read(self._key(model), KeptForces.of)

    def keep_forces(self, model: LimbModel, solved: KeptForces) -> None:
        self._files.write(self._key(model), solved.arrays())

    def levels(self, model: LimbModel) -> Solved | None:
        return self._files.levels(self._key(model))

    def keep_levels(self, model: LimbModel, solved: Solved) -> None:
        """Keep the levels of the fitted model, instead of those of an earlier fit."""
        if self.folder is not None:
            for path in self.folder.glob(_LEVELS):
                path.unlink(missing_ok=True)
            self._files.keep_levels(self._key(model), solved)

    def checked(self, model: LimbModel) -> Array | None:
        """Forces (n_reached,) N of a fitted model that was changed for a check."""
        return self._files.read(self._key(model, "check"), lambda stored: np.asarray(stored["forces"]))

    def keep_checked(self, model: LimbModel, forces: Array) -> None:
        self._files.write(self._key(model, "check"), {"forces": forces})

    @property
    def _files(self) -> SolveFolder:
        return SolveFolder(self.folder)

    def _key(self, model: LimbModel, what: str = "search") -> str:
        if self.folder is None:
            return ""
        return key_of(what, model_hash(model), code_hash())[:_LETTERS]


NOTHING_KEPT = KeptSolves()
