"""Compiled contact search: intersections of the primary facets' normals with the secondary surface.

Source: FEBio Theory Manual 4.0, section 7.2 (sliding-elastic), applied at each integration point.
"""

from __future__ import annotations

import numpy as np

from limbcli.fem.contacts.contact_points import (
    FACET,
    GAP,
    MOST_NODES,
    NATURAL,
    NORMAL,
    OTHER,
    POINT,
    SLIDE,
    TRACTION,
    WEIGHT,
    cross,
    facet_shape,
    interpolate,
    point_geometry,
)
from limbcli.fem.contacts.facet_tree import facets_on_line
from limbcli.numbers.compiled import njit

_ON_EDGE = 1e-9  # natural coordinates beyond an edge that are round-off
# A gap may grow by this multiple of what the point has moved since the last converged step: its normal may
# meet the surface at 60 degrees. More is a facet that the normal meets through a fold of the tissue.
_DEEPER = 2.0
_NATURAL, _ALONG = 7, 9  # columns of a hit after g, m, q: natural coordinates, and their gradients


@njit
def _hit_triangle(x2, first, second, third, r, nu, tolerance, out):
    """Intersect the line r - g nu with a triangle; returns whether it hits.

    out (15) : g, m (3), q (3), natural coordinates s, t and their gradients along the facet (3 each)
    """
    a, b, c = x2[first], x2[second], x2[third]
    e1, e2, m, p = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        e1[i] = b[i] - a[i]
        e2[i] = c[i] - a[i]
    cross(e1, e2, m)
    mm = m[0] ** 2 + m[1] ** 2 + m[2] ** 2
    mnu = m[0] * nu[0] + m[1] * nu[1] + m[2] * nu[2]
    if mnu >= 0.0 or mnu * mnu < 1e-20 * mm:
        return False  # the facets must face each other
    g = (m[0] * (r[0] - a[0]) + m[1] * (r[1] - a[1]) + m[2] * (r[2] - a[2])) / mnu
    for i in range(3):
        p[i] = r[i] - g * nu[i] - a[i]
    d11 = e1[0] * e1[0] + e1[1] * e1[1] + e1[2] * e1[2]
    d12 = e1[0] * e2[0] + e1[1] * e2[1] + e1[2] * e2[2]
    d22 = e2[0] * e2[0] + e2[1] * e2[1] + e2[2] * e2[2]
    p1 = p[0] * e1[0] + p[1] * e1[1] + p[2] * e1[2]
    p2 = p[0] * e2[0] + p[1] * e2[1] + p[2] * e2[2]
    det = d11 * d22 - d12 * d12
    if det <= 0.0:
        return False
    s = (d22 * p1 - d12 * p2) / det
    t = (d11 * p2 - d12 * p1) / det
    if s < -tolerance or t < -tolerance or s + t > 1.0 + tolerance:
        return False
    _write_projection(g, m, r, nu, s, t, e1, e2, out)
    return True


@njit
def _write_projection(g, m, r, nu, s, t, along_s, along_t, out):
    """Fill `out` for a hit; along_s, along_t : derivatives of the position with respect to s and t."""
    out[0], out[_NATURAL], out[_NATURAL + 1] = g, s, t
    cross(along_t, m, out[_ALONG : _ALONG + 3])
    cross(m, along_s, out[_ALONG + 3 : _ALONG + 6])
    mm = m[0] ** 2 + m[1] ** 2 + m[2] ** 2
    for i in range(3):
        out[1 + i] = m[i]
        out[4 + i] = r[i] - g * nu[i]
        out[_ALONG + i] /= mm
        out[_ALONG + 3 + i] /= mm


