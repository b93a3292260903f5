"""A fitted model that was changed for a check is solved again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from limbcli.errors import SolveError
from limbcli.fitting.kept_solves import NOTHING_KEPT, KeptSolves
from limbcli.model import Array, IntArray, LimbModel
from limbcli.progress import SILENT, Progress
from limbcli.solvers.session import ReferenceSession
from limbcli.solvers.session_options import StartFrom, StopWhen

if TYPE_CHECKING:
    from limbcli.solvers.session import Solved

_TOLERANCE = 1e-4
# Relative residual that is accepted where the iterations stall, as they do where fibres begin to be
# stretched. On a limb with fibres this changed the force of one level of eight by 0.06 %.
_STALLED = 1e-2
_LEAST_CHECKED = 3


def checked_levels(model: LimbModel) -> IntArray:
    """Numbers of the levels at which a check solves a changed model: a third of many, at least three, among
    them the first and the last; all where the load has several steps.

    Between them what a contact or a boundary changes varies little: on the sites of `cases/` (4 to 12 levels)
    an interpolation from three levels errs by 0.6 % of the force at most, by 0.1 % at the median.
    """
    n_levels = sum(len(step.must_points) for step in model.steps)
    n = n_levels if len(model.steps) > 1 else min(n_levels, max(_LEAST_CHECKED, n_levels // 3 + 1))
    return np.linspace(0, n_levels - 1, n).round().astype(np.int64)


@dataclass(frozen=True, eq=False, kw_only=True)
class CheckSolver:
    """How a fitted model that was changed for a check is solved again.

    like : a session that has solved the model before the change; its levels are the initial guesses of this
        solve. The solve ends at the first level not reached quickly from there, as a comparison does not need
        every level
    levels : the levels of the model before the change, as initial guesses of a solve of all levels
    rows : numbers of the levels to solve (`checked_levels`); None: all
    kept : where the forces of such a solve are kept for a later fit
    """

    like: ReferenceSession | None = None
    levels: Solved | None = None
    rows: IntArray | None = None
    kept: KeptSolves = NOTHING_KEPT
    progress: Progress = SILENT

    def forces(self, model: LimbModel, check: str) -> Array:
        """Forces (n_reached,) N at levels of a model that was changed for this check.

        Raises SolveError if the model cannot be solved.
        """
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
        except ArithmeticError as error:
            raise SolveError(
                f"the law overflows ({error})", where=check, fix=f"--no-{check.replace(' ', '-')}"
            ) from error
        finally:
            session.close()
