"""Contact of two surfaces, the primary one soft: FEBio's frictionless `sliding-elastic` law.

The compiled loops, and the law itself, are in `contact_kernels`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from limbcli.fem.contacts import contact_kernels as kernels
from limbcli.fem.contacts.contact_points import FACET, GAP, N_STATE, TRACTION, WEIGHT
from limbcli.fem.contacts.contact_search import search
from limbcli.fem.contacts.facet_tree import FacetTree
from limbcli.fem.contacts.patch import Patch
from limbcli.fem.contacts.penalty import penalties
from limbcli.fem.elements.assembly import Threads
from limbcli.fem.elements.groups import Group
from limbcli.materials.program import CurveAt
from limbcli.model import Array, IntArray
from limbcli.model.bodies import Contact

_MOST_AUGMENTATIONS = 10  # FEBio's default of `maxaug`
# Half-width of the fading zone at a rim, as a fraction of the soft facets' size, and its upper limit as a
# fraction of the secondary facet's size.
_FADE, _MOST_FADE = 0.03, 0.2


@dataclass(eq=False)
class Pair:
    """One contact of the model: soft patches, the primary side, against the facets of the secondary side.

    facets2 (n_facets2, 4 or 6) : see `contact_points`
    rim (n_facets2, 4) : half-widths of the fading zones at the free edges of that surface (`rim_widths`)
    tree : of `facets2`
    body : number of the rigid body that the secondary side is part of; None: it is soft
    past (n_points, 3) : positions of all nodes at the last converged step
    last_gaps : of each patch, the gaps (n_facets, n_gauss) then, 0 where the point did not touch; infinite
        before the first step, and without friction, where tractions fade at a rim
    full_eps, factor : penalties (n_facets,) of the patches, MPa/mm, before their load curve, and its value
    looseness : value of the load curve of the gap's tolerance
    """

    n_columns: ClassVar[int] = N_STATE  # of the state of a point
    kernels: ClassVar[ModuleType] = kernels

    contact: Contact
    facets2: IntArray
    patches: list[Patch]
    rim: Array
    tree: FacetTree
    body: int | None
    past: Array
    last_gaps: list[Array] = field(init=False)
    full_eps: list[Array] = field(default_factory=list, kw_only=True)
    factor: float = field(default=1.0, kw_only=True)
    looseness: float = field(default=1.0, kw_only=True)
    threads: Threads = field(default_factory=lambda: Threads(1), kw_only=True)

    def __post_init__(self) -> None:
        self.last_gaps = [np.full(p.multiplier.shape, np.inf) for p in self.patches]

    def search(
        self, x: Array, hints: Sequence[Array] = (), earlier: Sequence[Array] = ()
    ) -> tuple[tuple[Array, ...], int]:
        """Search contact at positions x (n_points, 3) of all nodes.

        hints : the secondary facet (-1: none) with which the search begins at each point of each patch
        earlier : state of the points of each patch in the iteration before, which friction's tangent follows

        Returns the state of the points of each patch, and how many touch.
        """
        found = self._hits(x, hints, [(p.eps, p.multiplier) for p in self.patches])
        return tuple(found), sum(int((points[..., TRACTION] > 0).sum()) for points in found)

    def _hits(self, x: Array, hints: Sequence[Array], laws: Sequence[tuple[Array, Array]]) -> list[Array]:
        """State of the points of each patch, with its penalty and multiplier from `laws`."""
        tree = (*self.tree.spheres(x), self.tree.order, self.tree.starts)
        found = []
        for k, p in enumerate(self.patches):
            points = np.zeros((len(p.facets), len(p.weights), self.n_columns))
            points[..., FACET] = hints[k] if hints else -1
            task = partial(self._search, k, laws[k], points, x, tree)
            self.threads.run(task, len(p.facets))
            found.append(points)
        return found

    def _search(
        self,
        k: int,
        law: tuple[Array, Array],
        points: Array,
        x: Array,
        tree: tuple[Array, Array, IntArray, IntArray],
        worker: int,
        begin: int,
        end: int,
    ) -> int:
        c, p = self.contact, self.patches[k]
        found = search(
            begin, end, x, p.facets, p.N, p.dN, self.facets2, self.rim, tree,
            c.search_radius, c.search_tolerance, *law, self.past, self.last_gaps[k], points,
        )  # fmt: skip
        return int(found)

    def force(self, found: Sequence[Array], out: Array) -> None:
        """out (n_points, 3) += contact part of the residual, of the nodes on both sides.

        found : state of the points of each patch, as of `search`
        """
        for p, points in zip(self.patches, found, strict=True):
            self.kernels.force(p.facets, p.N, p.weights, points, self.facets2, out)

    def times(self, found: Sequence[Array], x: Array, v: Array, out: Array, *, full: bool) -> None:
        """Derivative of `force` along v (n_points, 3), of the nodes on both sides.

        full : exact (see `ContactState.full_tangent`)
        """
        for k, points in enumerate(found):
            self.kernels.times(*self._arguments(k, points, x, full), v, out, *self._further(k))

    def blocks(
        self, k: int, points: Array, x: Array, *, full: bool, couples: bool = True
    ) -> tuple[Array, Array]:
        """Tangent of the facets of patch k alone (n_facets, n, 3, n, 3), and which facets touch.

        couples : False leaves out that the shear of a slip follows the pressure
        """
        out = self._room(k)
        arguments = self._arguments(k, points, x, full)[:-1]
        return out, self.kernels.blocks(*arguments, out)

    def _room(self, k: int) -> Array:
        n_facets, n = self.patches[k].facets.shape
        return np.empty((n_facets, n, 3, n, 3))

    def _arguments(self, k: int, points: Array, x: Array, full: bool) -> tuple[Any, ...]:
        p = self.patches[k]
        return x, p.facets, p.N, p.dN, p.weights, p.eps, points, float(full), self.facets2

    def _further(self, k: int) -> tuple[Any, ...]:
        """Further arguments of the kernels for patch k."""
        return ()

    def remember(self, x: Array, hints: Sequence[Array] = ()) -> None:
        """Store a converged step as the reference for the next one; nothing to store without friction.

        hints : as in `search`
        """

    def set_penalty(self, groups: Sequence[Group], curve: CurveAt, dt: float) -> None:
        self.full_eps = [penalties(self.contact, p, groups, curve, dt) for p in self.patches]
        self.scale_penalty(self.factor)

    def scale_penalty(self, factor: float) -> None:
        """Multiply the penalties by the value of their load curve."""
        self.factor = factor
        for p, full in zip(self.patches, self.full_eps, strict=False):
            p.eps = factor * full

    def forget(self, x: Array) -> None:
        """Reset to the unloaded state at positions x (n_points, 3): no contact, multipliers zero."""
        for p, gaps in zip(self.patches, self.last_gaps, strict=True):
            p.multiplier[:] = 0.0
            gaps[:] = np.inf
        self.past = x

    def multipliers(self) -> list[tuple[Array, ...]]:
        """Copies of the multipliers of each patch, for `set_multipliers`."""
        return [(p.multiplier.copy(),) for p in self.patches]

    def set_multipliers(self, found: Sequence[tuple[Array, ...]]) -> None:
        for p, (pressure, *_) in zip(self.patches, found, strict=True):
            p.multiplier = pressure.copy()

    def augment(self, found: Sequence[Array], n_before: int) -> bool:
        """Set the multipliers to the current tractions; returns whether they have converged.

        Convergence requires that the relative change of their sum of squares is within the tolerance, and
        that the largest gap of points in contact is within `gap_tolerance` (mm), each if set; not before
        `minaug` augmentations of a load step, and unconditionally after `maxaug`.

        found : state of the points of each patch at the equilibrium
        n_before : augmentations of this load step so far

        Source: FEBio 4.11, FESlidingElasticInterface::Augment.
        """
        before = self._sum_of_squares(found)
        self._augment(found)
        after = self._sum_of_squares(found)
        contact = self.contact
        if n_before >= _count(contact, "maxaug", _MOST_AUGMENTATIONS):
            return True
        if n_before < _count(contact, "minaug", 0):
            return False
        most = contact.gap_tolerance * self.looseness
        closed = contact.gap_tolerance <= 0 or self._largest_gap(found) <= most
        settled = contact.tolerance <= 0 or abs(after - before) <= contact.tolerance * (after or 1.0)
        return closed and settled

    def _augment(self, found: Sequence[Array]) -> None:
        for p, points in zip(self.patches, found, strict=True):
            p.multiplier = points[..., TRACTION] / np.maximum(points[..., WEIGHT], 1e-300)

    def _sum_of_squares(self, found: Sequence[Array]) -> float:
        return sum(float((p.multiplier**2).sum()) for p in self.patches)

    def _largest_gap(self, found: Sequence[Array]) -> float:
        return max(float(abs(points[points[..., TRACTION] > 0, GAP]).max(initial=0.0)) for points in found)


def _count(contact: Contact, name: str, default: int) -> int:
    return int(float(contact.more.get(name, default)))


def rim_widths(points: Array, facets2: IntArray, patches: Sequence[Patch]) -> Array:
    """Half-widths (n, 4) of the fading zones at free edges, those that belong to a single secondary facet.

    In the facet's natural coordinates; 0 at other edges. Edge k goes from node k to the next node.

    facets2 (n, 4 or 6) : see `contact_points`
    """
    curved = facets2[:, 3] >= 0 if facets2.shape[1] > 4 else np.zeros(len(facets2), dtype=bool)
    curved &= facets2[:, -1] >= 0
    facets2 = facets2[:, :4].copy()
    facets2[curved, 3] = -1
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
