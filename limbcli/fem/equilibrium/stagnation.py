"""Whether iterations still lead anywhere.

A contact point that touches in one iteration and parts in the next leaves the same few residuals in turn for
ever: there is no state between the two that the discretised contact would call equilibrium.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from limbcli.fem.motion.state import Forces, State

_SAME = 0.01  # relative difference of residuals that are the same
_CERTAIN = 12  # residuals in turn after which nothing else is to come; a drag that grows repeats fewer


@dataclass
class Stagnation:
    """The least residual so far, and whether it will do.

    stalled : error that will do where iterations stand
    """

    stalled: float
    state: State | None = None
    error: float = float("inf")
    _errors: list[float] = field(default_factory=list)

    def note(self, state: State, forces: Forces) -> None:
        """One more iteration, with the hints of its contact."""
        self._errors.append(forces.error)
        if forces.worst > 0 and forces.error < self.error:
            self.state, self.error = state, forces.error

    @property
    def will_do(self) -> bool:
        return self.error <= self.stalled

    @property
    def goes_round(self) -> bool:
        """Whether the last residuals are those of two iterations before: four of them where the least will
        do, else `_CERTAIN`, as a long way may have a slow stretch."""
        n = 4 if self.will_do else _CERTAIN
        last = self._errors[-n:]
        return len(last) == n and all(
            abs(a - b) <= _SAME * a for a, b in zip(last[:-2], last[2:], strict=True)
        )
