"""Compiled loops of Coulomb friction between a soft surface and a rigid one.

For every integration point of the soft facets, position, tangents and contact point on the rigid body (the
anchor, which moves with the body) are stored at the last converged step. With d = r - anchor in the current
configuration, and the normal pressure p = eps g of frictionless contact:

    stick   T = eps d                  where T.nu > 0 and |T - (T.nu) nu| < mu T.nu
    slip    T = p (nu + mu s)          otherwise, and if the point has no anchor
    s = y/max(|y|, mu p/eps),  y = (1 - nu nu)(dx1 - dx2 - g c + pull/eps)
    c = (1 - nu nu) m/|n|,  m = dg1 x g2 + g1 x dg2

T is the traction exerted by the skin, per current area; dx1, dx2, dg1, dg2 are the changes since the last
converged step of the point, of the material point of the rigid body now opposite to it, and of the tangents.
FEBio uses s = y/|y|, which is discontinuous where a point that has just come into contact reverses; here a
slip shorter than mu g is resisted by the same penalty as a sticking point. Without multipliers the shear of
earlier steps is forgotten, in FEBio as here: a step resists only its own motion.

Along a slip the exact derivative has no stiffness, and Newton's method overshoots: points reverse, and
alternate between stick and slip. Far from equilibrium the tangent therefore has stiffness mu p/|y| in every
tangential direction, that of the quadratic with the same force that majorises mu p |y| (Weiszfeld 1937,
Tohoku Math. J. 43:355).

With augmented contact a sticking point has T = pull + eps d, and p contains the multiplier of the pressure;
after each augmentation both take the values of T and p. `pull` keeps the shear of earlier steps, of
slipping points too: theirs is that of a sticking point, limited to mu p (Simo & Laursen 1992, Comput Struct
42:97), so that it does not fall where a point begins to slip. FEBio takes the direction of the step's slip
alone, and lets no point change between stick and slip from the first augmentation of a load step to its end
(FESlidingElasticInterface::ContactTraction); here that is decided anew at every search, since a limb in a
tight socket did not converge otherwise.

Columns of `state` after those of `contact_points`: stick flag, T, |d| of a sticking point. Columns of
`before`, from the last converged step: position, tangents g1 and g2, anchor, facet of the anchor (or -1).
`move` (4, 3): rotation matrix and translation of the body since then: current position = move[:3] position +
move[3].

Source: FEBio Theory Manual 4.0, section 7.2 (sliding-elastic with friction): Zimmerman & Ateshian 2018,
J Biomech Eng 140:081013.
"""

from __future__ import annotations

import numpy as np

from limbcli.fem.contacts.contact_points import (
    FACET,
    GAP,
    NORMAL,
    OTHER,
    POINT,
    TRACTION,
    cross,
    normal_change,
    point_change,
    point_geometry,
    push,
)
from limbcli.fem.contacts.contact_points import N_STATE as N_NORMAL
from limbcli.numbers.compiled import njit

STICKS, PUSH, APART = N_NORMAL, N_NORMAL + 1, N_NORMAL + 4
N_STATE = N_NORMAL + 5
PLACE, TANGENTS, ANCHOR, HELD = 0, 3, 9, 12
N_BEFORE = 13


@njit
def remember(x, facets, N, dN, state, before):
    """Fill `before` from a converged step, after a frictionless contact search."""
    r, g1, g2, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            point_geometry(x, facets[f], N[k], dN[k], r, g1, g2, n)
            row = before[f, k]
            for i in range(3):
                row[PLACE + i] = r[i]
                row[TANGENTS + i] = g1[i]
                row[TANGENTS + 3 + i] = g2[i]
                row[ANCHOR + i] = state[f, k, POINT + i]
            row[HELD] = state[f, k, FACET]


@njit
def _slip(row, before, move, pull, eps, r, g1, g2, n, y, c, m):
    """Set y, c and m (see the module docstring) of a point in contact; returns |n|."""
    size = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
    old, w = np.empty(3), np.empty(3)
    cross(before[TANGENTS : TANGENTS + 3], g2, m)
    cross(g1, before[TANGENTS + 3 : TANGENTS + 6], w)
    along = 0.0
    for i in range(3):
        m[i] = 2.0 * n[i] - m[i] - w[i]
        along += n[i] * m[i] / size
        old[i] = 0.0
        for j in range(3):  # previous position of the body's material point at q
            old[i] += move[j, i] * (row[POINT + j] - move[3, j])
    total = 0.0
    for i in range(3):
        c[i] = (m[i] - along * n[i] / size) / size
        y[i] = r[i] - before[PLACE + i] - (row[POINT + i] - old[i]) - row[GAP] * c[i] + pull[i] / eps
        total += y[i] * n[i] / size
    for i in range(3):
        y[i] -= total * n[i] / size
    return size


