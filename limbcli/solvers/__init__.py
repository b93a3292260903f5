"""Solvers behind one interface: FEBio, and the bundled reference solver."""

from __future__ import annotations

import os
from pathlib import Path

from limbcli.errors import CaseError, LimbError
from limbcli.solvers.solver import Solver

KINDS = ("auto", "febio", "reference")
ABSENT = "absent"  # identity of a requested solver that is not available


def choose(kind: str = "auto", febio: Path | None = None) -> Solver:
    """The solver to use: "febio", "reference", or "auto" (FEBio where it is found).

    Raises CaseError if `kind` is none of these; ToolError if FEBio is requested, by kind or by naming its
    binary here or in the environment, and not found.
    """
    from limbcli.solvers.febio import FebioSolver

    if kind not in KINDS:
        raise CaseError(
            f"there is no solver {kind!r}", where="--solver", fix=f"use one of: {', '.join(KINDS)}"
        )
    solver = FebioSolver(febio)
    if kind == "febio" or (kind == "auto" and is_named(febio)):
        solver.need()
        return solver
    if kind == "auto" and solver.found():
        return solver
    from limbcli.solvers.reference import ReferenceSolver

    return ReferenceSolver()


def is_named(febio: Path | None) -> bool:
    """Whether a FEBio binary is named, here or in the environment, and therefore required."""
    from limbcli.solvers.febio import VARIABLE

    return febio is not None or bool(os.environ.get(VARIABLE))


def identity(kind: str = "auto", febio: Path | None = None) -> str:
    """A string that identifies the solver `choose` would return, for cache keys of results.

    It changes whenever the solver's results may change; `ABSENT` if no solver can be chosen.

    >>> identity("reference")
    'reference'
    """
    try:
        return choose(kind, febio).identity()
    except LimbError:  # reported by the stage that needs the solver
        return ABSENT
