"""Integration points of soft facets in contact: kinematics and state shared by the compiled contact loops.

Every integration point of the soft facets has a current position r, area vector n = g1 x g2 and unit normal
nu; the line along nu intersects the rigid surface at q with gap g = nu.(r - q), positive for penetration.
`state` (n_facets, n_gauss, 16) holds gap, n, m (normal of the rigid facet at q), q, traction, rigid facet,
weight, and the gradient of the weight with respect to q.

A rigid surface that is not closed ends at a rim. There the traction is faded out by a weight that falls from
1 to 0 across the rim, over a small fraction of the soft facets' size: without it, a point loses its whole
traction as it slides off and regains it as it springs back, so that no equilibrium exists.
"""

from __future__ import annotations

import numpy as np

from limbcli.numbers.compiled import njit

GAP, NORMAL, OTHER, POINT, TRACTION, FACET, WEIGHT, SLIDE = 0, 1, 4, 7, 10, 11, 12, 13
N_STATE = 16


@njit(forceinline=True)
def cross(a, b, c):
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]


@njit
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
    cross(g1, g2, n)


@njit
def point_change(v, nodes, N, dN, dr, d1, d2):
    """Change of position and tangents at one integration point, for velocities v (n_points, 3)."""
    dr[:] = 0.0
    d1[:] = 0.0
    d2[:] = 0.0
    for a in range(nodes.shape[0]):
        for i in range(3):
            value = v[nodes[a], i]
            dr[i] += N[a] * value
            d1[i] += dN[a, 0] * value
            d2[i] += dN[a, 1] * value


@njit
def normal_change(g1, g2, n, d1, d2, dn, dnu):
    """Change dn of the area vector and dnu of the unit normal; returns |n|."""
    w = np.empty(3)
    cross(d1, g2, dn)
    cross(g1, d2, w)
    length = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
    along = 0.0
    for i in range(3):
        dn[i] += w[i]
        along += n[i] * dn[i] / length
    for i in range(3):
        dnu[i] = (dn[i] - n[i] / length * along) / length
    return length


@njit
def push(f3, row, center, nodes, N, out, body):
    """Add a force f3 at the contact point to the soft nodes, out (n_points, 3), and to the rigid body (6)."""
    arm, moment = np.empty(3), np.empty(3)
    for i in range(3):
        arm[i] = row[POINT + i] - center[i]
    cross(arm, f3, moment)
    for i in range(3):
        body[i] += f3[i]
        body[3 + i] += moment[i]
    spread(f3, nodes, N, out)


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
