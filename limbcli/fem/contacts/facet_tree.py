"""A tree of spheres around the facets of a surface, so that a search looks at few of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from limbcli.model import Array, IntArray
from limbcli.numbers.compiled import njit

_MOST_IN_LEAF = 8  # facets


@dataclass(frozen=True, eq=False)
class FacetTree:
    """A balanced binary tree; nodes 2 k + 1 and 2 k + 2 are the halves of node k, the leaves come last.

    nodes (n, 4 or 6) : of the facets, see `contact_points`
    order (n,) : the facets, sorted so that those of a leaf follow each other
    starts (n_leaves + 1,) : where in `order` each leaf begins
    """

    nodes: IntArray
    order: IntArray
    starts: IntArray

    @classmethod
    def of(cls, points: Array, nodes: IntArray) -> FacetTree:
        """Facets that lie close together at `points` (n_points, 3) share leaves."""
        order = np.asarray(cKDTree(_corners(points, nodes).mean(axis=1)).indices, dtype=np.int64)
        n_leaves = 1
        while len(nodes) > _MOST_IN_LEAF * n_leaves:
            n_leaves *= 2
        return cls(nodes, order, len(nodes) * np.arange(n_leaves + 1) // n_leaves)

    def spheres(self, x: Array) -> tuple[Array, Array]:
        """Centres and radii around each facet (n, 4) and each node of the tree (n_nodes, 4) at positions x
        (n_points, 3)."""
        corners = _corners(x, self.nodes)
        center = corners.mean(axis=1)
        reach = np.linalg.norm(corners - center[:, None], axis=2).max(axis=1) * 1.05
        low = np.minimum.reduceat((center - reach[:, None])[self.order], self.starts[:-1])
        high = np.maximum.reduceat((center + reach[:, None])[self.order], self.starts[:-1])
        levels = [(low, high)]
        while len(low) > 1:
            low, high = np.minimum(low[::2], low[1::2]), np.maximum(high[::2], high[1::2])
            levels.append((low, high))
        low, high = (np.concatenate(each) for each in zip(*levels[::-1], strict=True))
        around = np.linalg.norm(high - low, axis=1, keepdims=True) / 2.0
        return np.column_stack([center, reach]), np.column_stack([(low + high) / 2.0, around])


def _corners(points: Array, nodes: IntArray) -> Array:
    return points[np.where(nodes < 0, nodes[:, :1], nodes)]


@njit
def _passes(sphere, r, nu, radius):
    """Whether the line r + s nu, |s| <= radius + the sphere's, passes a sphere."""
    d2, along = 0.0, 0.0
    for i in range(3):
        d = sphere[i] - r[i]
        d2 += d * d
        along += d * nu[i]
    return d2 - along * along <= sphere[3] * sphere[3] and abs(along) <= radius + sphere[3]


@njit
def facets_on_line(r, nu, radius, spheres, around, order, starts, found):
    """Fill `found` (n_facets,) with the facets whose spheres the line r + s nu passes, in their order.

    radius : distance from r up to which spheres count
    spheres, around, order, starts : see `FacetTree`

    Returns how many there are.
    """
    first_leaf = starts.shape[0] - 2
    waiting = np.empty(64, dtype=np.int64)
    waiting[0], n_waiting, n = 0, 1, 0
    while n_waiting > 0:
        n_waiting -= 1
        k = waiting[n_waiting]
        # the spheres within may reach as much farther as this one is large
        if not _passes(around[k], r, nu, radius + around[k, 3]):
            continue
        if k < first_leaf:
            waiting[n_waiting], waiting[n_waiting + 1] = 2 * k + 1, 2 * k + 2
            n_waiting += 2
            continue
        for place in range(starts[k - first_leaf], starts[k - first_leaf + 1]):
            if _passes(spheres[order[place]], r, nu, radius):
                later = n
                while later > 0 and found[later - 1] > order[place]:
                    found[later] = found[later - 1]
                    later -= 1
                found[later] = order[place]
                n += 1
    return n
