"""Whether iterations still lead anywhere.

A contact point that touches in one iteration and parts in the next leaves the same few residuals in turn for
ever: there is no state between the two that the discretised contact would call equilibrium.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from limbcli.fem.motion.state import Forces, State

_SAME = 0.01  # relative difference of residuals that are the same


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
        """Whether the last residuals are those of one or two iterations before, and small enough."""
        last = self._errors[-4:]
        if len(last) < 4 or not self.will_do:
            return False
        return all(abs(a - b) <= _SAME * a for a, b in zip(last[:2], last[2:], strict=True))
