"""The solves of a site's fits, kept on disk: a fit with another option solves only what is new to it.

A solve is identified by the content of its model, by what was asked of it, and by the program. A fit that
takes the same way as an earlier one finds all of its solves there, and with them the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from limbcli.inference.prediction import Prediction
from limbcli.model import Array, IntArray, LimbModel
from limbcli.model.npz_file import model_hash
from limbcli.progress import SILENT, Progress
from limbcli.provenance.batch_memory import code_hash, key_of
from limbcli.solvers.session import ReferenceSession
from limbcli.solvers.session_options import StartFrom, StopWhen
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


_TOLERANCE = 1e-4
# Relative residual that is accepted where the iterations stall, as they do where fibres begin to be
# stretched. On a limb with fibres this changed the force of one level of eight by 0.06 %.
_STALLED = 1e-2
_LEAST_CHECKED = 3


def checked_levels(model: LimbModel) -> IntArray:
    """Numbers of the levels at which a check solves a changed model: a third, at least three, the first and
    the last among them; all where the load has several steps. On the sites of `cases/` (4 to 12 levels) an
    interpolation from three levels errs by 0.6 % of the force at most, by 0.1 % at the median."""
    n_levels = sum(len(step.must_points) for step in model.steps)
    n = n_levels if len(model.steps) > 1 else min(n_levels, max(_LEAST_CHECKED, n_levels // 3 + 1))
    return np.linspace(0, n_levels - 1, n).round().astype(np.int64)


@dataclass(frozen=True, eq=False, kw_only=True)
class CheckSolver:
    """How a fitted model that was changed for a check is solved again.

    like : a session that solved the model before; this solve begins there and ends at the first level that it
        does not reach quickly
    levels : of the model before, as initial guesses of a solve of all levels; rows : those to solve
        (`checked_levels`), None: all; kept : where the forces of such a solve are kept for a later fit
    """

    like: ReferenceSession | None = None
    levels: Solved | None = None
    rows: IntArray | None = None
    kept: KeptSolves = NOTHING_KEPT
    progress: Progress = SILENT

    def forces(self, model: LimbModel) -> Array:
        """Forces (n_reached,) N at levels of a model that was changed for a check, or SolveError."""
        if self.rows is not None and len(model.steps) == 1:
            (step,) = model.steps
            fewer = replace(step, must_points=tuple(step.must_points[k] for k in self.rows))
            model = replace(model, steps=(fewer,))
        if self.like is None and (known := self.kept.checked(model)) is not None:
            return known
        session = ReferenceSession(model, progress=self.progress, tolerance=_TOLERANCE, stalled=_STALLED)
        try:
            if self.like is None:
                solved = session.solve(model, start=StartFrom(levels=self.levels)).must_points.forces
                self.kept.keep_checked(model, solved)
                return solved
            session.start_like(self.like)
            return session.solve(model, stop=StopWhen(required=1, full_effort=0)).must_points.forces
        finally:
            session.close()
