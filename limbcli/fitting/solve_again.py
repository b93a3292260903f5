"""A fitted model that was changed for a check is solved again."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import PchipInterpolator

from limbcli.errors import SolveError
from limbcli.fitting.kept_solves import KeptSolves
from limbcli.model import Array, LimbModel
from limbcli.progress import SILENT, Progress
from limbcli.solvers.session import ReferenceSession
from limbcli.solvers.session_options import StartFrom, StopWhen

if TYPE_CHECKING:
    from limbcli.solvers.session import Solved

_TOLERANCE = 1e-4
# Relative residual that is accepted where the iterations stall, as they do where fibres begin to be
# stretched. On a limb with fibres this changed the force of one level of eight by 0.06 %.
_STALLED = 1e-2
# Levels at which a change is solved, first and last among them: at least three, and a third of many. What a
# contact or a boundary changes varies little from level to level: on the sites of `cases/` (4 to 12 levels)
# an interpolation from three levels errs by 0.6 % of the force at most, by 0.1 % at the median.
_LEAST_SOLVED = 3


def forces_again(
    model: LimbModel, check: str, *, like: ReferenceSession | None = None, levels: Solved | None = None,
    forces: Array | None = None, kept: KeptSolves = KeptSolves(), threads: int = 2,
    progress: Progress = SILENT,
) -> Array:  # fmt: skip
    """Forces (n_reached,) N at the levels of a fitted model that was changed for this check.

    like : a session that has solved the model before the change; its levels are the initial guesses of this
        solve. The solve ends at the first level not reached quickly from there, as a comparison does not need
        every level
    levels : the levels of the model before the change, as initial guesses of a solve of all levels
    forces (n_levels,) N : before the change; the ratio to them is then solved at some of the levels and
        interpolated at the others
    kept : where the forces of such a solve are kept for a later fit

    Raises
    ------
    SolveError
        If the model cannot be solved.
    """
    if forces is not None and len(forces) > _LEAST_SOLVED and len(model.steps) == 1:
        n = max(_LEAST_SOLVED, len(forces) // 3 + 1)
        rows = np.linspace(0, len(forces) - 1, n).round().astype(int)
        (step,) = model.steps
        times = np.array(step.must_points)
        few = replace(model, steps=(replace(step, must_points=tuple(times[rows].tolist())),))
        found = forces_again(few, check, levels=levels, kept=kept, threads=threads, progress=progress)
        ratio = np.log(found / forces[rows])
        return np.asarray(forces * np.exp(PchipInterpolator(times[rows], ratio)(times)))
    if like is None and (known := kept.checked(model)) is not None:
        return known
    session = ReferenceSession(
        model, progress=progress, threads=threads, tolerance=_TOLERANCE, stalled=_STALLED
    )
    try:
        if like is None:
            solved = session.solve(model, start=StartFrom(levels=levels)).must_points.forces
            kept.keep_checked(model, solved)
            return solved
        session.start_like(like)
        return session.solve(model, stop=StopWhen(required=1, full_effort=0)).must_points.forces
    except ArithmeticError as error:
        raise SolveError(
            f"the law overflows ({error})", where=check, fix=f"--no-{check.replace(' ', '-')}"
        ) from error
    finally:
        session.close()
