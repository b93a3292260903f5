"""Compiled loops of the contact between a soft surface and a rigid one.

At every integration point of the soft facets: current position r, area vector
n = g1 x g2, unit normal nu; the line along nu meets the rigid surface at q with
gap g = nu.(r - q), positive inside. The soft side takes the traction t = eps g
(plus a multiplier) against nu, per current area. `state` (n_facets, n_gauss, 12)
holds gap, n, m (normal of the rigid facet at q), q, traction, rigid facet.

Source: FEBio Theory Manual 4.0, section 7.2 (sliding-elastic); the same law is
used here point by point.
"""

from __future__ import annotations

import numpy as np
from numba import njit

GAP, NORMAL, OTHER, POINT, TRACTION, FACET = 0, 1, 4, 7, 10, 11
N_STATE = 12


@njit(cache=True, inline="always")
def _cross(a, b, c):
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def _hit_triangle(x2, first, second, third, r, nu, tolerance, out):
    """Where the line r - g nu meets a flat facet: out = g, m (3), q (3). False: it does not."""
    a, b, c = x2[first], x2[second], x2[third]
    e1, e2, m, p = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        e1[i] = b[i] - a[i]
        e2[i] = c[i] - a[i]
    _cross(e1, e2, m)
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
    out[0] = g
    for i in range(3):
        out[1 + i] = m[i]
        out[4 + i] = r[i] - g * nu[i]
    return True


@njit(cache=True)
def _hit_quad(x2, nodes, r, nu, tolerance, out):
    """The same for a bilinear facet: its two triangles first, then Newton's method in its coordinates."""
    if not _hit_triangle(x2, nodes[0], nodes[1], nodes[3], r, nu, tolerance, out) and not _hit_triangle(
        x2, nodes[2], nodes[3], nodes[1], r, nu, tolerance, out
    ):
        return False
    s, t, g = 0.0, 0.0, out[0]
    xs, xt, m, res = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    ok = False
    for _ in range(12):
        n0, n1 = 0.25 * (1 - s) * (1 - t), 0.25 * (1 + s) * (1 - t)
        n2, n3 = 0.25 * (1 + s) * (1 + t), 0.25 * (1 - s) * (1 + t)
        for i in range(3):
            a, b, c, d = x2[nodes[0], i], x2[nodes[1], i], x2[nodes[2], i], x2[nodes[3], i]
            xs[i] = 0.25 * ((b - a) * (1 - t) + (c - d) * (1 + t))
            xt[i] = 0.25 * ((d - a) * (1 - s) + (c - b) * (1 + s))
            res[i] = n0 * a + n1 * b + n2 * c + n3 * d + g * nu[i] - r[i]
        _cross(xs, xt, m)
        det = m[0] * nu[0] + m[1] * nu[1] + m[2] * nu[2]
        if det * det < 1e-20 * (m[0] ** 2 + m[1] ** 2 + m[2] ** 2) or det == 0.0:
            return False
        dg = -(m[0] * res[0] + m[1] * res[1] + m[2] * res[2]) / det
        w = np.empty(3)
        _cross(xt, nu, w)
        ds = -(w[0] * res[0] + w[1] * res[1] + w[2] * res[2]) / det
        _cross(nu, xs, w)
        dt = -(w[0] * res[0] + w[1] * res[1] + w[2] * res[2]) / det
        s += ds
        t += dt
        g += dg
        if abs(ds) + abs(dt) < 1e-13:
            ok = True
            break
        if abs(s) > 50.0 or abs(t) > 50.0:
            return False
    if not ok and abs(ds) + abs(dt) > 1e-9:
        return False
    if abs(s) > 1.0 + tolerance or abs(t) > 1.0 + tolerance:
        return False
    out[0] = g
    for i in range(3):
        out[1 + i] = m[i]
        out[4 + i] = r[i] - g * nu[i]
    return True


@njit(cache=True)
def _hit(x2, nodes, r, nu, tolerance, out):
    if nodes[3] < 0:
        return _hit_triangle(x2, nodes[0], nodes[1], nodes[2], r, nu, tolerance, out)
    return _hit_quad(x2, nodes, r, nu, tolerance, out)


