"""A soft surface against a rigid one: FEBio's frictionless `sliding-elastic` law.

The compiled loops, and the law itself, are in `contact_kernels`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from limbcli.fem.contacts import contact_kernels as kernels
from limbcli.fem.contacts.contact_points import FACET, GAP, TRACTION, WEIGHT
from limbcli.fem.contacts.contact_search import search
from limbcli.fem.contacts.patch import Patch
from limbcli.fem.contacts.penalty import penalties
from limbcli.fem.elements.assembly import Threads
from limbcli.fem.elements.groups import Group
from limbcli.fem.motion.rigid import BodyState
from limbcli.materials.program import CurveAt
from limbcli.model import Array, IntArray
from limbcli.model.bodies import Contact

_MOST_AUGMENTATIONS = 10  # FEBio's default of `maxaug`
# Half-width of the fading zone at a rim, as a fraction of the soft facets' size, and its upper limit as a
# fraction of the rigid facet's size.
_FADE, _MOST_FADE = 0.03, 0.2


@dataclass(eq=False)
class Pair:
    """One contact of the model: soft patches against the facets of a body.

    rim (n_facets2, 4) : half-widths of the fading zones at the free edges of the rigid surface (`rim_widths`)
    full_tangent : 1 for the exact tangent; 0 omits terms that are harmful far from equilibrium, where the
        tractions are many times too large: their change due to rotating normals, and with friction the
        zero stiffness along a slip
    full_eps, factor : penalties (n_facets,) of the patches, MPa/mm, before their load curve, and its value
    looseness : value of the load curve of the gap's tolerance
    used : the multipliers with which the last equilibrium was found, before `augment` set new ones
    """

    contact: Contact
    body: int
    facets2: IntArray
    patches: list[Patch]
    rim: Array
    full_tangent: float = field(default=1.0, kw_only=True)
    full_eps: list[Array] = field(default_factory=list, kw_only=True)
    factor: float = field(default=1.0, kw_only=True)
    looseness: float = field(default=1.0, kw_only=True)
    used: list[tuple[Array, ...]] = field(default_factory=list, kw_only=True)
    threads: Threads = field(default_factory=lambda: Threads(1), kw_only=True)

    def search(self, x: Array, at: BodyState) -> int:
        """Search contact at positions x (n_points, 3) with the body at `at`, and update the state of all
        points; returns how many touch."""
        spheres, box = _bounds(x, self.facets2)
        return sum(
            sum(self.threads.run(partial(self._search, p, x, spheres, box), len(p.facets)))
            for p in self.patches
        )

    def _search(
        self, p: Patch, x: Array, spheres: Array, box: Array, worker: int, begin: int, end: int
    ) -> int:
        c = self.contact
        found = search(
            begin, end, x, p.facets, p.N, p.dN, x, self.facets2, self.rim, spheres, box,
            c.search_radius, c.search_tolerance, p.eps, p.multiplier, p.state,
        )  # fmt: skip
        return int(found)

    def force(self, center: Array, out: Array, body: Array) -> None:
        for p in self.patches:
            kernels.force(p.facets, p.N, p.weights, p.state, center, out, body)

    def times(self, x: Array, center: Array, v: Array, motion: Array, out: Array, body: Array) -> None:
        for p in self.patches:
            kernels.times(
                x, p.facets, p.N, p.dN, p.weights, p.eps, p.state, self.full_tangent, center, v, motion,
                out, body,
            )  # fmt: skip

    def blocks(self, x: Array) -> list[tuple[Array, Array]]:
        """Tangent of each patch's facets (n_facets, n, 3, n, 3), and which facets touch."""
        found = []
        for p in self.patches:
            n = p.facets.shape[1]
            out = np.empty((len(p.facets), n, 3, n, 3))
            touched = kernels.blocks(
                x, p.facets, p.N, p.dN, p.weights, p.eps, p.state, self.full_tangent, out
            )
            found.append((out, touched))
        return found

    def remember(self, x: Array, at: BodyState) -> None:
        """Store a converged step; nothing to store without friction."""

    def set_penalty(self, groups: Sequence[Group], curve: CurveAt, dt: float) -> None:
        self.full_eps = [penalties(self.contact, p, groups, curve, dt) for p in self.patches]
        self.scale_penalty(self.factor)

    def scale_penalty(self, factor: float) -> None:
        """Multiply the penalties by the value of their load curve."""
        self.factor = factor
        for p, full in zip(self.patches, self.full_eps, strict=False):
            p.eps = factor * full

    def forget(self) -> None:
        """Reset to the unloaded state: no contact, multipliers zero."""
        for p in self.patches:
            p.state[:] = 0.0
            p.state[..., FACET] = -1
            p.multiplier[:] = 0.0
        self.used = []

    def multipliers(self) -> list[tuple[Array, ...]]:
        """Copies of the multipliers of each patch, for `set_multipliers`."""
        return [(p.multiplier.copy(),) for p in self.patches]

    def set_multipliers(self, found: Sequence[tuple[Array, ...]]) -> None:
        for p, (pressure, *_) in zip(self.patches, found, strict=True):
            p.multiplier = pressure.copy()

    @contextmanager
    def as_found(self) -> Iterator[None]:
        """As at the last equilibrium, before the augmentation that followed it."""
        after = self.multipliers()
        if self.used:
            self.set_multipliers(self.used)
        try:
            yield
        finally:
            self.set_multipliers(after)

    def augment(self, n_before: int) -> bool:
        """Set the multipliers to the current tractions; returns whether they have converged.

        Convergence requires that the relative change of their sum of squares is within the tolerance, and
        that the largest gap of points in contact is within `gap_tolerance` (mm), each if set; not before
        `minaug` augmentations of a load step, and unconditionally after `maxaug`.

        n_before : augmentations of this load step so far

        Source: FEBio 4.11, FESlidingElasticInterface::Augment.
        """
        self.used = self.multipliers()
        before = self._sum_of_squares()
        self._augment()
        after = self._sum_of_squares()
        contact = self.contact
        if n_before >= _count(contact, "maxaug", _MOST_AUGMENTATIONS):
            return True
        if n_before < _count(contact, "minaug", 0):
            return False
        closed = contact.gap_tolerance <= 0 or self._largest_gap() <= contact.gap_tolerance * self.looseness
        settled = contact.tolerance <= 0 or abs(after - before) <= contact.tolerance * (after or 1.0)
        return closed and settled

    def _augment(self) -> None:
        for p in self.patches:
            p.multiplier = p.state[..., TRACTION] / np.maximum(p.state[..., WEIGHT], 1e-300)

    def _sum_of_squares(self) -> float:
        return sum(float((p.multiplier**2).sum()) for p in self.patches)

    def _largest_gap(self) -> float:
        gaps = [abs(p.state[p.state[..., TRACTION] > 0, GAP]).max(initial=0.0) for p in self.patches]
        return float(max(gaps))


