"""Edge splits, collapses, flips and smoothing on a labelled triangle surface.

The four local operations of isotropic remeshing (after Botsch and Kobbelt, "A
remeshing approach to multiresolution modeling", SGP 2004) towards an edge length
that varies over the surface. Edges between faces of different labels are
features: nodes on them move and merge along them only.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from limbcli.model import Array, IntArray

_LONG, _SHORT = 1.35, 0.78  # of the wanted length: edges above are split, below collapsed


def edges_of(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Unique edges (n, 2) and the two faces (n, 2) at each, of a closed surface."""
    pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    key = pairs[:, 0] * (int(faces.max()) + 1) + pairs[:, 1]
    order = np.argsort(key, kind="stable")
    return pairs[order[::2]], (order // 3).reshape(-1, 2)


def faces_round(faces: IntArray, n_points: int) -> tuple[IntArray, IntArray]:
    """The faces at each node, one after the other, and where each node's begin (n_points + 1)."""
    flat = faces.ravel()
    order = np.argsort(flat, kind="stable")
    start = np.searchsorted(flat[order], np.arange(n_points + 1))
    return order // 3, start


def split_long(
    points: Array, faces: IntArray, labels: IntArray, wanted: Array
) -> tuple[Array, IntArray, IntArray]:
    """Edges longer than 1.35 times the wanted length (n_points,) halved; the faces at them with them."""
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


def _divide(faces: IntArray, middle: IntArray) -> tuple[IntArray, IntArray]:
    """Faces cut at the middles (-1: none) of their edges 01, 12, 20; and each piece's parent."""
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
    """Edges shorter than 0.78 of the wanted length merged; returns how many.

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
    n = _collapse(x, f, edges[short], feature[short], ranks, wanted, around, start)
    kept = f[:, 0] >= 0
    used, inverse = np.unique(f[kept], return_inverse=True)
    return x[used], inverse.reshape(-1, 3).astype(np.int64), labels[kept], n


def flip(points: Array, faces: IntArray, labels: IntArray) -> tuple[IntArray, int]:
    """Inner edges turned where the two angles opposite to them add up to more than 180 degrees."""
    edges, sides = edges_of(faces)
    inner = labels[sides[:, 0]] == labels[sides[:, 1]]
    around, start = faces_round(faces, len(points))
    f = faces.copy()
    n = _flip(points, f, edges[inner], sides[inner], around, start)
    return f, n


def relax(points: Array, faces: IntArray, labels: IntArray, ranks: IntArray, wanted: Array) -> Array:
    """Nodes moved to even out area over wanted area; on features along them."""
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
    total, count = np.zeros_like(points), np.zeros(len(points))
    for p, q in (feature.T, feature.T[::-1]):
        np.add.at(total, p, points[q])
        np.add.at(count, p, 1)
    along = (ranks == 2) & (count == 2)
    out[along] = 0.5 * points[along] + 0.5 * total[along] / 2
    return points + 0.7 * (out - points)


def area_vectors(points: Array, faces: IntArray) -> Array:
    a, b, c = points[faces[:, 0]], points[faces[:, 1]], points[faces[:, 2]]
    return 0.5 * np.cross(b - a, c - a)


def keep_unfolded(before: Array, after: Array, faces: IntArray, *, rounds: int = 60) -> Array:
    """`after`, but nodes whose faces would turn over or shrink to nothing stay as `before`."""
    x = after.copy()
    old = area_vectors(before, faces)
    size = np.linalg.norm(old, axis=1)
    for _ in range(rounds):
        new = area_vectors(x, faces)
        fit = np.einsum("ij,ij->i", old, new) > 0.3 * size * np.linalg.norm(new, axis=1)
        fit &= np.linalg.norm(new, axis=1) > 0.1 * size
        if fit.all():
            return x
        bad = np.unique(faces[~fit])
        if (x[bad] == before[bad]).all():
            return x
        x[bad] = before[bad]
    return x


# ---------------------------------------------------------------- kernels


@njit(cache=True)
def _normal(a: Any, b: Any, c: Any, out: Any) -> float:
    u0, u1, u2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    v0, v1, v2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    out[0], out[1], out[2] = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    return np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)


@njit(cache=True)
def _distance(a: Any, b: Any) -> float:
    return np.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@njit(cache=True)
def _common(faces: Any, around: Any, start: Any, u: int, v: int, mark: Any, stamp: int) -> int:
    """Number of neighbours that nodes u and v share."""
    for k in range(start[u], start[u + 1]):
        for m in range(3):
            mark[faces[around[k], m]] = stamp
    count = 0
    for k in range(start[v], start[v + 1]):
        for m in range(3):
            w = faces[around[k], m]
            if w != u and w != v and mark[w] == stamp:
                mark[w] = 0
                count += 1
    return count


@njit(cache=True)
def _may_move(
    x: Any, faces: Any, around: Any, start: Any, v: int, other: int, to: Any, longest: float
) -> bool:
    """Whether node v may go to `to` (the faces it shares with `other` vanish)."""
    old, new = np.empty(3), np.empty(3)
    p = np.empty((3, 3))
    for k in range(start[v], start[v + 1]):
        face = faces[around[k]]
        if face[0] == other or face[1] == other or face[2] == other:
            continue
        for m in range(3):
            p[m] = to if face[m] == v else x[face[m]]
            if face[m] != v and _distance(to, x[face[m]]) > longest:
                return False
        before = _normal(x[face[0]], x[face[1]], x[face[2]], old)
        after = _normal(p[0], p[1], p[2], new)
        if old[0] * new[0] + old[1] * new[1] + old[2] * new[2] < 0.5 * before * after:
            return False
        side = max(_distance(p[0], p[1]), _distance(p[1], p[2]), _distance(p[2], p[0]))
        if after < 0.12 * side * side and after / (side * side) < 0.8 * before / (side * side):
            return False
    return True


@njit(cache=True)
def _collapse(
    x: Any, faces: Any, edges: Any, feature: Any, ranks: Any, wanted: Any, around: Any, start: Any
) -> int:
    n = len(x)
    locked = np.zeros(n, np.bool_)
    mark = np.zeros(n, np.int64)
    done = 0
    to = np.empty(3)
    for e in range(len(edges)):
        u, v = edges[e, 0], edges[e, 1]
        if locked[u] or locked[v]:
            continue
        if ranks[u] < ranks[v]:
            u, v = v, u  # v goes, u stays
        if ranks[v] >= 3 or (ranks[v] == 2 and not feature[e]):
            continue
        if _common(faces, around, start, u, v, mark, e + 1) != 2:
            continue
        if start[u + 1] - start[u] + start[v + 1] - start[v] > 20:
            continue
        share = 0.5 if ranks[u] == ranks[v] else 0.0
        for m in range(3):
            to[m] = (1 - share) * x[u, m] + share * x[v, m]
        longest = 1.3 * 0.5 * (wanted[u] + wanted[v])
        if not _may_move(x, faces, around, start, v, u, to, longest):
            continue
        if share > 0 and not _may_move(x, faces, around, start, u, v, to, longest):
            continue
        for node in (u, v):
            for k in range(start[node], start[node + 1]):
                for m in range(3):
                    locked[faces[around[k], m]] = True
        x[u] = to
        for k in range(start[v], start[v + 1]):
            face = faces[around[k]]
            if face[0] == u or face[1] == u or face[2] == u:
                face[:] = -1
            else:
                for m in range(3):
                    if face[m] == v:
                        face[m] = u
        done += 1
    return done


@njit(cache=True)
def _angle(a: Any, b: Any, c: Any) -> float:
    """Angle at a."""
    u, v = _distance(a, b), _distance(a, c)
    dot = 0.0
    for m in range(3):
        dot += (b[m] - a[m]) * (c[m] - a[m])
    return np.arccos(min(1.0, max(-1.0, dot / max(u * v, 1e-30))))


@njit(cache=True)
def _flip(x: Any, faces: Any, edges: Any, sides: Any, around: Any, start: Any) -> int:
    locked = np.zeros(len(x), np.bool_)
    done = 0
    n1, n2, m1, m2 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        f, g = sides[e, 0], sides[e, 1]
        c = faces[f, 0] + faces[f, 1] + faces[f, 2] - a - b
        d = faces[g, 0] + faces[g, 1] + faces[g, 2] - a - b
        if locked[a] or locked[b] or locked[c] or locked[d] or c == d:
            continue
        if _angle(x[c], x[a], x[b]) + _angle(x[d], x[a], x[b]) <= np.pi + 1e-3:
            continue
        joined = False
        for k in range(start[c], start[c + 1]):
            face = faces[around[k]]
            if face[0] == d or face[1] == d or face[2] == d:
                joined = True
        if joined or start[a + 1] - start[a] <= 3 or start[b + 1] - start[b] <= 3:
            continue
        # Face f runs a -> b -> c in one of the two senses.
        forward = False
        for m in range(3):
            if faces[f, m] == a and faces[f, (m + 1) % 3] == b:
                forward = True
        p, q = (a, b) if forward else (b, a)
        s1 = _normal(x[p], x[q], x[c], n1)
        s2 = _normal(x[q], x[p], x[d], n2)
        t1 = _normal(x[p], x[d], x[c], m1)
        t2 = _normal(x[d], x[q], x[c], m2)
        good = True
        for new, size in ((m1, t1), (m2, t2)):
            for old, was in ((n1, s1), (n2, s2)):
                dot = new[0] * old[0] + new[1] * old[1] + new[2] * old[2]
                if dot < 0.5 * size * was or size < 1e-12:
                    good = False
        if not good:
            continue
        faces[f, 0], faces[f, 1], faces[f, 2] = p, d, c
        faces[g, 0], faces[g, 1], faces[g, 2] = d, q, c
        locked[a] = locked[b] = locked[c] = locked[d] = True
        done += 1
    return done
