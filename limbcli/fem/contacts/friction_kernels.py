"""Compiled loops of Coulomb friction.

For every integration point of the primary facets, position and tangents are stored at the last converged
step. With the normal pressure p = eps g of frictionless contact:

    T = p nu + t,  t = eps y min(1, mu p/(eps |y|)): the point sticks if eps |y| < mu p, else it slips
    y = (1 - nu nu)(dx1 - dx2 - g c + pull/eps)
    c = (1 - nu nu) m/|n|,  m = dg1 x g2 + g1 x dg2

T is the traction exerted by the skin, per current area; dx1, dx2, dg1, dg2 are the changes since the last
converged step of the point, of the secondary side's material point now opposite to it, and of the tangents.
Without multipliers the shear of earlier steps is forgotten, in FEBio as here: a step resists only its own
motion.

T is continuous. FEBio's is not: a sticking point is held by a spring to the point of the secondary facet that
it met at the last step, whose part along nu differs from eps g where nu is not the facet's normal, so that
the pressure jumps where the point begins to slip, by up to mu times the tangent of the angle between them;
and a slip shorter than mu g is resisted in full (s = y/|y|). Where the iteration ends at such a jump there is
no equilibrium.

Along a slip the exact derivative has no stiffness, and Newton's method overshoots: points reverse, and
alternate between stick and slip. The tangent therefore knows the shear by a dual variable w of its own, which
takes part in the iteration (Chan, Golub & Mulet 1999, SIAM J Sci Comput 20:1964, for the same function of y
in images): |y| w = mu p y is linearised in place of w = mu p y/|y|, which gives

    dt = mu (dp y/|y| + p dy/|y|) - w (y . dy)/|y|^2

and w of the next iteration, at most mu p. With w = mu p y/|y|, as at equilibrium or where a point begins to
slip, that is the exact derivative; where y has turned since, it keeps stiffness along the slip. The residual
does not know w. Far from equilibrium w is 0 in the tangent: stiffness mu p/|y| in every tangential direction,
that of the quadratic with the same force that majorises mu p |y| (Weiszfeld 1937, Tohoku Math. J. 43:355).

With augmented contact p contains the multiplier of the pressure and y that of the shear; after each
augmentation they take the values of p and T. `pull` keeps the shear of earlier steps, of slipping points too:
theirs is that of a sticking point, limited to mu p (Simo & Laursen 1992, Comput Struct 42:97), so that it
does not fall where a point begins to slip. FEBio takes the direction of the step's slip alone, and lets no
point change between stick and slip from the first augmentation of a load step to its end
(FESlidingElasticInterface::ContactTraction); here that is decided anew at every search, since a limb in a
tight socket did not converge otherwise.

Columns of `state` after those of `contact_points`: stick flag, T, distance from where a sticking point would
be without penetration, y, w. Columns of `before`, from the last converged step: position, tangents g1 and g2.
`past` (n_points, 3): positions of all nodes then.

Source: FEBio Theory Manual 4.0, section 7.2 (sliding-elastic with friction): Zimmerman & Ateshian 2018,
J Biomech Eng 140:081013.
"""

from __future__ import annotations

import numpy as np

from limbcli.fem.contacts.contact_points import (
    FACET,
    GAP,
    MOST_NODES,
    NATURAL,
    NORMAL,
    SLIDE,
    TRACTION,
    WEIGHT,
    cross,
    facet_shape,
    gap_change,
    interpolate,
    natural_change,
    normal_change,
    point_geometry,
    push,
    spread,
)
from limbcli.fem.contacts.contact_points import N_STATE as N_NORMAL
from limbcli.numbers.compiled import njit

STICKS, PUSH, APART, SLIP, DUAL = N_NORMAL, N_NORMAL + 1, N_NORMAL + 4, N_NORMAL + 5, N_NORMAL + 8
N_STATE = N_NORMAL + 11
PLACE, TANGENTS = 0, 3
N_BEFORE = 9


@njit
def remember(x, facets, N, dN, before):
    """Fill `before` from a converged step."""
    r, g1, g2, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            point_geometry(x, facets[f], N[k], dN[k], r, g1, g2, n)
            row = before[f, k]
            for i in range(3):
                row[PLACE + i] = r[i]
                row[TANGENTS + i] = g1[i]
                row[TANGENTS + 3 + i] = g2[i]


