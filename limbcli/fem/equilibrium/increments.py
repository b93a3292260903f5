"""Increments towards one load step, and their possible outcomes.

    Newton's method converges                  CONVERGED: accepted, the next increment may be longer
    it fails, but pseudo-time relaxation       CAME_TO_REST: accepted, the next increment is as long
      finds equilibrium
    both fail, the increment can be cut        SHORTEN: retried at half its length
    it cannot be cut further                   BEGIN_AGAIN: once, from the last load step, without
                                                 independent volume ratios
    that fails too, or the tissue is           HOPELESS: an error that states the cause
      unconstrained

A load step that is attempted briefly, or whose response is path-dependent, is not begun again.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto

from limbcli.fem.equilibrium.settings import LoadStep
from limbcli.fem.motion.state import State


class IncrementOutcome(Enum):
    """Outcome of an increment."""

    CONVERGED = auto()
    CAME_TO_REST = auto()
    SHORTEN = auto()
    BEGIN_AGAIN = auto()
    HOPELESS = auto()


@dataclass(frozen=True)
class Increment:
    """One attempted increment, from time `begin` to time `aim` (s).

    rest : time from its beginning to the load step
    iterations_before : Newton iterations of the analysis so far
    is_last : whether it ends at the load step
    """

    begin: float
    aim: float
    rest: float
    iterations_before: int
    is_last: bool

    @property
    def length(self) -> float:
        return self.aim - self.begin


@dataclass(frozen=True, eq=False)
class Reached:
    """How far an analysis step has been solved.

    states : converged states, from its start on
    increment : length (s) of the next increment; n_steady : number of increments before it may grow again
    n_touching : points in contact at the last state; n_pressed : number of increments that ended in contact
    pairs : states in contact at the last load steps, each with the earlier solve's
    """

    states: tuple[State, ...]
    increment: float
    n_steady: int = 0
    n_touching: int = 0
    n_pressed: int = 0
    pairs: tuple[tuple[State, State], ...] = ()

    @property
    def last(self) -> State:
        return self.states[-1]


@dataclass
class LoadStepPath:
    """Progress towards one load step, at time `target`.

    start : what was reached at its beginning
    known : initial guess at `target` from an earlier solve, until it has been tried; earlier : the same, kept
    brief : limited to few cuts and to a total of `most_iterations` of the analysis
    patient : whether to fall back on relaxation where Newton's method fails
    cuts : since the last accepted increment; all_cuts : since the last load step
    failed_relaxations : their number
    """

    target: float
    load_step: LoadStep
    known: State | None
    brief: bool
    most_cuts: int
    most_iterations: int | None
    start: Reached
    patient: bool = True
    cuts: int = 0
    all_cuts: int = 0
    failed_relaxations: int = 0
    earlier: State | None = field(init=False)

    def __post_init__(self) -> None:
        self.earlier = self.known

    @property
    def is_exhausted(self) -> bool:
        """Whether the limit of cuts is reached."""
        return self.cuts >= self.most_cuts

    def note_cut(self) -> None:
        self.cuts += 1
        self.all_cuts += 1
