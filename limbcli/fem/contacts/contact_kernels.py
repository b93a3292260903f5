"""Compiled loops of frictionless contact: force and tangent.

Where contact was found (see `contact_search`), the primary side bears a traction t = eps g (plus a
multiplier) against its normal, per current area. Columns of `state` and symbols are explained in
`contact_points`.

Source: FEBio Theory Manual 4.0, section 7.2 (sliding-elastic).
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
    SLIDE,
    TRACTION,
    WEIGHT,
    facet_shape,
    gap_change,
    interpolate,
    natural_change,
    normal_change,
    point_geometry,
    push,
    spread,
)
from limbcli.numbers.compiled import njit


@njit
def force(facets, N, weights, state, facets2, out):
    """out (n_points, 3) += contact part of the residual, of the nodes on both sides."""
    f3 = np.empty(3)
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            row = state[f, k]
            if row[TRACTION] == 0.0:
                continue
            for i in range(3):
                f3[i] = weights[k] * row[TRACTION] * row[NORMAL + i]
            push(f3, row, facets[f], N[k], facets2[int(row[FACET])], out)


@njit
def scaled_force(facets, N, weights, state, deps, facets2, out):
    """Derivative of `force` for a change deps (n_facets,) of eps at fixed positions."""
    f3 = np.empty(3)
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            row = state[f, k]
            if row[TRACTION] == 0.0:
                continue
            for i in range(3):
                f3[i] = weights[k] * deps[f] * row[WEIGHT] * row[GAP] * row[NORMAL + i]
            push(f3, row, facets[f], N[k], facets2[int(row[FACET])], out)


@njit
def times(x, facets, N, dN, weights, eps, state, turning, facets2, v, out):
    """Derivative of `force` along v (n_points, 3), of the nodes on both sides.

    turning : 1 for the exact derivative, 0 to omit the terms due to the rotation of the normal
    """
    r, g1, g2, n, nu = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    dr, d1, d2, dn, dnu = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    q, xs, xt, slip, vs, vt = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    f3, df, move = np.empty(3), np.empty(3), np.empty(3)
    N2, dN2 = np.empty(MOST_NODES), np.empty((MOST_NODES, 2))
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            row = state[f, k]
            if row[TRACTION] == 0.0:
                continue
            t, gap = turning * row[TRACTION], turning * row[GAP]
            point_geometry(x, facets[f], N[k], dN[k], r, g1, g2, n)
            interpolate(v, facets[f], N[k], dN[k], dr, d1, d2)
            length = normal_change(g1, g2, n, d1, d2, dn, dnu)
            nodes2 = facets2[int(row[FACET])]
            n2 = facet_shape(nodes2, row[NATURAL], row[NATURAL + 1], N2, dN2)
            interpolate(x, nodes2, N2[:n2], dN2, q, xs, xt)
            interpolate(v, nodes2, N2[:n2], dN2, slip, vs, vt)
            for i in range(3):
                nu[i] = n[i] / length
            dg = gap_change(row, gap, nu, dr, dnu, slip)
            dt = row[WEIGHT] * eps[f] * dg
            for i in range(3):
                move[i] = dr[i] - dg * nu[i] - gap * dnu[i] - slip[i]  # of the contact point along the facet
                dt += t / row[WEIGHT] * row[SLIDE + i] * move[i]
            for i in range(3):
                df[i] = weights[k] * (dt * n[i] + t * dn[i])
                f3[i] = weights[k] * t * n[i]
            spread(df, facets[f], N[k], out)
            du, dw = natural_change(move, xs, xt)
            for a in range(n2):
                change = dN2[a, 0] * du + dN2[a, 1] * dw
                for i in range(3):
                    out[nodes2[a], i] -= N2[a] * df[i] + change * f3[i]


@njit
def blocks(x, facets, N, dN, weights, eps, state, turning, out):
    """Contact tangent of each touching soft facet, out (n_facets, n, 3, n, 3); returns which facets touch.

    The block of nodes a, b is w N_a (n dt_b + t dn_b) with dn_b = -[c_b]x,
    c_b = dN_b,1 g2 - dN_b,2 g1; dt_b and `turning` as in `times`.
    """
    nodes = facets.shape[1]
    r, g1, g2, n, c = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    D, dt, dnu = np.empty((nodes, 3, 3)), np.empty((nodes, 3)), np.empty(3)
    touched = np.zeros(facets.shape[0], dtype=np.bool_)
    for f in range(facets.shape[0]):
        K = out[f]
        K[:] = 0.0
        for k in range(N.shape[0]):
            if state[f, k, TRACTION] == 0.0:
                continue
            t = turning * state[f, k, TRACTION]
            touched[f] = True
            point_geometry(x, facets[f], N[k], dN[k], r, g1, g2, n)
            length = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
            gap = turning * state[f, k, GAP]
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
                    turn, slides = 0.0, 0.0
                    for i in range(3):
                        dnu[i] = (D[b, i, j] - n[i] / length * along) / length
                        turn += m[i] * dnu[i]
                    dg = (N[k, b] * m[j] - gap * turn) / mnu
                    for i in range(3):
                        slides -= state[f, k, SLIDE + i] * (dg * n[i] / length + gap * dnu[i])
                    slides += state[f, k, SLIDE + j] * N[k, b]
                    dt[b, j] = state[f, k, WEIGHT] * eps[f] * dg + t / state[f, k, WEIGHT] * slides
            for a in range(nodes):
                for i in range(3):
                    left = weights[k] * N[k, a] * n[i]
                    right = weights[k] * N[k, a] * t
                    for b in range(nodes):
                        for j in range(3):
                            K[a, i, b, j] += left * dt[b, j] + right * D[b, i, j]
    return touched