@njit
def _slip(row, before, x, past, nodes2, pull, eps, r, g1, g2, n, y, c, m, room, N2, dN2):
    """Set y, c and m (see the module docstring) of a point in contact; returns |n|, and how many nodes the
    secondary facet has.

    N2, dN2, room (16, 3) : working space; arrays made for every point would cost as much as the work. They
        leave with the shape functions of the secondary facet, and in `room` what `_change` takes of it
    """
    size = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
    old, olds, oldt, now, xs, xt, w = room[0], room[1], room[2], room[3], room[4], room[5], room[6]
    n2 = facet_shape(nodes2, row[NATURAL], row[NATURAL + 1], N2, dN2)
    interpolate(past, nodes2, N2[:n2], dN2, old, olds, oldt)
    interpolate(x, nodes2, N2[:n2], dN2, now, xs, xt)
    cross(before[TANGENTS : TANGENTS + 3], g2, m)
    cross(g1, before[TANGENTS + 3 : TANGENTS + 6], w)
    along = 0.0
    for i in range(3):
        m[i] = 2.0 * n[i] - m[i] - w[i]
        along += n[i] * m[i] / size
    total = 0.0
    for i in range(3):
        c[i] = (m[i] - along * n[i] / size) / size
        y[i] = r[i] - before[PLACE + i] - (now[i] - old[i]) - row[GAP] * c[i] + pull[i] / eps
        total += y[i] * n[i] / size
    for i in range(3):
        y[i] -= total * n[i] / size
    return size, n2


@njit
def resist(x, facets, N, dN, eps, state, facets2, mu, before, past, pull, earlier):
    """Determine stick or slip, the traction T and the dual shear of every touching point.

    pull (n_facets, n_gauss, 3) : multipliers of T
    earlier : state of the points in the iteration before; no facets: none
    """
    r, g1, g2, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    y, c, m, room = np.empty(3), np.empty(3), np.empty(3), np.empty((16, 3))
    N2, dN2 = np.empty(MOST_NODES), np.empty((MOST_NODES, 2))
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            row, multiplier = state[f, k], pull[f, k]
            if row[TRACTION] == 0.0:
                continue
            point_geometry(x, facets[f], N[k], dN[k], r, g1, g2, n)
            nodes2 = facets2[int(row[FACET])]
            size, _ = _slip(
                row, before[f, k], x, past, nodes2, multiplier, eps[f], r, g1, g2, n, y, c, m, room, N2, dN2
            )
            length = np.sqrt(y[0] ** 2 + y[1] ** 2 + y[2] ** 2)
            most = mu * row[TRACTION]
            row[STICKS] = 1.0 if eps[f] * length < most else 0.0
            drag = eps[f] if row[STICKS] > 0.0 else most / length if length > 0.0 else 0.0
            normal = (multiplier[0] * n[0] + multiplier[1] * n[1] + multiplier[2] * n[2]) / size
            apart = row[GAP] ** 2
            for i in range(3):
                row[PUSH + i] = row[TRACTION] * n[i] / size + drag * y[i]
                apart += (y[i] - (multiplier[i] - normal * n[i] / size) / eps[f]) ** 2
            row[APART] = np.sqrt(apart)
            for i in range(3):
                row[SLIP + i] = y[i]
                row[DUAL + i] = drag * y[i]
            if row[STICKS] == 0.0 and earlier.shape[0] > 0:
                _follow(row, earlier[f, k], mu)


@njit
def _follow(row, old, mu):
    """Set w of a slipping point that slipped in the iteration before, `old`: |y| w = mu p y linearised."""
    length = np.sqrt(old[SLIP] ** 2 + old[SLIP + 1] ** 2 + old[SLIP + 2] ** 2)
    if old[TRACTION] == 0.0 or old[STICKS] > 0.0 or length == 0.0:
        return
    p, dp = old[TRACTION], row[TRACTION] - old[TRACTION]
    along, size = 0.0, 0.0
    for i in range(3):
        along += old[SLIP + i] * (row[SLIP + i] - old[SLIP + i]) / length
    for i in range(3):
        row[DUAL + i] = (mu * (p * row[SLIP + i] + dp * old[SLIP + i]) - along * old[DUAL + i]) / length
        size += row[DUAL + i] ** 2
    share = mu * row[TRACTION] / max(np.sqrt(size), 1e-300)
    for i in range(3):
        row[DUAL + i] *= min(share, 1.0)