@njit
def resist(x, facets, N, dN, eps, state, mu, before, move, pull):
    """Determine stick or slip and the traction T of every touching point; returns how many stick.

    pull (n_facets, n_gauss, 3) : multipliers of T
    """
    r, g1, g2, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    y, c, m, anchor, thrust = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    sticking = 0
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            row = state[f, k]
            row[STICKS] = 0.0
            if row[TRACTION] == 0.0:
                continue
            point_geometry(x, facets[f], N[k], dN[k], r, g1, g2, n)
            size = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
            if before[f, k, HELD] >= 0.0:
                normal, shear, apart = 0.0, 0.0, 0.0
                for i in range(3):
                    anchor[i] = move[3, i]
                    for j in range(3):
                        anchor[i] += move[i, j] * before[f, k, ANCHOR + j]
                    thrust[i] = pull[f, k, i] + eps[f] * (r[i] - anchor[i])
                    normal += thrust[i] * n[i] / size
                    apart += (r[i] - anchor[i]) ** 2
                for i in range(3):
                    shear += (thrust[i] - normal * n[i] / size) ** 2
                if normal > 0.0 and np.sqrt(shear) < mu * normal:
                    row[STICKS] = 1.0
                    row[TRACTION] = normal
                    row[APART] = np.sqrt(apart)
                    row[FACET] = before[f, k, HELD]
                    for i in range(3):
                        row[PUSH + i] = thrust[i]
                        row[POINT + i] = anchor[i]
                    sticking += 1
                    continue
            _slip(row, before[f, k], move, pull[f, k], eps[f], r, g1, g2, n, y, c, m)
            length = np.sqrt(y[0] ** 2 + y[1] ** 2 + y[2] ** 2)
            drag = min(mu * row[TRACTION] / length, eps[f]) if length > 0.0 else 0.0
            for i in range(3):
                row[PUSH + i] = row[TRACTION] * n[i] / size + drag * y[i]
    return sticking


@njit
def force(facets, N, weights, state, center, out, body):
    """out (n_points, 3) += contact part of the residual; body (6) += force and moment on the rigid body."""
    f3 = np.empty(3)
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            row = state[f, k]
            if row[TRACTION] == 0.0:
                continue
            size = np.sqrt(row[NORMAL] ** 2 + row[NORMAL + 1] ** 2 + row[NORMAL + 2] ** 2)
            for i in range(3):
                f3[i] = weights[k] * size * row[PUSH + i]
            push(f3, row, center, facets[f], N[k], out, body)


@njit
def _change(
    row, before, move, pull, eps, mu, yields, couples, center, r, g1, g2, n, y, c, m, dr, d1, d2, motion, df,
    darm,
):  # fmt: skip
    """Change of |n| T, and of the lever arm from the body's centre, for changes of the point and the body.

    y, c, m : from `_slip`, used if the point slips
    yields : 1 for the exact derivative; 0 for stiffness mu p/|y| along a slip as well as across it
    couples : 1 for the exact derivative; 0 for shear of a slip that does not follow the pressure
    """
    dn, dnu, w, v = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    size = normal_change(g1, g2, n, d1, d2, dn, dnu)
    dsize = 0.0
    for i in range(3):
        dsize += n[i] * dn[i] / size
        v[i] = row[POINT + i] - center[i]
    cross(motion[3:6], v, w)  # due to the body's rotation
    if row[STICKS] > 0.0:
        for i in range(3):
            df[i] = size * eps * (dr[i] - motion[i] - w[i]) + dsize * row[PUSH + i]
            darm[i] = w[i]
        return
    nu, dq, dy, dm, dc = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    top, bottom = 0.0, 0.0
    for i in range(3):
        nu[i] = n[i] / size
        top += row[OTHER + i] * (dr[i] - row[GAP] * dnu[i] - w[i] - motion[i])
        bottom += row[OTHER + i] * nu[i]
    dg = top / bottom
    for i in range(3):
        dq[i] = dr[i] - dg * nu[i] - row[GAP] * dnu[i]
        darm[i] = dq[i] - motion[i]
        v[i] = darm[i] - w[i]  # motion of the contact point relative to the body
    length = np.sqrt(y[0] ** 2 + y[1] ** 2 + y[2] ** 2)
    p, dp = row[TRACTION], eps * dg
    if length > 0.0:
        u = np.empty(3)
        cross(before[TANGENTS : TANGENTS + 3], d2, u)
        cross(d1, before[TANGENTS + 3 : TANGENTS + 6], w)
        along, turn, mnu = 0.0, 0.0, 0.0
        for i in range(3):
            dm[i] = 2.0 * dn[i] - u[i] - w[i]
            along += nu[i] * dm[i]
            mnu += nu[i] * m[i]
            turn += dnu[i] * m[i]
        for i in range(3):
            dc[i] = (dm[i] - along * nu[i] - turn * nu[i] - mnu * dnu[i] - dsize * c[i]) / size
        # y = (1 - nu nu) z; the change of the projection needs z's normal component, recomputed here
        znu, zdnu, dz_nu = 0.0, 0.0, 0.0
        for i in range(3):
            back = 0.0
            for j in range(3):
                back += move[j, i] * v[j]
            dy[i] = dr[i] - dq[i] + back - dg * c[i] - row[GAP] * dc[i]
            old = 0.0
            for j in range(3):
                old += move[j, i] * (row[POINT + j] - move[3, j])
            z = r[i] - before[PLACE + i] - row[POINT + i] + old - row[GAP] * c[i] + pull[i] / eps
            znu += z * nu[i]
            zdnu += z * dnu[i]
            dz_nu += dy[i] * nu[i]
        along = 0.0  # change of |y|
        for i in range(3):
            dy[i] -= dz_nu * nu[i] + zdnu * nu[i] + znu * dnu[i]
            along += dy[i] * y[i] / length
    else:
        dy[:] = 0.0
    full = mu * p < eps * length
    for i in range(3):
        shear = eps * dy[i]
        if full:
            shear = mu * (couples * dp * y[i] + p * (dy[i] - yields * along * y[i] / length)) / length
        df[i] = size * (dp * nu[i] + p * dnu[i] + shear) + dsize * row[PUSH + i]


