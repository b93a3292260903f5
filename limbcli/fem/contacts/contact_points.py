"""Integration points of primary facets in contact: kinematics and state of the compiled contact loops.

Every integration point of the primary facets has a current position r, area vector n = g1 x g2 and unit
normal nu; the line along nu intersects the secondary surface at q with gap g = nu.(r - q), positive for
penetration.
`state` (n_facets, n_gauss, 18) holds gap, n, m (normal of the secondary facet at q), q, traction, secondary
facet, weight, the gradient of the weight with respect to q, and the natural coordinates of q.

The secondary surface is known by its nodes alone, whether these deform with tissue or move with a rigid body:
a force f at r acts as N_a f on the nodes of the primary facet and as -N_a(q) f on those of the secondary one.
`facets2` (n, 4 or 6) are its nodes: of a tri3 the fourth is -1, of all but a tri6 those from the fifth on.

A secondary surface that is not closed ends at a rim. There the traction is faded out by a weight that falls
from 1 to 0 across the rim, over a small fraction of the primary facets' size: without it, a point loses its
whole traction as it slides off and regains it as it springs back, so that no equilibrium exists.
"""

from __future__ import annotations

import numpy as np

from limbcli.numbers.compiled import njit

GAP, NORMAL, OTHER, POINT, TRACTION, FACET, WEIGHT, SLIDE, NATURAL = 0, 1, 4, 7, 10, 11, 12, 13, 16
N_STATE = 18
MOST_NODES = 6  # of a secondary facet


@njit(forceinline=True)
def cross(a, b, c):
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]


@njit
def interpolate(x, nodes, N, dN, r, g1, g2):
    """Value of x (n_points, 3) at a point of a facet, and its derivatives along both natural coordinates."""
    r[:] = 0.0
    g1[:] = 0.0
    g2[:] = 0.0
    for a in range(N.shape[0]):
        for i in range(3):
            value = x[nodes[a], i]
            r[i] += N[a] * value
            g1[i] += dN[a, 0] * value
            g2[i] += dN[a, 1] * value


@njit
def point_geometry(x, nodes, N, dN, r, g1, g2, n):
    """Position, tangents and area vector at one integration point."""
    interpolate(x, nodes, N, dN, r, g1, g2)
    cross(g1, g2, n)


@njit
def normal_change(g1, g2, n, d1, d2, dn, dnu):
    """Change dn of the area vector and dnu of the unit normal; returns |n|."""
    cross(d1, g2, dn)
    dn[0] += g1[1] * d2[2] - g1[2] * d2[1]
    dn[1] += g1[2] * d2[0] - g1[0] * d2[2]
    dn[2] += g1[0] * d2[1] - g1[1] * d2[0]
    length = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
    along = 0.0
    for i in range(3):
        along += n[i] * dn[i] / length
    for i in range(3):
        dnu[i] = (dn[i] - n[i] / length * along) / length
    return length


@njit
def facet_shape(nodes, s, t, N, dN):
    """Shape functions N (6) and derivatives dN (6, 2) of a secondary facet; returns its number of nodes."""
    if nodes.shape[0] > 4 and nodes[4] >= 0:
        r = 1.0 - s - t
        N[0], N[1], N[2] = r * (2 * r - 1), s * (2 * s - 1), t * (2 * t - 1)
        N[3], N[4], N[5] = 4 * r * s, 4 * s * t, 4 * t * r
        dN[0, 0] = dN[0, 1] = 1.0 - 4 * r
        dN[1, 0], dN[1, 1] = 4 * s - 1, 0.0
        dN[2, 0], dN[2, 1] = 0.0, 4 * t - 1
        dN[3, 0], dN[3, 1] = 4 * (r - s), -4 * s
        dN[4, 0], dN[4, 1] = 4 * t, 4 * s
        dN[5, 0], dN[5, 1] = -4 * t, 4 * (r - t)
        return 6
    if nodes[3] >= 0:
        for a in range(4):
            u, v = (-1.0, 1.0, 1.0, -1.0)[a], (-1.0, -1.0, 1.0, 1.0)[a]
            N[a] = 0.25 * (1 + u * s) * (1 + v * t)
            dN[a, 0], dN[a, 1] = 0.25 * u * (1 + v * t), 0.25 * v * (1 + u * s)
        return 4
    N[0], N[1], N[2] = 1.0 - s - t, s, t
    dN[0, 0] = dN[0, 1] = -1.0
    dN[1, 0] = dN[2, 1] = 1.0
    dN[1, 1] = dN[2, 0] = 0.0
    return 3


@njit
def gap_change(row, gap, nu, dr, dnu, slip):
    """Change of the gap for changes dr of the point and dnu of its normal, and motion `slip` of the secondary
    facet's material point."""
    top, bottom = 0.0, 0.0
    for i in range(3):
        top += row[OTHER + i] * (dr[i] - gap * dnu[i] - slip[i])
        bottom += row[OTHER + i] * nu[i]
    return top / bottom


@njit
def natural_change(move, xs, xt):
    """Changes of the natural coordinates of a point that moves by `move` along a facet."""
    a, b, c = xs[1] * xt[2] - xs[2] * xt[1], xs[2] * xt[0] - xs[0] * xt[2], xs[0] * xt[1] - xs[1] * xt[0]
    mm = a**2 + b**2 + c**2
    u, v, w = xt[1] * c - xt[2] * b, xt[2] * a - xt[0] * c, xt[0] * b - xt[1] * a
    ds = (u * move[0] + v * move[1] + w * move[2]) / mm
    u, v, w = b * xs[2] - c * xs[1], c * xs[0] - a * xs[2], a * xs[1] - b * xs[0]
    dt = (u * move[0] + v * move[1] + w * move[2]) / mm
    return ds, dt


@njit
def push(f3, row, nodes, N, nodes2, out):
    """Add a force f3 at a contact point to the primary facet's nodes, and its reaction to the secondary's."""
    N2, dN2 = np.empty(MOST_NODES), np.empty((MOST_NODES, 2))
    n2 = facet_shape(nodes2, row[NATURAL], row[NATURAL + 1], N2, dN2)
    spread(f3, nodes, N, out)
    for a in range(n2):
        for i in range(3):
            out[nodes2[a], i] -= N2[a] * f3[i]


@njit
def spread(f3, nodes, N, out):
    """Distribute a force at an integration point to the nodes of its facet."""
    for a in range(nodes.shape[0]):
        for i in range(3):
            out[nodes[a], i] += N[a] * f3[i]


@njit
def add_symmetric(blocks, touched, pairs, slots, values):
    """Add the symmetric part of the touching facets' blocks (n_facets, n, 3, n, 3) to the upper triangle.

    pairs, slots : see `fem.elements.simd_kernels.tangent`
    """
    for f in range(blocks.shape[0]):
        if not touched[f]:
            continue
        K = blocks[f]
        k = 0
        for b in range(K.shape[0]):
            for a in range(b + 1):
                pair = pairs[f, k] // 2
                swapped = pairs[f, k] % 2 == 1
                k += 1
                for i in range(3):
                    for j in range(3):
                        slot = slots[pair, j, i] if swapped else slots[pair, i, j]
                        if slot >= 0:
                            values[slot] += 0.5 * (K[a, i, b, j] + K[b, j, a, i])