def _count(contact: Contact, name: str, default: int) -> int:
    return int(float(contact.more.get(name, default)))


def rim_widths(points: Array, facets2: IntArray, patches: Sequence[Patch]) -> Array:
    """Half-widths (n, 4) of the fading zones at free edges, those that belong to a single rigid facet.

    In the facet's natural coordinates; 0 at other edges. Edge k goes from node k to the next node.

    facets2 (n, 4) : nodes; the last is -1 in a triangle
    """
    following = np.roll(facets2, -1, axis=1)
    triangles = facets2[:, 3] < 0
    following[triangles, 2] = facets2[triangles, 0]
    there = np.ones(facets2.shape, dtype=bool)
    there[triangles, 3] = False
    ends = np.sort(np.stack([facets2, following], axis=2), axis=2)[there]
    _, which, counts = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    found = np.zeros(facets2.shape)
    found[there] = counts[which.ravel()] == 1
    a, b, c, d = (points[facets2[:, k]] for k in (0, 1, 2, 3))
    d[triangles] = a[triangles]
    area = 0.5 * np.linalg.norm(np.cross(c - a, d - b), axis=1)  # also valid for triangles
    length = np.linalg.norm(points[following] - points[facets2], axis=2)
    across = np.where(triangles, 2.0, 1.0)[:, None] * area[:, None] / np.maximum(length, 1e-300)
    soft = np.concatenate([np.sqrt(each.areas) for each in patches])
    part = np.minimum(_FADE * soft.mean() / np.maximum(across, 1e-300), _MOST_FADE)
    return np.asarray(found * part * np.where(triangles, 1.0, 2.0)[:, None])


def _bounds(x: Array, facets2: IntArray) -> tuple[Array, Array]:
    corners = x[np.where(facets2 < 0, facets2[:, :1], facets2)]
    center = corners.mean(axis=1)
    reach = np.linalg.norm(corners - center[:, None], axis=2).max(axis=1) * 1.05
    box = np.stack([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))])
    return np.concatenate([center, reach[:, None]], axis=1), box
