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
from limbcli.fem.contacts.contact_points import FACET, GAP, MOST_NODES, TRACTION, WEIGHT
from limbcli.fem.contacts.friction_kernels import APART, PUSH, STICKS
from limbcli.fem.contacts.pairs import Pair
from limbcli.model import Array, IntArray


@dataclass(eq=False)
class FrictionPair(Pair):
    """A contact with friction; stores the last converged step.

    before : per patch, the state of its points at the last converged step (see `friction_kernels`)
    pulls : per patch, the vector multipliers (n_facets, n_gauss, 3) of augmented contact
    """

    n_columns: ClassVar[int] = friction_kernels.N_STATE
    kernels: ClassVar[ModuleType] = friction_kernels

    before: list[Array] = field(default_factory=list)
    pulls: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__post_init__()
        shapes = [p.multiplier.shape for p in self.patches]
        self.before = [np.zeros((*shape, friction_kernels.N_BEFORE)) for shape in shapes]
        self.pulls = [np.zeros((*shape, 3)) for shape in shapes]

    @property
    def mu(self) -> float:
        return self.contact.friction

    def remember(self, x: Array, hints: Sequence[Array] = ()) -> None:
        # whatever the penalty is, which may grow from 0
        unit = [(np.ones_like(p.eps), np.zeros_like(p.multiplier)) for p in self.patches]
        self.last_gaps = [
            np.where(points[..., TRACTION] > 0, points[..., GAP], 0.0)
            for points in self._hits(x, hints, unit)
        ]
        self.past = x
        self._set_reference(x)

    def _set_reference(self, x: Array) -> None:
        """Take positions x (n_points, 3) as those that slips are measured from."""
        for p, before in zip(self.patches, self.before, strict=True):
            friction_kernels.remember(x, p.facets, p.N, p.dN, before)

    def forget(self, x: Array) -> None:
        super().forget(x)
        self._set_reference(x)
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
            p.multiplier = points[..., TRACTION] / np.maximum(points[..., WEIGHT], 1e-300)
            pull[:] = np.where(touches[..., None], points[..., PUSH : PUSH + 3], 0.0)

    def _sum_of_squares(self, found: Sequence[Array]) -> float:
        total = 0.0
        for p, points, pull in zip(self.patches, found, self.pulls, strict=True):
            squares = np.where(points[..., STICKS] > 0, (pull**2).sum(axis=-1), p.multiplier**2)
            total += float(squares.sum())
        return total

    def _largest_gap(self, found: Sequence[Array]) -> float:
        """Of sticking points with what they slipped."""
        largest = 0.0
        for points in found:
            sticks, touches = points[..., STICKS] > 0, points[..., TRACTION] > 0
            apart = np.where(sticks, points[..., APART], abs(points[..., GAP]))
            largest = max(largest, float(apart[touches].max(initial=0.0)))
        return largest

    def search(
        self, x: Array, hints: Sequence[Array] = (), earlier: Sequence[Array] = ()
    ) -> tuple[tuple[Array, ...], int]:
        found, n_touching = super().search(x, hints)
        for k, (p, points) in enumerate(zip(self.patches, found, strict=True)):
            old = earlier[k] if earlier else np.zeros((0, *points.shape[1:]))
            friction_kernels.resist(
                x, p.facets, p.N, p.dN, p.eps, points, self.facets2, *self._further(k), old
            )
        return found, n_touching

    def blocks(
        self, k: int, points: Array, x: Array, *, full: bool, couples: bool = True
    ) -> tuple[Array, Array]:
        out, arguments = self._room(k), self._arguments(k, points, x, full)
        return out, self.kernels.blocks(*arguments, out, *self._further(k), float(couples))

    def both_blocks(
        self, k: int, points: Array, x: Array, *, full: bool, couples: bool = True
    ) -> tuple[IntArray, Array]:
        """Of every two facets that meet: nodes (n_facet_pairs, n; -1: none), those of the primary one first,
        and tangent (n_facet_pairs, n, 3, n, 3)."""
        facets = self.patches[k].facets
        touching = points[..., TRACTION] != 0
        meeting = np.stack([np.nonzero(touching)[0], points[touching][:, FACET].astype(np.int64)])
        met, number = np.unique(meeting, axis=1, return_inverse=True)
        which = np.full(touching.shape, -1)
        which[touching] = number.ravel()
        nodes = np.full((met.shape[1], facets.shape[1] + MOST_NODES), -1)
        nodes[:, : facets.shape[1]] = facets[met[0]]
        nodes[:, facets.shape[1] : facets.shape[1] + self.facets2.shape[1]] = self.facets2[met[1]]
        out = np.zeros((len(nodes), nodes.shape[1], 3, nodes.shape[1], 3))
        arguments = self._arguments(k, points, x, full)
        friction_kernels.both_blocks(*arguments, which, out, *self._further(k), float(couples))
        return nodes, out

    def _further(self, k: int) -> tuple[Any, ...]:
        return self.mu, self.before[k], self.past, self.pulls[k]
