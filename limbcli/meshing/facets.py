"""Edge splits, collapses, flips and smoothing on a labelled triangle surface.

These are the four local operations of isotropic remeshing (after Botsch and Kobbelt, "A remeshing approach to
multiresolution modeling", SGP 2004), here towards an edge length that varies over the surface. Edges between
faces of different labels are features: nodes on them move and merge only along them.
"""

from __future__ import annotations

import numpy as np

from limbcli.meshing.facet_kernels import bucketed, collapse_edges, flip_edges, sort_within
from limbcli.meshing.surfaces import Triangles, undirected
from limbcli.model import Array, IntArray

_LONG, _SHORT = 1.35, 0.78  # fractions of the target length: longer edges are split, shorter ones collapsed
_ROUNDS = 60  # greatest number of rounds in which nodes are put back where they were


def edges_of(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Unique edges (n, 2) and the two faces (n, 2) at each, of a closed surface."""
    ends = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(*ends), np.maximum(*ends)
    order, start = bucketed(low, int(faces.max(initial=-1)) + 1)
    sort_within(order, start, high)
    return np.stack([low[order[::2]], high[order[::2]]], axis=1), (order // 3).reshape(-1, 2)


def faces_round(faces: IntArray, n_points: int) -> tuple[IntArray, IntArray]:
    """The faces around each node, concatenated, and the offset at which each node's begin (n_points + 1)."""
    order, start = bucketed(faces.ravel(), n_points)
    return order // 3, start


def split_long(
    points: Array, faces: IntArray, labels: IntArray, wanted: Array
) -> tuple[Array, IntArray, IntArray]:
    """Halve edges longer than 1.35 times the target length (n_points,), and split the faces at them."""
    edges, sides = edges_of(faces)
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    long = length > _LONG * wanted[edges].mean(axis=1)
    if not long.any():
        return points, faces, labels
    middle = np.full(len(edges), -1)
    middle[long] = len(points) + np.arange(int(long.sum()))
    added = points[edges[long]].mean(axis=1)
    of_face = np.full((len(faces), 3), -1)
    for side in sides.T:
        for corner in range(3):
            pair = np.sort(faces[side][:, [corner, (corner + 1) % 3]], axis=1)
            same = (pair == edges).all(axis=1)
            of_face[side[same], corner] = middle[same]
    new_faces, parent = _divide(faces, of_face)
    return np.vstack([points, added]), new_faces, labels[parent]


def divided(points: Array, faces: IntArray, longest: float) -> tuple[Array, IntArray]:
    """Halve the edges of any triangles until none is longer than `longest` (mm); the shape does not change.

    >>> wedge = np.array([[0.0, 0, 0], [40, 0, 0], [0, 9, 0]])
    >>> points, faces = divided(wedge, np.array([[0, 1, 2]]), 12.0)
    >>> bool(np.linalg.norm(points[faces] - points[np.roll(faces, 1, axis=1)], axis=2).max() <= 12.0)
    True
    """
    while True:
        pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        _, first, number = np.unique(undirected(pairs), return_index=True, return_inverse=True)
        edges = pairs[first]
        long = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1) > longest
        if not long.any():
            return points, faces
        middle = np.full(len(edges), -1)
        middle[long] = len(points) + np.arange(int(long.sum()))
        points = np.vstack([points, points[edges[long]].mean(axis=1)])
        faces, _ = _divide(faces, middle[number].reshape(-1, 3))


def _divide(faces: IntArray, middle: IntArray) -> tuple[IntArray, IntArray]:
    """Faces split at the midpoints (-1: none) of their edges 01, 12, 20; and the parent of each piece."""
    count = (middle >= 0).sum(axis=1)
    pieces, parents = [faces[count == 0]], [np.flatnonzero(count == 0)]
    for turn in range(3):
        f, m = np.roll(faces, -turn, axis=1), np.roll(middle, -turn, axis=1)
        one = np.flatnonzero((count == 1) & (m[:, 0] >= 0))
        a, b, c, p = f[one, 0], f[one, 1], f[one, 2], m[one, 0]
        pieces += [np.c_[a, p, c], np.c_[p, b, c]]
        parents += [one, one]
        two = np.flatnonzero((count == 2) & (m[:, 2] < 0))
        a, b, c, p, q = f[two, 0], f[two, 1], f[two, 2], m[two, 0], m[two, 1]
        pieces += [np.c_[p, b, q], np.c_[a, p, q], np.c_[a, q, c]]
        parents += [two, two, two]
    three = np.flatnonzero(count == 3)
    a, b, c = faces[three].T
    p, q, r = middle[three].T
    pieces += [np.c_[a, p, r], np.c_[p, b, q], np.c_[r, q, c], np.c_[p, q, r]]
    parents += [three] * 4
    return np.vstack(pieces).astype(np.int64), np.concatenate(parents)


