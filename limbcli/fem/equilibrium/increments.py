"""The increments on the way to one load step: what is tried, and what may become of it.

    Newton's method converges               CONVERGED: taken, the next one may be longer
    it does not, but the tissue relaxes     CAME_TO_REST: taken, the next one is as long
    neither, and it can be shorter          SHORTEN: tried again at half its length
    it cannot                               BEGIN_AGAIN: once, from the last load step, by displacements alone
    nor that, or nothing holds the tissue   HOPELESS: an error with its cause

A load step that is tried briefly, or whose response depends on the way, is not begun again.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from limbcli.fem.equilibrium.settings import LoadStep
from limbcli.fem.motion.state import State


class IncrementOutcome(Enum):
    """What becomes of an increment."""

    CONVERGED = auto()
    CAME_TO_REST = auto()
    SHORTEN = auto()
    BEGIN_AGAIN = auto()
    HOPELESS = auto()


@dataclass(frozen=True)
class Increment:
    """One try: from a time to a time (s).

    rest : from its beginning to the load step; is_last : it ends there
    iterations_before : Newton's, of the analysis so far
    """

    begin: float
    aim: float
    rest: float
    iterations_before: int
    is_last: bool

    @property
    def length(self) -> float:
        return self.aim - self.begin


@dataclass
class LoadStepPath:
    """The way to one load step, at time `target`.

    known : first guess at its end, from an earlier solve, as long as it was not tried
    brief : tried briefly, with few cuts and up to `most_iterations` of the analysis
    start : states reached, increments pressed and points touching at its beginning
    cuts : since the last increment that was taken; all_cuts : on this way
    restless : times that the tissue did not come to rest
    """

    target: float
    load_step: LoadStep
    known: State | None
    brief: bool
    most_cuts: int
    most_iterations: int | None
    start: tuple[int, int, int]
    cuts: int = 0
    all_cuts: int = 0
    restless: int = 0

    @property
    def is_exhausted(self) -> bool:
        """Whether the next increment will not be cut once more."""
        return self.cuts >= self.most_cuts

    def note_cut(self) -> None:
        self.cuts += 1
        self.all_cuts += 1