@njit
def _hit_curved(x2, nodes, r, nu, tolerance, out):
    """Intersect the line with a bilinear or quadratic facet by Newton's method; the former's two triangles
    first."""
    quad = is_quad(nodes)
    if (
        quad
        and not _hit_triangle(x2, nodes[0], nodes[1], nodes[3], r, nu, tolerance, out)
        and not _hit_triangle(x2, nodes[2], nodes[3], nodes[1], r, nu, tolerance, out)
    ):
        return False
    s, t, g = 0.0, 0.0, out[0]
    N, dN = np.empty(MOST_NODES), np.empty((MOST_NODES, 2))
    q, xs, xt, m, w = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    if not quad:
        s = t = 1.0 / 3.0
        n = facet_shape(nodes, s, t, N, dN)
        interpolate(x2, nodes, N[:n], dN, q, xs, xt)
        g = (r[0] - q[0]) * nu[0] + (r[1] - q[1]) * nu[1] + (r[2] - q[2]) * nu[2]
    ok = False
    for _ in range(12):
        n = facet_shape(nodes, s, t, N, dN)
        interpolate(x2, nodes, N[:n], dN, q, xs, xt)
        for i in range(3):
            q[i] += g * nu[i] - r[i]
        cross(xs, xt, m)
        det = m[0] * nu[0] + m[1] * nu[1] + m[2] * nu[2]
        if det * det < 1e-20 * (m[0] ** 2 + m[1] ** 2 + m[2] ** 2) or det == 0.0:
            return False
        dg = -(m[0] * q[0] + m[1] * q[1] + m[2] * q[2]) / det
        cross(xt, nu, w)
        ds = -(w[0] * q[0] + w[1] * q[1] + w[2] * q[2]) / det
        cross(nu, xs, w)
        dt = -(w[0] * q[0] + w[1] * q[1] + w[2] * q[2]) / det
        s += ds
        t += dt
        g += dg
        if abs(ds) + abs(dt) < 1e-13:
            ok = True
            break
        if abs(s) > 50.0 or abs(t) > 50.0:
            return False
    if (not ok and abs(ds) + abs(dt) > 1e-9) or (not quad and det > 0.0):
        return False
    for edge in range(4 if quad else 3):
        if _beyond(edge, quad, s, t) > tolerance:
            return False
    _write_projection(g, m, r, nu, s, t, xs, xt, out)
    return True


@njit(forceinline=True)
def is_quad(nodes):
    """Whether a secondary facet is a quadrilateral, rather than a triangle of 3 or 6 nodes."""
    return nodes[3] >= 0 and (nodes.shape[0] == 4 or nodes[4] < 0)


@njit
def _hit(x2, nodes, rim, r, nu, tolerance, out):
    """Intersect the line with a secondary facet; rim (4) : as in `search`."""
    quad = is_quad(nodes)
    wide = max(tolerance, rim[0], rim[1], rim[2], rim[3])
    if nodes[3] >= 0:
        met = _hit_curved(x2, nodes, r, nu, wide, out)
    else:
        met = _hit_triangle(x2, nodes[0], nodes[1], nodes[2], r, nu, wide, out)
    if met and wide > tolerance:  # at edges without a rim the usual tolerance applies
        for edge in range(4 if quad else 3):
            if rim[edge] == 0.0 and _beyond(edge, quad, out[_NATURAL], out[_NATURAL + 1]) > tolerance:
                return False
    return met


@njit
def _beyond(edge, quad, s, t):
    """Distance of (s, t) outside an edge, in natural coordinates; edge k goes from node k to the next."""
    if quad:
        return (-1.0 - t, s - 1.0, t - 1.0, -1.0 - s)[edge]
    return (-t, s + t - 1.0, -s)[edge]


@njit
def _is_inside(nodes, rim, out):
    """Whether a hit lies on the facet itself, or in the fading zone beyond its free edges."""
    quad = is_quad(nodes)
    for edge in range(4 if quad else 3):
        if rim[edge] == 0.0 and _beyond(edge, quad, out[_NATURAL], out[_NATURAL + 1]) > _ON_EDGE:
            return False
    return True


@njit
def _fade(out, quad, rim, row):
    """Fading weight of the traction at a hit; its gradient goes to row[SLIDE:] (see `contact_points`)."""
    weight = 1.0
    row[SLIDE] = row[SLIDE + 1] = row[SLIDE + 2] = 0.0
    for edge in range(4 if quad else 3):
        width = rim[edge]
        if width == 0.0:
            continue
        h = _beyond(edge, quad, out[_NATURAL], out[_NATURAL + 1]) / width
        if h <= -1.0:
            continue
        if h >= 1.0:
            return 0.0
        part = 0.5 - 0.25 * h * (3.0 - h * h)
        slope = -0.75 * (1.0 - h * h) / width
        ds, dt = 0.0, 0.0
        if quad:
            ds, dt = ((0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0))[edge]
        else:
            ds, dt = ((0.0, -1.0), (1.0, 1.0), (-1.0, 0.0))[edge]
        for i in range(3):
            along = ds * out[_ALONG + i] + dt * out[_ALONG + 3 + i]
            row[SLIDE + i] = row[SLIDE + i] * part + weight * slope * along
        weight *= part
    return weight