@njit(cache=True)
def point_geometry(x, nodes, N, dN, r, g1, g2, n):
    """Position, tangents and area vector at one integration point."""
    r[:] = 0.0
    g1[:] = 0.0
    g2[:] = 0.0
    for a in range(nodes.shape[0]):
        for i in range(3):
            value = x[nodes[a], i]
            r[i] += N[a] * value
            g1[i] += dN[a, 0] * value
            g2[i] += dN[a, 1] * value
    _cross(g1, g2, n)


@njit(cache=True, nogil=True)
def search(
    start, stop, x, facets, N, dN, x2, facets2, spheres, box, radius, tolerance, eps, multiplier, state
):
    """Fill `state` of facets start..stop; traction 0 means no contact. Returns the number in contact.

    A point stays with the rigid facet that it touched when it was searched last, as long as its
    line meets that facet. Any other point takes, of the facing facets that its line meets within
    the radius, the nearest. So does FEBio.

    spheres (n_facets2, 4): centre and radius of each rigid facet; box (2, 3): their bounds.
    """
    r, g1, g2, n, nu = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    out, best = np.empty(7), np.empty(7)
    count = 0
    for f in range(start, stop):
        for k in range(N.shape[0]):
            row = state[f, k]
            hint = int(row[FACET])
            row[TRACTION] = 0.0
            row[FACET] = -1.0
            point_geometry(x, facets[f], N[k], dN[k], r, g1, g2, n)
            far = False
            for i in range(3):
                if r[i] < box[0, i] - radius or r[i] > box[1, i] + radius:
                    far = True
            if far:
                continue
            length = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
            for i in range(3):
                nu[i] = n[i] / length
            found = False
            if hint >= 0 and _hit(x2, facets2[hint], r, nu, tolerance, out):
                best[:] = out
                found = True
                place = hint
            if not found:
                for j in range(facets2.shape[0]):
                    d2, along = 0.0, 0.0
                    for i in range(3):
                        d = spheres[j, i] - r[i]
                        d2 += d * d
                        along += d * nu[i]
                    reach = spheres[j, 3]
                    if d2 - along * along > reach * reach or abs(along) > radius + reach:
                        continue
                    if not _hit(x2, facets2[j], r, nu, tolerance, out):
                        continue
                    if abs(out[0]) < radius and (not found or abs(out[0]) < abs(best[0])):
                        best[:] = out
                        found = True
                        place = j
            if not found:
                continue
            gap = best[0]
            traction = multiplier[f, k] + eps[f] * gap
            if gap > radius or traction <= 0.0:
                continue
            count += 1
            row[GAP] = gap
            for i in range(3):
                row[NORMAL + i] = n[i]
                row[OTHER + i] = best[1 + i]
                row[POINT + i] = best[4 + i]
            row[TRACTION] = traction
            row[FACET] = place
    return count


@njit(cache=True, nogil=True)
def force(facets, N, weights, state, center, out, body):
    """out (n_points, 3) += contact part of the residual; body (6) += force and moment on the rigid body."""
    f3, arm, moment = np.empty(3), np.empty(3), np.empty(3)
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            t = state[f, k, TRACTION]
            if t == 0.0:
                continue
            for i in range(3):
                f3[i] = weights[k] * t * state[f, k, NORMAL + i]
                arm[i] = state[f, k, POINT + i] - center[i]
            _cross(arm, f3, moment)
            for i in range(3):
                body[i] += f3[i]
                body[3 + i] += moment[i]
            for a in range(facets.shape[1]):
                for i in range(3):
                    out[facets[f, a], i] += N[k, a] * f3[i]


@njit(cache=True, nogil=True)
def shifted_force(facets, N, weights, state, carried, out):
    """out (n_points, 3) += what tractions `carried` instead of those of `state` add to `force`."""
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            if state[f, k, TRACTION] == 0.0:
                continue
            change = weights[k] * (carried[f, k] - state[f, k, TRACTION])
            for a in range(facets.shape[1]):
                for i in range(3):
                    out[facets[f, a], i] += N[k, a] * change * state[f, k, NORMAL + i]


