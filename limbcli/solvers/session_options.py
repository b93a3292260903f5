"""How far a session's solve goes, where it starts from, and the work that it may take.

Work is counted in solver operations, not in time, so that a solve stops at the same point on any machine. The
unit is one product with the factorised matrix, as in a Krylov iteration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from limbcli.errors import SolveError

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


_PER_ITERATION, _PER_FACTOR = 10, 20  # further work of a Newton iteration, and of a factorisation


class BudgetSpent(SolveError):
    """The solve was stopped because it took all the work it was allowed."""


@dataclass(kw_only=True)
class Budget:
    """Work that a solve may take, and has taken.

    allowed : limit in products
    needed : fraction of the load steps that must be reached; inf: all are equally important
    beyond : limit of the load steps after those, as a fraction of the work of the latter
    spent : products so far
    """

    allowed: float = math.inf
    needed: float = math.inf
    beyond: float = 1.0
    spent: int = 0

    def charge(self, *, step: int, n_steps: int, krylov: int, factorisations: int) -> None:
        """Count a Newton iteration in a load step, with its Krylov products and factorisations.

        Raises BudgetSpent if the work exceeds what is allowed.
        """
        if step > self.needed * n_steps:
            self.needed, self.allowed = math.inf, min(self.allowed, (1.0 + self.beyond) * self.spent)
        self.spent += _PER_ITERATION + krylov + _PER_FACTOR * factorisations
        if self.spent > self.allowed:
            raise BudgetSpent(
                f"load step {step} of {n_steps} was stopped after {self.spent} matrix products; "
                f"{self.allowed:.0f} are allowed",
                where="reference solver", fix="allow more work, or coarsen the mesh",
                spent=self.spent, allowed=self.allowed,
            )  # fmt: skip
