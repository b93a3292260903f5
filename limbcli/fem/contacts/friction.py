"""Contact with Coulomb friction: FEBio's `sliding-elastic` with `fric_coeff`.

The response is path-dependent: slip is measured from the previous converged step, and a point that comes
into contact within a step slips. See `friction_kernels` for the law.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from limbcli.fem.contacts import friction_kernels
from limbcli.fem.contacts.contact_points import GAP, TRACTION
from limbcli.fem.contacts.friction_kernels import APART, PUSH, STICKS
from limbcli.fem.contacts.pairs import Pair
from limbcli.fem.motion.rigid import AT_REST, BodyState
from limbcli.model import Array


@dataclass(eq=False)
class FrictionPair(Pair):
    """A contact with friction; stores the last converged step.

    was : position of the body at the last converged step
    before : per patch, the state of its points at the last converged step (see `friction_kernels`)
    pulls : per patch, the vector multipliers (n_facets, n_gauss, 3) of augmented contact
    """

    n_columns: ClassVar[int] = friction_kernels.N_STATE
    kernels: ClassVar[ModuleType] = friction_kernels

    was: BodyState = AT_REST
    before: list[Array] = field(default_factory=list)
    pulls: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        shapes = [p.multiplier.shape for p in self.patches]
        self.before = [np.zeros((*shape, friction_kernels.N_BEFORE)) for shape in shapes]
        for each in self.before:
            each[..., friction_kernels.HELD] = -1
        self.pulls = [np.zeros((*shape, 3)) for shape in shapes]

    @property
    def mu(self) -> float:
        return self.contact.friction

    def move(self, at: BodyState) -> Array:
        """Motion (4, 3) of the body since the converged step: rotation matrix, then translation."""
        turn = at.turn @ self.was.turn.T
        center = self.rigid.center
        return np.concatenate([turn, (center + at.shift - turn @ (center + self.was.shift))[None]])

    def remember(self, x: Array, at: BodyState, hints: Sequence[Array]) -> None:
        """Store a converged step as the reference for the next one."""
        found, _ = super().search(x, at, hints)
        for p, points, before in zip(self.patches, found, self.before, strict=True):
            friction_kernels.remember(x, p.facets, p.N, p.dN, points, before)
        self.was = at

    def forget(self) -> None:
        super().forget()
        self.was = AT_REST
        for each in self.before:
            each[..., friction_kernels.HELD] = -1
        for pull in self.pulls:
            pull[:] = 0.0

    def multipliers(self) -> list[tuple[Array, ...]]:
        return [(p.multiplier.copy(), pull.copy()) for p, pull in zip(self.patches, self.pulls, strict=True)]

    def set_multipliers(self, found: Sequence[tuple[Array, ...]]) -> None:
        super().set_multipliers(found)
        self.pulls = [pull.copy() for _, pull in found]

    def _augment(self, found: Sequence[Array]) -> None:
        for p, points, pull in zip(self.patches, found, self.pulls, strict=True):
            touches = points[..., TRACTION] > 0
            p.multiplier = points[..., TRACTION].copy()
            pull[:] = np.where(touches[..., None], points[..., PUSH : PUSH + 3], 0.0)

    def _sum_of_squares(self, found: Sequence[Array]) -> float:
        total = 0.0
        for p, points, pull in zip(self.patches, found, self.pulls, strict=True):
            squares = np.where(points[..., STICKS] > 0, (pull**2).sum(axis=-1), p.multiplier**2)
            total += float(squares.sum())
        return total

    def _largest_gap(self, found: Sequence[Array]) -> float:
        """Of sticking points their distance from the anchor."""
        largest = 0.0
        for points in found:
            sticks, touches = points[..., STICKS] > 0, points[..., TRACTION] > 0
            apart = np.where(sticks, points[..., APART], abs(points[..., GAP]))
            largest = max(largest, float(apart[touches].max(initial=0.0)))
        return largest

    def search(self, x: Array, at: BodyState, hints: Sequence[Array] = ()) -> tuple[tuple[Array, ...], int]:
        found, n_touching = super().search(x, at, hints)
        for k, (p, points) in enumerate(zip(self.patches, found, strict=True)):
            friction_kernels.resist(x, p.facets, p.N, p.dN, p.eps, points, *self._further(k, at))
        return found, n_touching

    def blocks(
        self, k: int, points: Array, at: BodyState, x: Array, *, full: bool, couples: bool = True
    ) -> tuple[Array, Array]:
        return self._blocks(k, points, x, full, *self._further(k, at), float(couples))

    def _further(self, k: int, at: BodyState) -> tuple[Any, ...]:
        return self.mu, self.before[k], self.move(at), self.pulls[k]
