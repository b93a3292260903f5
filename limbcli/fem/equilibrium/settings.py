"""Settings of the equilibrium solver, and counts of its work."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Settings:
    """Settings of the equilibrium solver.

    tolerance : relative residual, i.e. norm of the residual over norm of the acting forces
    slip_as_febio : with friction, measure each time step from where its first linear solve ends, as FEBio
        holds sticking points anew there: the two then agree, and every time step loses more friction
    stalled : relative residual accepted where the iteration stagnates, as when a contact point alternates
        between open and closed
    single : factor in single precision (None: for large systems); GMRES restores the accuracy
    linear : "auto", "multifrontal", "pardiso" or "superlu"
    volume_ratios : use independent volume ratios during the iteration (see `Newton.with_volumes`)
    """

    tolerance: float = 1e-6
    max_iterations: int = 30
    linear: str = "auto"
    threads: int = 2
    single: bool | None = None
    volume_ratios: bool = True
    stalled: float = 0.0
    slip_as_febio: bool = False


@dataclass
class Counts:
    """Counts of the work done."""

    iterations: int = 0
    residuals: int = 0
    krylov: int = 0
    factorisations: int = 0
    retries: int = 0


class WorkLimit(Protocol):
    """Limit on the work of a run; `charge` raises a `SolveError` where an iteration exceeds it."""

    def charge(self, *, step: int, n_steps: int, krylov: int, factorisations: int) -> None: ...


class WorkMeter:
    """Charges the work of a run, as counted since the last charge, to its limit."""

    def __init__(self, counts: Counts, limit: WorkLimit | None):
        self.counts, self.limit = counts, limit
        self._charged = counts.krylov, counts.factorisations

    def charge(self, load_step: LoadStep) -> None:
        (krylov, factorisations), counts = self._charged, self.counts
        self._charged = counts.krylov, counts.factorisations
        if self.limit is not None:
            self.limit.charge(
                step=load_step.number, n_steps=load_step.n_steps, krylov=counts.krylov - krylov,
                factorisations=counts.factorisations - factorisations,
            )  # fmt: skip


@dataclass(frozen=True)
class LoadStep:
    """Number of a load step and what it aims at, for messages.

    depth : of a body that is pressed in, mm; None where none is
    aim : the depth or the force of the body, in words; "" where it has neither
    time : at its end
    meter : charged with the work of every iteration
    """

    number: int
    n_steps: int
    depth: float | None
    aim: str = ""
    time: float = 0.0
    meter: WorkMeter | None = None

    def at(self, time: float, reached: str) -> str:
        """Text for a time on the way to this load step, and what is reached there."""
        words = f", {reached}" if reached else ""
        return f"load step {self.number} of {self.n_steps} (time {time:.6g}{words})"