@njit(cache=True, nogil=True)
def scaled_force(facets, N, weights, state, deps, center, out, body):
    """Derivative of `force` where eps changes by deps (n_facets,), the positions held."""
    f3, arm, moment = np.empty(3), np.empty(3), np.empty(3)
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            if state[f, k, TRACTION] == 0.0:
                continue
            for i in range(3):
                f3[i] = weights[k] * deps[f] * state[f, k, GAP] * state[f, k, NORMAL + i]
                arm[i] = state[f, k, POINT + i] - center[i]
            _cross(arm, f3, moment)
            for i in range(3):
                body[i] += f3[i]
                body[3 + i] += moment[i]
            for a in range(facets.shape[1]):
                for i in range(3):
                    out[facets[f, a], i] += N[k, a] * f3[i]


@njit(cache=True, nogil=True)
def linear_tractions(x, facets, N, dN, eps, state, carried, v, motion, out):
    """out (n_facets, n_gauss) = traction plus its linear change along v (n_points, 3) and the body's motion.

    Points without contact carry nothing, however far they come. carried: as in `times`.
    """
    r, g1, g2, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    dr, d1, d2, dn, w = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            out[f, k] = 0.0
            if state[f, k, TRACTION] == 0.0:
                continue
            t = carried[f, k] if carried.shape[0] else state[f, k, TRACTION]
            gap = state[f, k, GAP] + (t - state[f, k, TRACTION]) / eps[f]
            point_geometry(x, facets[f], N[k], dN[k], r, g1, g2, n)
            dr[:] = 0.0
            d1[:] = 0.0
            d2[:] = 0.0
            for a in range(facets.shape[1]):
                for i in range(3):
                    value = v[facets[f, a], i]
                    dr[i] += N[k, a] * value
                    d1[i] += dN[k, a, 0] * value
                    d2[i] += dN[k, a, 1] * value
            _cross(d1, g2, dn)
            _cross(g1, d2, w)
            length = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
            along = 0.0
            for i in range(3):
                dn[i] += w[i]
                along += n[i] * dn[i] / length
            top, bottom = 0.0, 0.0
            for i in range(3):
                m = state[f, k, OTHER + i]
                dnu = (dn[i] - n[i] / length * along) / length
                top += m * (dr[i] - gap * dnu - motion[i])
                bottom += m * n[i] / length
            out[f, k] = max(state[f, k, TRACTION] + eps[f] * top / bottom, 0.0)


@njit(cache=True, nogil=True)
def times(x, facets, N, dN, weights, eps, state, carried, center, v, motion, out, body):
    """Derivative of `force` along v (n_points, 3) and the body's motion (6).

    motion: translation of the centre and small rotation vector about it.
    carried (n_facets, n_gauss): tractions that turn with the skin's normals; without facets those of
    `state`, and the derivative is exact.
    """
    r, g1, g2, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    dr, d1, d2, dn, w = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    dq, dnu, f3, df, arm = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            if state[f, k, TRACTION] == 0.0:
                continue
            t = carried[f, k] if carried.shape[0] else state[f, k, TRACTION]
            point_geometry(x, facets[f], N[k], dN[k], r, g1, g2, n)
            dr[:] = 0.0
            d1[:] = 0.0
            d2[:] = 0.0
            for a in range(facets.shape[1]):
                for i in range(3):
                    value = v[facets[f, a], i]
                    dr[i] += N[k, a] * value
                    d1[i] += dN[k, a, 0] * value
                    d2[i] += dN[k, a, 1] * value
            _cross(d1, g2, dn)
            _cross(g1, d2, w)
            length = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
            along = 0.0
            for i in range(3):
                dn[i] += w[i]
                along += n[i] * dn[i] / length
            for i in range(3):
                dnu[i] = (dn[i] - n[i] / length * along) / length
                arm[i] = state[f, k, POINT + i] - center[i]
            _cross(motion[3:6], arm, dq)
            gap = state[f, k, GAP] + (t - state[f, k, TRACTION]) / eps[f]
            top, bottom = 0.0, 0.0
            for i in range(3):
                m = state[f, k, OTHER + i]
                top += m * (dr[i] - gap * dnu[i] - dq[i] - motion[i])
                bottom += m * n[i] / length
            dg = top / bottom
            for i in range(3):
                df[i] = weights[k] * (eps[f] * dg * n[i] + t * dn[i])
                f3[i] = weights[k] * t * n[i]
                dq[i] = dr[i] - dg * n[i] / length - gap * dnu[i] - motion[i]  # of the arm
            for i in range(3):
                body[i] += df[i]
            _cross(arm, df, w)
            for i in range(3):
                body[3 + i] += w[i]
            _cross(dq, f3, w)
            for i in range(3):
                body[3 + i] += w[i]
            for a in range(facets.shape[1]):
                for i in range(3):
                    out[facets[f, a], i] += N[k, a] * df[i]