def collapse_short(
    points: Array, faces: IntArray, labels: IntArray, ranks: IntArray, wanted: Array
) -> tuple[Array, IntArray, IntArray, int]:
    """Collapse edges shorter than 0.78 of the target length; also returns their number.

    ranks (n_points,): 1 inside a label, 2 on a feature, 3 where features meet.
    """
    edges, sides = edges_of(faces)
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    ratio = length / wanted[edges].mean(axis=1)
    short = np.flatnonzero(ratio < _SHORT)
    short = short[np.argsort(ratio[short], kind="stable")]
    feature = labels[sides[:, 0]] != labels[sides[:, 1]]
    around, start = faces_round(faces, len(points))
    x, f = points.copy(), faces.copy()
    n = collapse_edges(x, f, edges[short], feature[short], ranks, wanted, around, start)
    kept = f[:, 0] >= 0
    used = np.zeros(len(x), bool)
    used[f[kept]] = True
    return x[used], (np.cumsum(used) - 1)[f[kept]], labels[kept], n


def flip(points: Array, faces: IntArray, labels: IntArray) -> tuple[IntArray, int]:
    """Flip inner edges whose two opposite angles add up to more than 180 degrees."""
    edges, sides = edges_of(faces)
    inner = labels[sides[:, 0]] == labels[sides[:, 1]]
    around, start = faces_round(faces, len(points))
    f = faces.copy()
    n = flip_edges(points, f, edges[inner], sides[inner], around, start)
    return f, n


def relax(points: Array, faces: IntArray, labels: IntArray, ranks: IntArray, wanted: Array) -> Array:
    """Move nodes to equalise the ratio of area to target area; nodes on features move along them."""
    a, b, c = points[faces[:, 0]], points[faces[:, 1]], points[faces[:, 2]]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / wanted[faces].mean(axis=1) ** 2
    total, weight = np.zeros_like(points), np.zeros(len(points))
    middle = (a + b + c) / 3
    for corner in faces.T:
        np.add.at(total, corner, area[:, None] * middle)
        np.add.at(weight, corner, area)
    out = np.where((ranks == 1)[:, None], total / np.maximum(weight, 1e-12)[:, None], points)
    edges, sides = edges_of(faces)
    feature = edges[labels[sides[:, 0]] != labels[sides[:, 1]]]
    total, count = neighbour_sums(points, feature)
    along = (ranks == 2) & (count == 2)
    out[along] = 0.5 * points[along] + 0.5 * total[along] / 2
    return points + 0.7 * (out - points)


def neighbour_sums(points: Array, edges: IntArray) -> tuple[Array, Array]:
    """Sum (n, 3) of each node's neighbours along the edges (m, 2), and their number (n,)."""
    total, count = np.zeros_like(points), np.zeros(len(points))
    for p, q in (edges.T, edges.T[::-1]):
        np.add.at(total, p, points[q])
        np.add.at(count, p, 1)
    return total, count


def keep_unfolded(before: Array, after: Array, faces: IntArray) -> Array:
    """`after`, except that nodes whose faces would be inverted or collapse stay at `before`."""
    x = after.copy()
    old = Triangles(before, faces).area_vectors
    size = np.linalg.norm(old, axis=1)
    for _ in range(_ROUNDS):
        new = Triangles(x, faces).area_vectors
        fit = np.einsum("ij,ij->i", old, new) > 0.3 * size * np.linalg.norm(new, axis=1)
        fit &= np.linalg.norm(new, axis=1) > 0.1 * size
        if fit.all():
            return x
        bad = np.unique(faces[~fit])
        if (x[bad] == before[bad]).all():
            return x
        x[bad] = before[bad]
    return x
