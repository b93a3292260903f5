"""How far a session's solve goes, and where it starts from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from limbcli.solvers.budget import Budget

if TYPE_CHECKING:
    from limbcli.fem.warm_start import Solved


@dataclass(frozen=True, kw_only=True)
class StopWhen:
    """When a solve ends; None: all levels are required, solved with full effort, and attempted.

    Attributes
    ----------
    required : number of levels that must be reached, later ones only if possible
    full_effort : number of levels solved with full effort, later ones attempted briefly; None: as `required`
    last : number of levels attempted
    enough_force : force on the body (N) at which no further levels are solved
    patient : where Newton's method fails, fall back on pseudo-time relaxation, which is slow
    budget : charged for the work; if it is spent, the levels reached so far are the result if they are enough
    """

    required: int | None = None
    full_effort: int | None = None
    last: int | None = None
    enough_force: float | None = None
    patient: bool = True
    budget: Budget | None = None


@dataclass(frozen=True, kw_only=True)
class StartFrom:
    """Where a solve takes its initial guesses from.

    Attributes
    ----------
    levels : levels of an earlier solve; None: those of the nearest solve with `keep_levels`
    independent : use nothing else from earlier solves, so that the result does not depend on any other solves
    """

    levels: Solved | None = None
    independent: bool = False
