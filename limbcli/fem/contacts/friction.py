"""Contact with Coulomb friction: FEBio's `sliding-elastic` with `fric_coeff`.

The response is path-dependent: slip is measured from the previous converged step, and a point that comes
into contact within a step slips. See `friction_kernels` for the law.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from limbcli.fem.contacts import friction_kernels
from limbcli.fem.contacts.contact_points import FACET, GAP, TRACTION
from limbcli.fem.contacts.friction_kernels import APART, PUSH, STICKS
from limbcli.fem.contacts.pairs import Pair
from limbcli.fem.motion.rigid import AT_REST, Body, BodyState
from limbcli.model import Array


@dataclass(eq=False)
class FrictionPair(Pair):
    """A contact with friction; stores the last converged step.

    rigid : the body on the rigid side
    was, now : its position at the last converged step, and at the last search
    before : per patch, the state of its points at the last converged step (see `friction_kernels`)
    pulls : per patch, the vector multipliers (n_facets, n_gauss, 3) of augmented contact
    """

    rigid: Body
    was: BodyState = AT_REST
    now: BodyState = AT_REST
    before: list[Array] = field(default_factory=list)
    pulls: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        for patch in self.patches:
            shape = patch.state.shape[:2]
            patch.state = np.zeros((*shape, friction_kernels.N_STATE))
            patch.state[..., FACET] = -1
        self.before = [np.zeros((*p.state.shape[:2], friction_kernels.N_BEFORE)) for p in self.patches]
        for each in self.before:
            each[..., friction_kernels.HELD] = -1
        self.pulls = [np.zeros((*p.state.shape[:2], 3)) for p in self.patches]

    @property
    def mu(self) -> float:
        return self.contact.friction

    @property
    def move(self) -> Array:
        """Motion (4, 3) of the body since the converged step: rotation matrix, then translation."""
        turn = self.now.turn @ self.was.turn.T
        center = self.rigid.center
        return np.concatenate([turn, (center + self.now.shift - turn @ (center + self.was.shift))[None]])

    def remember(self, x: Array, at: BodyState) -> None:
        """Store a converged step as the reference for the next one."""
        super().search(x, at)
        for p, before in zip(self.patches, self.before, strict=True):
            friction_kernels.remember(x, p.facets, p.N, p.dN, p.state, before)
        self.was = self.now = at

    def forget(self) -> None:
        super().forget()
        self.was = self.now = AT_REST
        for each in self.before:
            each[..., friction_kernels.HELD] = -1
        for pull in self.pulls:
            pull[:] = 0.0

    def multipliers(self) -> list[tuple[Array, ...]]:
        return [(p.multiplier.copy(), pull.copy()) for p, pull in zip(self.patches, self.pulls, strict=True)]

    def set_multipliers(self, found: Sequence[tuple[Array, ...]]) -> None:
        super().set_multipliers(found)
        self.pulls = [pull.copy() for _, pull in found]

    def _augment(self) -> None:
        for p, pull in zip(self.patches, self.pulls, strict=True):
            touches = p.state[..., TRACTION] > 0
            p.multiplier = p.state[..., TRACTION].copy()
            pull[:] = np.where(touches[..., None], p.state[..., PUSH : PUSH + 3], 0.0)

    def _sum_of_squares(self) -> float:
        total = 0.0
        for p, pull in zip(self.patches, self.pulls, strict=True):
            squares = np.where(p.state[..., STICKS] > 0, (pull**2).sum(axis=-1), p.multiplier**2)
            total += float(squares.sum())
        return total

    def _largest_gap(self) -> float:
        """Of sticking points their distance from the anchor."""
        largest = 0.0
        for p in self.patches:
            sticks, touches = p.state[..., STICKS] > 0, p.state[..., TRACTION] > 0
            apart = np.where(sticks, p.state[..., APART], abs(p.state[..., GAP]))
            largest = max(largest, float(apart[touches].max(initial=0.0)))
        return largest

    def search(self, x: Array, at: BodyState) -> int:
        count = super().search(x, at)
        self.now = at
        for p, before, pull in zip(self.patches, self.before, self.pulls, strict=True):
            friction_kernels.resist(x, p.facets, p.N, p.dN, p.eps, self.mu, before, self.move, pull, p.state)
        return count

    def force(self, center: Array, out: Array, body: Array) -> None:
        for p in self.patches:
            friction_kernels.force(p.facets, p.N, p.weights, p.state, center, out, body)

    def times(self, x: Array, center: Array, v: Array, motion: Array, out: Array, body: Array) -> None:
        for p, before, pull in zip(self.patches, self.before, self.pulls, strict=True):
            friction_kernels.times(
                x, p.facets, p.N, p.dN, p.weights, p.eps, self.mu, self.full_tangent, before, self.move, pull,
                p.state, center, v, motion, out, body,
            )  # fmt: skip

    def blocks(self, x: Array, *, couples: bool = True) -> list[tuple[Array, Array]]:
        center = self.rigid.center + self.now.shift
        found = []
        for p, before, pull in zip(self.patches, self.before, self.pulls, strict=True):
            n = p.facets.shape[1]
            out = np.empty((len(p.facets), n, 3, n, 3))
            touched = friction_kernels.blocks(
                x, p.facets, p.N, p.dN, p.weights, p.eps, self.mu, self.full_tangent, float(couples), before,
                self.move, pull, p.state, center, out,
            )  # fmt: skip
            found.append((out, touched))
        return found