@njit
def force(facets, N, weights, state, facets2, out):
    """out (n_points, 3) += contact part of the residual, of the nodes on both sides."""
    f3 = np.empty(3)
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            row = state[f, k]
            if row[TRACTION] == 0.0:
                continue
            size = np.sqrt(row[NORMAL] ** 2 + row[NORMAL + 1] ** 2 + row[NORMAL + 2] ** 2)
            for i in range(3):
                f3[i] = weights[k] * size * row[PUSH + i]
            push(f3, row, facets[f], N[k], facets2[int(row[FACET])], out)


@njit
def _change(row, before, pull, eps, mu, yields, couples, r, g1, g2, n, y, c, m, dr, d1, d2, slip, df, room):
    """Change df of |n| T, for changes of the point and the motion `slip` of the secondary side's material
    point; returns the changes of the contact point's natural coordinates.

    y, c, m, room : from `_slip`
    yields : 1 for w as it is in `row`; 0 for w = 0
    couples : 1 for the exact derivative; 0 for shear of a slip that does not follow the pressure
    """
    old, olds, oldt, q, xs, xt, w, u = room[0], room[1], room[2], room[3], room[4], room[5], room[6], room[7]
    dn, dnu, nu, move, dy, dm, dc = room[8], room[9], room[10], room[11], room[12], room[13], room[14]
    size = normal_change(g1, g2, n, d1, d2, dn, dnu)
    dsize = 0.0
    for i in range(3):
        dsize += n[i] * dn[i] / size
    for i in range(3):
        nu[i] = n[i] / size
    dg = gap_change(row, row[GAP], nu, dr, dnu, slip)
    for i in range(3):
        move[i] = dr[i] - dg * nu[i] - row[GAP] * dnu[i] - slip[i]  # of the contact point along the facet
    ds, dt = natural_change(move, xs, xt)
    length = np.sqrt(y[0] ** 2 + y[1] ** 2 + y[2] ** 2)
    p, dp = row[TRACTION], row[WEIGHT] * eps * dg
    for i in range(3):
        dp += p / row[WEIGHT] * row[SLIDE + i] * move[i]
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
        dy[i] = dr[i] - slip[i] - move[i] + olds[i] * ds + oldt[i] * dt - dg * c[i] - row[GAP] * dc[i]
        z = r[i] - before[PLACE + i] - q[i] + old[i] - row[GAP] * c[i] + pull[i] / eps
        znu += z * nu[i]
        zdnu += z * dnu[i]
        dz_nu += dy[i] * nu[i]
    along = 0.0  # y times its change
    for i in range(3):
        dy[i] -= dz_nu * nu[i] + zdnu * nu[i] + znu * dnu[i]
        along += dy[i] * y[i]
    for i in range(3):
        shear = 0.0
        if row[STICKS] > 0.0:
            shear = eps * dy[i]
        elif length > 0.0:
            shear = (
                mu * (couples * dp * y[i] + p * dy[i]) / length - yields * along * row[DUAL + i] / length**2
            )
        df[i] = size * (dp * nu[i] + p * dnu[i] + shear) + dsize * row[PUSH + i]
    return ds, dt


