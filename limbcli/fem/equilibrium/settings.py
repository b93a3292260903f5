"""Settings of the equilibrium solver, and counts of its work."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol


@dataclass(frozen=True)
class Settings:
    """Settings of the equilibrium solver.

    tolerance : relative residual, i.e. norm of the residual over norm of the acting forces
    slip_as_febio : with friction, measure each time step from where its first linear solve ends, as FEBio
        holds sticking points anew there: the two then agree, and every time step loses more friction
    stalled : relative residual accepted where the iteration stagnates, as when a contact point alternates
        between open and closed
    renew_ratio : the elastic tangent is reassembled after an iteration that leaves more than this fraction
        of the residual
    single : factor in single precision (None: for large systems); GMRES restores the accuracy
    linear : "auto", "multifrontal", "pardiso" or "superlu"
    mixed : use independent volume ratios during the iteration (see `Newton.with_volumes`)
    """

    tolerance: float = 1e-6
    max_iterations: int = 30
    linear: str = "auto"
    threads: int = 2
    single: bool | None = None
    mixed: bool = True
    renew_ratio: float = 1e-3
    stalled: float = 0.0
    slip_as_febio: bool = False


@dataclass
class Counts:
    """Counts of the work done, and its time."""

    iterations: int = 0
    residuals: int = 0
    krylov: int = 0
    factorisations: int = 0
    retries: int = 0
    seconds: dict[str, float] = field(default_factory=dict)


class WorkLimit(Protocol):
    """Is told of the work of every Newton iteration, and stops the solve by raising a `SolveError`."""

    def charge(self, *, step: int, n_steps: int, krylov: int, factorisations: int) -> None: ...


@dataclass(frozen=True)
class LoadStep:
    """Number of a load step and what it aims at, for messages.

    depth : of a body that is pressed in, mm; None where none is
    aim : the depth or the force of the body, in words; "" where it has neither
    time : at its end
    """

    number: int
    n_steps: int
    depth: float | None
    aim: str = ""
    time: float = 0.0

    def at(self, time: float, reached: str) -> str:
        """Text for a time on the way to this load step, and what is reached there."""
        words = f", {reached}" if reached else ""
        return f"load step {self.number} of {self.n_steps} (time {time:.6g}{words})"