@njit
def times(
    x, facets, N, dN, weights, eps, state, yields, center, v, motion, out, body, mu, before, move, pull
):
    """Derivative of `force` along v (n_points, 3) and the body's motion (6), at fixed stick-slip status."""
    r, g1, g2, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    dr, d1, d2, df, darm = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    y, c, m, f3, w = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            row = state[f, k]
            if row[TRACTION] == 0.0:
                continue
            point_geometry(x, facets[f], N[k], dN[k], r, g1, g2, n)
            size = _slip(row, before[f, k], move, pull[f, k], eps[f], r, g1, g2, n, y, c, m)
            point_change(v, facets[f], N[k], dN[k], dr, d1, d2)
            _change(
                row, before[f, k], move, pull[f, k], eps[f], mu, yields, 1.0, center, r, g1, g2, n, y, c, m,
                dr, d1, d2, motion, df, darm,
            )  # fmt: skip
            for i in range(3):
                df[i] *= weights[k]
                f3[i] = weights[k] * size * row[PUSH + i]
            push(df, row, center, facets[f], N[k], out, body)
            cross(darm, f3, w)
            for i in range(3):
                body[3 + i] += w[i]


@njit
def blocks(x, facets, N, dN, weights, eps, state, yields, out, mu, before, move, pull, couples):
    """Tangent of each touching soft facet, out (n_facets, n, 3, n, 3); returns which facets touch."""
    nodes = facets.shape[1]
    r, g1, g2, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    y, c, m = np.empty(3), np.empty(3), np.empty(3)
    dr, d1, d2, df, darm = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    still, center = np.zeros(6), np.zeros(3)  # of the body, which does not move
    touched = np.zeros(facets.shape[0], dtype=np.bool_)
    for f in range(facets.shape[0]):
        K = out[f]
        K[:] = 0.0
        for k in range(N.shape[0]):
            row = state[f, k]
            if row[TRACTION] == 0.0:
                continue
            touched[f] = True
            point_geometry(x, facets[f], N[k], dN[k], r, g1, g2, n)
            _slip(row, before[f, k], move, pull[f, k], eps[f], r, g1, g2, n, y, c, m)
            for b in range(nodes):
                for j in range(3):
                    dr[:] = 0.0
                    d1[:] = 0.0
                    d2[:] = 0.0
                    dr[j], d1[j], d2[j] = N[k, b], dN[k, b, 0], dN[k, b, 1]
                    _change(
                        row, before[f, k], move, pull[f, k], eps[f], mu, yields, couples, center, r, g1, g2,
                        n, y, c, m, dr, d1, d2, still, df, darm,
                    )  # fmt: skip
                    for a in range(nodes):
                        for i in range(3):
                            K[a, i, b, j] += weights[k] * N[k, a] * df[i]
    return touched