@njit
def _way(past, nodes, N, nodes2, r, hit):
    """How far the point has moved against the secondary side's material point opposite to it, at a hit."""
    N2, dN2 = np.empty(MOST_NODES), np.empty((MOST_NODES, 2))
    n2 = facet_shape(nodes2, hit[_NATURAL], hit[_NATURAL + 1], N2, dN2)
    total = 0.0
    for i in range(3):
        moved = r[i] - hit[4 + i]
        for a in range(N.shape[0]):
            moved -= N[a] * past[nodes[a], i]
        for a in range(n2):
            moved += N2[a] * past[nodes2[a], i]
        total += moved**2
    return np.sqrt(total)


@njit
def search(
    start, stop, x, facets, N, dN, facets2, rim, tree, radius, tolerance, eps, multiplier, past, last_gaps,
    state,
):  # fmt: skip
    """Fill `state` of facets start..stop; traction 0 means no contact. Returns the number in contact.

    As in FEBio, a point keeps the secondary facet of the last search as long as its normal line hits that
    facet. Otherwise the nearest facing facet that the line hits within the search radius is taken. A line
    that misses a facet by less than the tolerance (natural coordinates) hits it, too, but only where it hits
    no facet beside that one: FEBio keeps the facet there, whose plane is not the surface where this bends,
    and the gap jumps as the point leaves it. Nor is a hit a contact that is deeper than the point can have
    come since the last converged step: where skin bulges over a brim, the normal of its far side meets the
    wall through the bulge, and a traction as large as that gap would come and go in the iteration.

    rim (n_facets2, 4) : half-width of the fading zone at free edges of the secondary surface, in the facet's
        natural coordinates; 0 at other edges
    past, last_gaps : see `Pair`
    tree : spheres around the secondary facets and around the nodes of their tree, its order and its starts
        (see `FacetTree`)
    """
    r, g1, g2, n, nu = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    out, best = np.empty(15), np.empty(15)
    spheres, around, order, starts = tree
    near = np.empty(len(facets2), dtype=np.int64)
    count = 0
    for f in range(start, stop):
        for k in range(N.shape[0]):
            row = state[f, k]
            hint = int(row[FACET])
            row[TRACTION] = 0.0
            row[FACET] = -1.0
            point_geometry(x, facets[f], N[k], dN[k], r, g1, g2, n)
            length = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
            for i in range(3):
                nu[i] = n[i] / length
            found, inside, nearest = False, False, -1
            if hint >= 0 and _hit(x, facets2[hint], rim[hint], r, nu, tolerance, out):
                found, inside, nearest = True, _is_inside(facets2[hint], rim[hint], out), hint
                for i in range(15):
                    best[i] = out[i]
            if not inside:
                n_near = facets_on_line(r, nu, radius, spheres, around, order, starts, near)
                for j in near[:n_near]:
                    if not _hit(x, facets2[j], rim[j], r, nu, tolerance, out) or abs(out[0]) >= radius:
                        continue
                    within = _is_inside(facets2[j], rim[j], out)
                    if not found:
                        better = True
                    elif within == inside:
                        better = abs(out[0]) < abs(best[0]) and nearest != hint
                    else:  # the facet next to it, not one behind
                        better = within and abs(out[0] - best[0]) < spheres[j, 3]
                    if better:
                        found, inside, nearest = True, within, j
                        for i in range(15):
                            best[i] = out[i]
            if not found:
                continue
            gap = best[0]
            weight = _fade(best, is_quad(facets2[nearest]), rim[nearest], row)
            traction = weight * (multiplier[f, k] + eps[f] * gap)
            if gap > radius or traction <= 0.0:
                continue
            if gap > _DEEPER * last_gaps[f, k]:
                way = _way(past, facets[f], N[k], facets2[nearest], r, best)
                if gap > _DEEPER * (last_gaps[f, k] + way):
                    continue
            count += 1
            row[GAP] = gap
            for i in range(3):
                row[NORMAL + i] = n[i]
                row[OTHER + i] = best[1 + i]
                row[POINT + i] = best[4 + i]
            row[TRACTION] = traction
            row[FACET] = nearest
            row[WEIGHT] = weight
            row[NATURAL], row[NATURAL + 1] = best[_NATURAL], best[_NATURAL + 1]
    return count
