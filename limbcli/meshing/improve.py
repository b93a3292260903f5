"""Improve tetrahedra by moving nodes: interior nodes freely, boundary nodes along their surface.

Each node of a poor cell is moved to where the worst cell around it is best (optimisation-based smoothing,
after Freitag and Ollivier-Gooch, Int. J. Numer. Meth. Eng. 40, 1997). A cell's quality is the smallest sine
of its dihedral angles, negative if it is inverted, so both flat and needle-like cells count as poor. Boundary
nodes slide: after every trial they are projected back onto the distance field of the skin or bone and onto
the planes of the cuts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from limbcli.meshing.distance import Field
from limbcli.meshing.domain import TissueDomain
from limbcli.meshing.facet_kernels import bucketed
from limbcli.model import Array, IntArray
from limbcli.numbers.compiled import njit

FREE, FIXED = 0, -1
_DIRECTIONS = 14
_ON = 0.02  # mm: a boundary node this close to its surface counts as lying on it
_ROUNDS = 3  # of projections onto the surfaces of a point, one after the other


@dataclass(frozen=True, eq=False)
class NodeConstraints:
    """The surfaces each node must stay on: two columns of SKIN, BONE, CUT + k or FREE; FIXED: immobile."""

    codes: IntArray  # (n_points, 2)

    @staticmethod
    def of_faces(n_points: int, faces: IntArray, labels: IntArray) -> NodeConstraints:
        """Constraints from labelled boundary faces (m, 3); a node on three surfaces or more is fixed."""
        many = int(labels.max()) + 1 if len(labels) else 1
        met = np.zeros((n_points, many), bool)
        met[faces, labels[:, None]] = True
        pairs = np.argwhere(met)
        codes = np.zeros((n_points, 2), np.int64)
        count = np.bincount(pairs[:, 0], minlength=n_points)
        first = np.searchsorted(pairs[:, 0], np.arange(n_points))
        one, two = count >= 1, count == 2
        codes[one, 0] = pairs[first[one], 1]
        codes[two, 1] = pairs[first[two] + 1, 1]
        codes[count > 2, 0] = FIXED
        return NodeConstraints(codes)


class _Surfaces(NamedTuple):
    """The surfaces of a domain for the kernels.

    skin, bone : values on one grid, with its origin (3,) and spacing; planes (n, 4) : unit normals, offsets
    """

    skin: Array
    bone: Array
    origin: Array
    spacing: float
    planes: Array

    @staticmethod
    def of(domain: TissueDomain) -> _Surfaces:
        skin = domain.skin
        bone = domain.bone or Field(skin.grid, np.ones((2, 2, 2)))
        skin_values, bone_values = (np.ascontiguousarray(each.values, np.float64) for each in (skin, bone))
        planes = np.array([[*each.normal, each.offset] for each in domain.planes]).reshape(-1, 4)
        return _Surfaces(
            skin_values, bone_values, np.asarray(skin.grid.origin, float), float(skin.grid.spacing), planes
        )


def put_back(points: Array, constraints: NodeConstraints, domain: TissueDomain) -> Array:
    """Project boundary points onto the surfaces they belong to."""
    x = np.array(points, float)
    _put_all_back(x, constraints.codes, _Surfaces.of(domain), _ROUNDS)
    return x


def smooth(
    points: Array, cells: IntArray, constraints: NodeConstraints, domain: TissueDomain, *,
    goal_deg: float = 25.0, passes: int = 12,
) -> Array:  # fmt: skip
    """Move the nodes of cells with a dihedral angle below `goal_deg`, so that the worst cells improve."""
    corners = np.ascontiguousarray(cells[:, :4])
    order, start = bucketed(corners.ravel(), len(points))
    star = order // 4
    x = np.array(points, float)
    goal = float(np.sin(np.radians(goal_deg)))
    _smooth(x, corners, star, start, constraints.codes, _Surfaces.of(domain), goal, passes)
    return x


def worst_sines(points: Array, cells: IntArray) -> Array:
    """Smallest sine of the six dihedral angles of each cell, negative where inverted."""
    return _all_sines(np.ascontiguousarray(points), np.ascontiguousarray(cells[:, :4]))


# ---------------------------------------------------------------- kernels


@njit
def _sine(x: Any, t: Any) -> float:
    a, b, c, d = x[t[0]], x[t[1]], x[t[2]], x[t[3]]
    u0, u1, u2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    v0, v1, v2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    w0, w1, w2 = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    # Normals of the faces opposite to d, c, b and a.
    d0, d1, d2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    c0, c1, c2 = u1 * w2 - u2 * w1, u2 * w0 - u0 * w2, u0 * w1 - u1 * w0
    b0, b1, b2 = v1 * w2 - v2 * w1, v2 * w0 - v0 * w2, v0 * w1 - v1 * w0
    six = d0 * w0 + d1 * w1 + d2 * w2
    p0, p1, p2 = v0 - u0, v1 - u1, v2 - u2
    q0, q1, q2 = w0 - u0, w1 - u1, w2 - u2
    a0, a1, a2 = p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0
    fa = np.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
    fb = np.sqrt(b0 * b0 + b1 * b1 + b2 * b2)
    fc = np.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
    fd = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
    r0, r1, r2 = w0 - v0, w1 - v1, w2 - v2
    tiny = 1e-30
    s = np.sqrt(u0 * u0 + u1 * u1 + u2 * u2) / (fc * fd + tiny)
    s = min(s, np.sqrt(v0 * v0 + v1 * v1 + v2 * v2) / (fb * fd + tiny))
    s = min(s, np.sqrt(w0 * w0 + w1 * w1 + w2 * w2) / (fb * fc + tiny))
    s = min(s, np.sqrt(p0 * p0 + p1 * p1 + p2 * p2) / (fa * fd + tiny))
    s = min(s, np.sqrt(q0 * q0 + q1 * q1 + q2 * q2) / (fa * fc + tiny))
    s = min(s, np.sqrt(r0 * r0 + r1 * r1 + r2 * r2) / (fa * fb + tiny))
    if six <= 0:
        return six if six < 0 else -1e-30
    return six * s


@njit
def _all_sines(x: Any, cells: Any) -> Any:
    out = np.empty(len(cells))
    for k in range(len(cells)):
        out[k] = _sine(x, cells[k])
    return out


@njit
def _star_quality(x: Any, cells: Any, star: Any, first: int, last: int) -> float:
    worst = 1e30
    for k in range(first, last):
        s = _sine(x, cells[star[k]])
        if s < worst:
            worst = s
    return worst


@njit
def _sample(values: Any, origin: Any, spacing: float, p: Any, out: Any) -> float:
    """Trilinear interpolation at p; the gradient is written to `out`."""
    f = np.empty(3)
    n = np.empty(3, np.int64)
    for k in range(3):
        at = (p[k] - origin[k]) / spacing
        at = min(max(at, 0.0), values.shape[k] - 1.000001)
        n[k] = int(at)
        f[k] = at - n[k]
    i, j, m = n
    value = 0.0
    out[:] = 0.0
    for a in range(2):
        fa = f[0] if a else 1 - f[0]
        for b in range(2):
            fb = f[1] if b else 1 - f[1]
            for c in range(2):
                fc = f[2] if c else 1 - f[2]
                v = values[i + a, j + b, m + c]
                value += fa * fb * fc * v
                out[0] += (v if a else -v) * fb * fc
                out[1] += (v if b else -v) * fa * fc
                out[2] += (v if c else -v) * fa * fb
    out /= spacing
    return value


@njit
def _from_skin_or_bone(p: Any, code: int, surfaces: Any, g: Any) -> float:
    """Distance (mm) of p from the skin (`code` 1) or bone; its gradient is written to g."""
    values = surfaces.skin if code == 1 else surfaces.bone
    return _sample(values, surfaces.origin, surfaces.spacing, p, g)


@njit
def _to_surface(p: Any, code: int, surfaces: Any, g: Any) -> None:
    """One Newton step of p onto the surface given by `code`; its unit normal there is written to g."""
    if code >= 3:
        normal = surfaces.planes[code - 3]
        height = p[0] * normal[0] + p[1] * normal[1] + p[2] * normal[2] - normal[3]
        for k in range(3):
            g[k] = normal[k]
            p[k] -= height * normal[k]
        return
    value = _from_skin_or_bone(p, code, surfaces, g)
    square = max(g[0] * g[0] + g[1] * g[1] + g[2] * g[2], 0.05)
    step = min(max(value / square, -2.0), 2.0)
    size = np.sqrt(square)
    for k in range(3):
        p[k] -= step * g[k]
        g[k] /= size


@njit
def _put_back(p: Any, codes: Any, surfaces: Any, rounds: int, g: Any) -> None:
    for _ in range(rounds):
        for each in range(2):
            if codes[each] > 0:
                _to_surface(p, codes[each], surfaces, g)


@njit
def _off_surface(p: Any, codes: Any, surfaces: Any, g: Any) -> float:
    """Largest distance (mm) of p from the surfaces it should lie on."""
    worst = 0.0
    for each in range(2):
        code = codes[each]
        if code >= 3:
            n = surfaces.planes[code - 3]
            worst = max(worst, abs(p[0] * n[0] + p[1] * n[1] + p[2] * n[2] - n[3]))
        elif code > 0:
            worst = max(worst, abs(_from_skin_or_bone(p, code, surfaces, g)))
    return worst


@njit
def _put_all_back(x: Any, codes: Any, surfaces: Any, rounds: int) -> None:
    g = np.empty(3)
    for v in range(len(x)):
        if codes[v, 0] > 0:
            _put_back(x[v], codes[v], surfaces, rounds, g)


@njit
def _smooth(
    x: Any, cells: Any, star: Any, start: Any, codes: Any, surfaces: Any, goal: float, passes: int
) -> None:
    np.random.seed(7)  # noqa: NPY002 (numba knows no Generator here)
    g = np.empty(3)
    rounds = np.int64(3)  # not a literal: see `materials.cache`
    for step in range(passes):
        moved = 0
        for v in range(len(x)):
            first, last = start[v], start[v + 1]
            if first == last or codes[v, 0] < 0:
                continue
            best = _star_quality(x, cells, star, first, last)
            if best >= goal:
                continue
            reach = 1e30
            for k in range(first, last):
                for m in range(4):
                    w = cells[star[k], m]
                    if w != v:
                        d = (x[w, 0] - x[v, 0]) ** 2 + (x[w, 1] - x[v, 1]) ** 2 + (x[w, 2] - x[v, 2]) ** 2
                        reach = min(reach, d)
            reach = np.sqrt(reach)
            size = 0.4 if step % 2 == 0 else 0.15
            better = False
            for _ in range(4):
                here = x[v].copy()
                found = here.copy()
                for _trial in range(_DIRECTIONS):
                    for k in range(3):
                        x[v, k] = here[k] + size * reach * np.random.normal() * 0.6  # noqa: NPY002
                    if codes[v, 0] > 0:
                        _put_back(x[v], codes[v], surfaces, rounds, g)
                        if _off_surface(x[v], codes[v], surfaces, g) > _ON:
                            continue
                    q = _star_quality(x, cells, star, first, last)
                    if q > best:
                        best = q
                        for k in range(3):
                            found[k] = x[v, k]
                        better = True
                for k in range(3):
                    x[v, k] = found[k]
                size *= 0.5
            if better:
                moved += 1
        if moved == 0 and step > 3:
            break
