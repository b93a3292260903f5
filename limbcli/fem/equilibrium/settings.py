"""How equilibrium is sought, and what it cost."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Settings:
    """How equilibrium is sought.

    tolerance : residual over the forces at play, both as norms
    stalled : residual that will do where iterations no longer lessen it, as a contact point comes and goes
    renew_ratio : the elastic tangent is renewed after an iteration that gains less than this
    single : factor in single precision (None: for large systems); GMRES makes up for it
    linear : "auto", "multifrontal", "pardiso" or "superlu"
    mixed : pressures of their own on the way to equilibrium (see `Newton.with_volumes`)
    """

    tolerance: float = 1e-6
    max_iterations: int = 30
    linear: str = "auto"
    threads: int = 2
    single: bool | None = None
    mixed: bool = True
    renew_ratio: float = 1e-3
    stalled: float = 0.0


@dataclass
class Counts:
    """What the work cost."""

    iterations: int = 0
    residuals: int = 0
    krylov: int = 0
    factorisations: int = 0
    retries: int = 0
    seconds: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class LoadStep:
    """Where the load stands, for messages."""

    number: int
    n_steps: int
    depth: float

    def at(self, time: float, depth: float) -> str:
        """In words, on the way to it: at a time and the depth there."""
        return f"load step {self.number} of {self.n_steps} (time {time:.6g}, depth {depth:.2f} mm)"
