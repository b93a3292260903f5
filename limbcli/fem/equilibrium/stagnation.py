"""Detects stagnation of the iterations.

A contact point that closes in one iteration and opens in the next repeats the same residuals indefinitely:
the discretised contact has no equilibrium between the two states.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from limbcli.fem.motion.state import Forces

_SAME = 0.01  # relative difference up to which two residuals count as equal
_CERTAIN = 12  # repeating residuals that prove a cycle; while the drag is being increased fewer may repeat


@dataclass
class Stagnation:
    """Tracks the smallest residual and detects a two-iteration cycle.

    stalled : relative residual accepted on stagnation
    least : forces with the smallest relative residual so far
    """

    stalled: float
    least: Forces | None = None
    _errors: list[float] = field(default_factory=list)

    def note(self, forces: Forces) -> None:
        """Record an iteration."""
        self._errors.append(forces.error)
        if forces.worst > 0 and (self.least is None or forces.error < self.least.error):
            self.least = forces

    @property
    def acceptable(self) -> Forces | None:
        """Those forces, if their residual is accepted on stagnation."""
        return self.least if self.least is not None and self.least.error <= self.stalled else None

    @property
    def repeats(self) -> bool:
        """Whether the last residuals repeat with a period of two: four of them if the smallest residual is
        acceptable, else `_CERTAIN`, since a converging iteration may also be slow for a while."""
        n = 4 if self.acceptable else _CERTAIN
        last = self._errors[-n:]
        return len(last) == n and all(
            abs(a - b) <= _SAME * a for a, b in zip(last[:-2], last[2:], strict=True)
        )
