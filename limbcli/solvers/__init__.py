"""Solvers behind one contract: FEBio, and the bundled reference solver."""

from __future__ import annotations

import os
from pathlib import Path

from limbcli.errors import CaseError, LimbError
from limbcli.solvers.base import Solver

KINDS = ("auto", "febio", "reference")
ABSENT = "absent"  # in place of a solver that is asked for and cannot be had


def choose(kind: str = "auto", febio: Path | None = None, *, threads: int | None = None) -> Solver:
    """The solver to use: "febio", "reference", or "auto" (FEBio where it is found).

    Raises
    ------
    CaseError
        If `kind` is none of these.
    ToolError
        If FEBio is asked for, by kind or by naming its binary here or in the environment, and is not there.
    """
    from limbcli.solvers.febio import FebioSolver

    if kind not in KINDS:
        raise CaseError(
            f"there is no solver {kind!r}", where="--solver", fix=f"use one of: {', '.join(KINDS)}"
        )
    solver = FebioSolver(febio, threads=threads)
    if kind == "febio" or (kind == "auto" and is_named(febio)):
        solver.need()
        return solver
    if kind == "auto" and solver.found():
        return solver
    from limbcli.solvers.reference import ReferenceSolver

    return ReferenceSolver()


def is_named(febio: Path | None) -> bool:
    """Whether a FEBio is named, here or in the environment, and so must be there."""
    from limbcli.solvers.febio import VARIABLE

    return febio is not None or bool(os.environ.get(VARIABLE))


def identity(kind: str = "auto", febio: Path | None = None) -> str:
    """What `choose` would give, in words that change where its results may: for keys of results.

    >>> identity("reference")
    'reference'
    """
    try:
        return choose(kind, febio).identity()
    except LimbError:  # the stage that needs it says so
        return ABSENT
