"""Compiled loops on a triangle surface: who meets whom, edge collapses and flips."""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.numbers.compiled import njit


@njit
def bucketed(keys: Any, n: int) -> Any:
    """Stable order of keys (0 to n - 1), and where each key's begin in it (n + 1): a sort in linear time."""
    start = np.zeros(n + 1, np.int64)
    for key in keys:
        start[key + 1] += 1
    for k in range(n):
        start[k + 1] += start[k]
    at, order = start.copy(), np.empty(len(keys), np.int64)
    for k in range(len(keys)):
        order[at[keys[k]]] = k
        at[keys[k]] += 1
    return order, start


@njit
def sort_within(order: Any, start: Any, keys: Any) -> None:
    """Sort each bucket of `bucketed` by further keys, stably and in place; buckets are short."""
    for b in range(len(start) - 1):
        for k in range(start[b] + 1, start[b + 1]):
            moved, m = order[k], k
            while m > start[b] and keys[order[m - 1]] > keys[moved]:
                order[m] = order[m - 1]
                m -= 1
            order[m] = moved


@njit
def _normal(a: Any, b: Any, c: Any, out: Any) -> float:
    u0, u1, u2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    v0, v1, v2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    out[0], out[1], out[2] = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    return np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)


@njit
def _distance(a: Any, b: Any) -> float:
    return np.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@njit
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


@njit
def _may_move(
    x: Any, faces: Any, around: Any, start: Any, v: int, other: int, to: Any, longest: float
) -> bool:
    """Whether node v may be moved to `to`; the faces that it shares with `other` vanish."""
    old, new = np.empty(3), np.empty(3)
    p = np.empty((3, 3))
    for k in range(start[v], start[v + 1]):
        face = faces[around[k]]
        if face[0] == other or face[1] == other or face[2] == other:
            continue
        for m in range(3):
            node = face[m]
            for i in range(3):
                p[m, i] = to[i] if node == v else x[node, i]
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


@njit
def collapse_edges(
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
            u, v = v, u  # v is removed, u stays
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
        for m in range(3):
            x[u, m] = to[m]
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


@njit
def _angle(a: Any, b: Any, c: Any) -> float:
    """Angle at vertex a."""
    u, v = _distance(a, b), _distance(a, c)
    dot = 0.0
    for m in range(3):
        dot += (b[m] - a[m]) * (c[m] - a[m])
    return np.arccos(min(1.0, max(-1.0, dot / max(u * v, 1e-30))))


@njit
def flip_edges(x: Any, faces: Any, edges: Any, sides: Any, around: Any, start: Any) -> int:
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