@njit
def times(x, facets, N, dN, weights, eps, state, yields, facets2, v, out, mu, before, past, pull):
    """Derivative of `force` along v (n_points, 3), of the nodes on both sides, at fixed stick-slip status."""
    r, g1, g2, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    dr, d1, d2, df = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    y, c, m, slip, vs, vt = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    N2, dN2, room = np.empty(MOST_NODES), np.empty((MOST_NODES, 2)), np.empty((16, 3))
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            row = state[f, k]
            if row[TRACTION] == 0.0:
                continue
            nodes2 = facets2[int(row[FACET])]
            point_geometry(x, facets[f], N[k], dN[k], r, g1, g2, n)
            size, n2 = _slip(
                row, before[f, k], x, past, nodes2, pull[f, k], eps[f], r, g1, g2, n, y, c, m, room, N2, dN2
            )
            interpolate(v, facets[f], N[k], dN[k], dr, d1, d2)
            interpolate(v, nodes2, N2[:n2], dN2, slip, vs, vt)
            ds, dt = _change(
                row, before[f, k], pull[f, k], eps[f], mu, yields, 1.0, r, g1, g2, n, y, c, m, dr, d1, d2,
                slip, df, room,
            )  # fmt: skip
            for i in range(3):
                df[i] *= weights[k]
            spread(df, facets[f], N[k], out)
            for a in range(n2):
                change = weights[k] * size * (dN2[a, 0] * ds + dN2[a, 1] * dt)
                for i in range(3):
                    out[nodes2[a], i] -= N2[a] * df[i] + change * row[PUSH + i]


@njit
def blocks(x, facets, N, dN, weights, eps, state, yields, facets2, out, mu, before, past, pull, couples):
    """Tangent of each touching primary facet, out (n_facets, n, 3, n, 3); returns which facets touch."""
    touched = np.zeros(facets.shape[0], dtype=np.bool_)
    for f in range(facets.shape[0]):
        out[f] = 0.0
        for k in range(N.shape[0]):
            if state[f, k, TRACTION] != 0.0:
                touched[f] = True
                _add_block(
                    x, facets[f], N[k], dN[k], weights[k], eps[f], state[f, k], yields, facets2, out[f], mu,
                    before[f, k], past, pull[f, k], couples, 0,
                )  # fmt: skip
    return touched


@njit
def both_blocks(
    x, facets, N, dN, weights, eps, state, yields, facets2, which, out, mu, before, past, pull, couples
):
    """Tangent of the nodes on both sides, out (n_facet_pairs, n, 3, n, 3): those of the primary facet, then
    those of the secondary one.

    which (n_facets, n_gauss) : the pair of facets to which a touching point belongs
    """
    for f in range(facets.shape[0]):
        for k in range(N.shape[0]):
            if state[f, k, TRACTION] != 0.0:
                _add_block(
                    x, facets[f], N[k], dN[k], weights[k], eps[f], state[f, k], yields, facets2,
                    out[which[f, k]], mu, before[f, k], past, pull[f, k], couples, MOST_NODES,
                )  # fmt: skip


@njit
def _add_block(
    x, nodes, N, dN, weight, eps, row, yields, facets2, K, mu, before, past, pull, couples, most
):  # fmt: skip
    """K (n, 3, n, 3) += tangent of one point; `most` : of secondary nodes that are in K."""
    r, g1, g2, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    y, c, m, slip = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    dr, d1, d2, df = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    N2, dN2, room = np.empty(MOST_NODES), np.empty((MOST_NODES, 2)), np.empty((16, 3))
    nodes2 = facets2[int(row[FACET])]
    n1 = nodes.shape[0]
    point_geometry(x, nodes, N, dN, r, g1, g2, n)
    size, n2 = _slip(row, before, x, past, nodes2, pull, eps, r, g1, g2, n, y, c, m, room, N2, dN2)
    n2 = min(n2, most)
    for b in range(n1 + n2):
        for j in range(3):
            dr[:] = 0.0
            d1[:] = 0.0
            d2[:] = 0.0
            slip[:] = 0.0
            if b < n1:
                dr[j], d1[j], d2[j] = N[b], dN[b, 0], dN[b, 1]
            else:
                slip[j] = N2[b - n1]
            ds, dt = _change(
                row, before, pull, eps, mu, yields, couples, r, g1, g2, n, y, c, m, dr, d1, d2, slip, df, room
            )  # fmt: skip
            for i in range(3):
                for a in range(n1):
                    K[a, i, b, j] += weight * N[a] * df[i]
                for a in range(n2):
                    change = size * (dN2[a, 0] * ds + dN2[a, 1] * dt) * row[PUSH + i]
                    K[n1 + a, i, b, j] -= weight * (N2[a] * df[i] + change)