@njit(cache=True, nogil=True)
def stiffness(x, facets, N, dN, weights, eps, state, carried, pairs, slots, values):
    """Symmetric part of the contact tangent of the soft facets, added to the upper triangle.

    The exact block of nodes a, b is w N_a (eps n dg_b + t dn_b) with dn_b = -[c_b]x,
    c_b = dN_b,1 g2 - dN_b,2 g1 and dg_b as in `times`; half of it and of its transpose are added.
    carried: as in `times`.
    """
    nodes = facets.shape[1]
    r, g1, g2, n, c = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    D, dg, K = np.empty((nodes, 3, 3)), np.empty((nodes, 3)), np.empty((nodes, 3, nodes, 3))
    for f in range(facets.shape[0]):
        touching = False
        K[:] = 0.0
        for k in range(N.shape[0]):
            if state[f, k, TRACTION] == 0.0:
                continue
            t = carried[f, k] if carried.shape[0] else state[f, k, TRACTION]
            touching = True
            point_geometry(x, facets[f], N[k], dN[k], r, g1, g2, n)
            length = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
            gap = state[f, k, GAP] + (t - state[f, k, TRACTION]) / eps[f]
            m = state[f, k, OTHER : OTHER + 3]
            mnu = (m[0] * n[0] + m[1] * n[1] + m[2] * n[2]) / length
            for b in range(nodes):
                for i in range(3):
                    c[i] = dN[k, b, 0] * g2[i] - dN[k, b, 1] * g1[i]
                D[b, 0, 0] = D[b, 1, 1] = D[b, 2, 2] = 0.0
                D[b, 0, 1], D[b, 0, 2], D[b, 1, 2] = c[2], -c[1], c[0]
                D[b, 1, 0], D[b, 2, 0], D[b, 2, 1] = -c[2], c[1], -c[0]
                for j in range(3):
                    along = (n[0] * D[b, 0, j] + n[1] * D[b, 1, j] + n[2] * D[b, 2, j]) / length
                    turn = 0.0
                    for i in range(3):
                        turn += m[i] * (D[b, i, j] - n[i] / length * along) / length
                    dg[b, j] = (N[k, b] * m[j] - gap * turn) / mnu
            for a in range(nodes):
                for i in range(3):
                    left = weights[k] * N[k, a] * eps[f] * n[i]
                    right = weights[k] * N[k, a] * t
                    for b in range(nodes):
                        for j in range(3):
                            K[a, i, b, j] += left * dg[b, j] + right * D[b, i, j]
        if not touching:
            continue
        place = 0
        for b in range(nodes):
            for a in range(b + 1):
                code = pairs[f, place]
                place += 1
                pair = code // 2
                swapped = code % 2 == 1
                for i in range(3):
                    for j in range(3):
                        slot = slots[pair, j, i] if swapped else slots[pair, i, j]
                        if slot >= 0:
                            values[slot] += 0.5 * (K[a, i, b, j] + K[b, j, a, i])
