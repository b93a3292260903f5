"""Stress and tangent at sixteen points at once: `dispatch.second_piola` for the element loops.

All numbers of the sixteen points stand in rows of one flat array (`wide`). Ogden's unconstrained law,
the tissue's, is computed in vectors; other laws are added point by point.

S = beta D + what is given by the law, with D = C^-1; its tangent is
alpha D (x) D + the symmetric product of D with X + what is given: pressure, and Ogden's terms with
exponents 2 and -2, are numbers alpha and beta and a tensor X.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from limbcli.materials.dispatch import OGDEN, second_piola
from limbcli.materials.elementary import expm1, log, series_log
from limbcli.materials.ogden import all_squares
from limbcli.materials.tensors import FIRST, SECOND, VOIGT
from limbcli.materials.wide import LANES, add_product, add_three

# rows: numbers of each point
F, J, C, D, S, CC = 0, 9, 10, 16, 22, 28  # 9, 1, 6, 6, 6, 21 (the upper triangle, row by row)
ALPHA, BETA, X = 49, 50, 51  # 1, 1, 6
PLUS, MINUS, KAPPA = 57, 58, 59
SQUARES, LOGS, VECTORS, TAU, SLOPES, QUOTIENTS = 60, 63, 66, 75, 78, 81  # 3, 3, 9, 3, 3, 3
P, H = 84, 102  # 18, 6
WEIGHT, SHIFT = 108, 109
STRESS, TANGENT, PRODUCTS = 110, 119, 173  # of the element loops: 9, 54, 54
N_ROWS = 227

UPPER = np.zeros((6, 6), dtype=np.int64)  # row of the tangent's upper triangle
UPPER[np.triu_indices(6)] = np.arange(21)
UPPER += np.triu(UPPER, 1).T
_SWEEPS = 5  # of Jacobi's method: to round-off
_NEAR = 1e-2  # squares of stretches so near each other that their difference cancels


@njit(cache=True, error_model="numpy")
def room():
    """The rows, and what point-by-point laws need."""
    return np.zeros(N_ROWS * LANES), np.empty((3, 3)), np.empty(6), np.empty((6, 6))


@njit(cache=True, error_model="numpy")
def measure(w):
    """J, C and D of all F. Where J is not positive D is 0, and no stress comes of it."""
    for l in range(LANES):
        a, b, c = w[l], w[LANES + l], w[2 * LANES + l]
        d, e, f = w[3 * LANES + l], w[4 * LANES + l], w[5 * LANES + l]
        g, h, i = w[6 * LANES + l], w[7 * LANES + l], w[8 * LANES + l]
        jac = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
        w[J * LANES + l] = jac
        xx, yy, zz = a * a + d * d + g * g, b * b + e * e + h * h, c * c + f * f + i * i
        xy, yz, xz = a * b + d * e + g * h, b * c + e * f + h * i, a * c + d * f + g * i
        at = C * LANES + l
        w[at], w[at + LANES], w[at + 2 * LANES] = xx, yy, zz
        w[at + 3 * LANES], w[at + 4 * LANES], w[at + 5 * LANES] = xy, yz, xz
        p, q, r = yy * zz - yz * yz, yz * xz - xy * zz, xy * yz - yy * xz
        det = xx * p + xy * q + xz * r
        part = 1.0 / det if jac > 0.0 else 0.0
        at = D * LANES + l
        w[at], w[at + LANES], w[at + 2 * LANES] = (
            p * part,
            (xx * zz - xz * xz) * part,
            (xx * yy - xy * xy) * part,
        )
        w[at + 3 * LANES], w[at + 4 * LANES], w[at + 5 * LANES] = (
            q * part,
            (xy * xz - xx * yz) * part,
            r * part,
        )


@njit(cache=True, error_model="numpy")
def add_laws(w, ops, par, rows, tangent, place, six, square, work):
    """Stress of the program at all points, after `measure`; rows (16,) : of `par`. To be `finish`ed.

    place (3, 3), six (6,), square (6, 6), work : room for laws that go point by point
    """
    w[S * LANES : (X + 6) * LANES] = 0.0
    spectral = False
    for leaf in range(ops.shape[0]):
        law, off, n_terms = ops[leaf, 0], ops[leaf, 1], ops[leaf, 2]
        if law != OGDEN:
            _add_by_points(w, ops[leaf : leaf + 1], par, rows, tangent, place, six, square, work)
            continue
        squares = True
        for l in range(LANES):
            w[KAPPA * LANES + l] = par[rows[l], off]
            squares &= all_squares(par[rows[l]], off, n_terms)
        _add_pressure(w)
        if squares:
            _add_squares(w, par, rows, off, n_terms)
            continue
        if not spectral:
            _principal(w)
            spectral = True
        _add_powers(w, par, rows, off, n_terms, tangent)


@njit(cache=True, error_model="numpy")
def _add_by_points(w, ops, par, rows, tangent, place, six, square, work):
    for l in range(LANES):
        for k in range(9):
            place[k // 3, k % 3] = w[(F + k) * LANES + l]
        second_piola(place, ops, par[rows[l]], six, square, tangent, work)
        for p in range(6):
            w[(S + p) * LANES + l] += six[p]
        if tangent:
            for p in range(6):
                for q in range(p, 6):
                    w[(CC + UPPER[p, q]) * LANES + l] += square[p, q]


@njit(cache=True, error_model="numpy")
def _add_pressure(w):
    """kappa (J - 1) as a Cauchy pressure."""
    for l in range(LANES):
        kappa, jac = w[KAPPA * LANES + l], w[J * LANES + l]
        w[BETA * LANES + l] += kappa * (jac - 1.0) * jac
        w[ALPHA * LANES + l] += kappa * (2.0 * jac - 1.0) * jac


@njit(cache=True, error_model="numpy")
def _add_squares(w, par, rows, off, n_terms):
    """Terms with exponents 2 and -2: c+/2 (1 - D) + c-/2 (D - D^2), c+, c- the sums of c_k of either sign."""
    w[PLUS * LANES : (MINUS + 1) * LANES] = 0.0
    for l in range(LANES):
        for k in range(n_terms):
            row = PLUS if par[rows[l], off + 2 + 2 * k] > 0.0 else MINUS
            w[row * LANES + l] += 0.5 * par[rows[l], off + 1 + 2 * k]
    for l in range(LANES):
        plus, minus = w[PLUS * LANES + l], w[MINUS * LANES + l]
        w[BETA * LANES + l] += minus - plus
        at = D * LANES + l
        a, b, c = w[at], w[at + LANES], w[at + 2 * LANES]
        d, e, f = w[at + 3 * LANES], w[at + 4 * LANES], w[at + 5 * LANES]
        xx, yy, zz = a * a + d * d + f * f, d * d + b * b + e * e, f * f + e * e + c * c
        xy, yz, xz = a * d + d * b + f * e, d * f + b * e + e * c, a * f + d * e + f * c
        at = X * LANES + l
        w[at] += minus * xx
        w[at + LANES] += minus * yy
        w[at + 2 * LANES] += minus * zz
        w[at + 3 * LANES] += minus * xy
        w[at + 4 * LANES] += minus * yz
        w[at + 5 * LANES] += minus * xz
        at = S * LANES + l
        w[at] += plus - minus * xx
        w[at + LANES] += plus - minus * yy
        w[at + 2 * LANES] += plus - minus * zz
        w[at + 3 * LANES] -= minus * xy
        w[at + 4 * LANES] -= minus * yz
        w[at + 5 * LANES] -= minus * xz


@njit(cache=True, error_model="numpy", inline="always")
def _turn(app, aqq, apq):
    """tan, cos and sin of the rotation that makes apq vanish."""
    away = abs(apq) > 1e-300
    theta = 0.5 * (aqq - app) / (apq if away else 1.0)
    t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
    t = -t if theta < 0.0 else t
    t = t if away else 0.0
    c = 1.0 / np.sqrt(t * t + 1.0)
    return t, c, t * c


@njit(cache=True, error_model="numpy")
def _principal(w):
    """Squares of the principal stretches, their logarithms (half), and directions, by Jacobi's method."""
    w[SQUARES * LANES : (SQUARES + 3) * LANES] = w[C * LANES : (C + 3) * LANES]
    w[P * LANES : (P + 3) * LANES] = w[(C + 3) * LANES : (C + 6) * LANES]
    w[VECTORS * LANES : (VECTORS + 9) * LANES] = 0.0
    for k in (VECTORS, VECTORS + 4, VECTORS + 8):
        w[k * LANES : (k + 1) * LANES] = 1.0
    for _ in range(_SWEEPS):
        _sweep(w)
    for k in range(3 * LANES):
        square = w[SQUARES * LANES + k]
        w[LOGS * LANES + k] = 0.5 * log(square if square > 0.0 else 1.0)


@njit(cache=True, error_model="numpy")
def _sweep(w):
    """Each entry beside the diagonal, at P, made to vanish once."""
    for l in range(LANES):
        at = SQUARES * LANES + l
        a, b, c = w[at], w[at + LANES], w[at + 2 * LANES]
        at = P * LANES + l
        d, e, f = w[at], w[at + LANES], w[at + 2 * LANES]
        at = VECTORS * LANES + l
        v00, v01, v02 = w[at], w[at + LANES], w[at + 2 * LANES]
        v10, v11, v12 = w[at + 3 * LANES], w[at + 4 * LANES], w[at + 5 * LANES]
        v20, v21, v22 = w[at + 6 * LANES], w[at + 7 * LANES], w[at + 8 * LANES]
        t, x, y = _turn(a, b, d)
        a, b, d = a - t * d, b + t * d, 0.0
        f, e = x * f - y * e, y * f + x * e
        v00, v01 = x * v00 - y * v01, y * v00 + x * v01
        v10, v11 = x * v10 - y * v11, y * v10 + x * v11
        v20, v21 = x * v20 - y * v21, y * v20 + x * v21
        t, x, y = _turn(a, c, f)
        a, c, f = a - t * f, c + t * f, 0.0
        d, e = x * d - y * e, y * d + x * e
        v00, v02 = x * v00 - y * v02, y * v00 + x * v02
        v10, v12 = x * v10 - y * v12, y * v10 + x * v12
        v20, v22 = x * v20 - y * v22, y * v20 + x * v22
        t, x, y = _turn(b, c, e)
        b, c, e = b - t * e, c + t * e, 0.0
        d, f = x * d - y * f, y * d + x * f
        v01, v02 = x * v01 - y * v02, y * v01 + x * v02
        v11, v12 = x * v11 - y * v12, y * v11 + x * v12
        v21, v22 = x * v21 - y * v22, y * v21 + x * v22
        at = SQUARES * LANES + l
        w[at], w[at + LANES], w[at + 2 * LANES] = a, b, c
        at = P * LANES + l
        w[at], w[at + LANES], w[at + 2 * LANES] = d, e, f
        at = VECTORS * LANES + l
        w[at], w[at + LANES], w[at + 2 * LANES] = v00, v01, v02
        w[at + 3 * LANES], w[at + 4 * LANES], w[at + 5 * LANES] = v10, v11, v12
        w[at + 6 * LANES], w[at + 7 * LANES], w[at + 8 * LANES] = v20, v21, v22


@njit(cache=True, error_model="numpy", inline="always")
def _quotient(m, si, sj, li, lj, ei, ej):
    """(l_j^m - l_i^m) / (l_j^2 - l_i^2); s squares, l logarithms, e powers less 1."""
    x = (sj - si) / si
    near = abs(x) <= _NEAR
    apart = (ej - ei) / (1.0 if near else sj - si)
    x = x if near and abs(x) > 1e-30 else 1e-30
    s = x / (2.0 + x)
    return (1.0 + ei) * expm1(0.5 * m * (s * series_log(s))) / (x * si) if near else apart


@njit(cache=True, error_model="numpy")
def _add_powers(w, par, rows, off, n_terms, tangent):
    """Terms with any exponents, in principal axes: see `principal` and `ogden.add_ogden`."""
    w[TAU * LANES : (QUOTIENTS + 3) * LANES] = 0.0
    for k in range(n_terms):
        for l in range(LANES):
            c, m = par[rows[l], off + 1 + 2 * k], par[rows[l], off + 2 + 2 * k]
            w[PLUS * LANES + l], w[MINUS * LANES + l] = c, m if m != 0.0 else 1.0
        for l in range(LANES):
            c, m = w[PLUS * LANES + l], w[MINUS * LANES + l]
            at = LOGS * LANES + l
            l0, l1, l2 = w[at], w[at + LANES], w[at + 2 * LANES]
            e0, e1, e2 = expm1(m * l0), expm1(m * l1), expm1(m * l2)
            at = TAU * LANES + l
            part = c / m
            w[at] += part * e0
            w[at + LANES] += part * e1
            w[at + 2 * LANES] += part * e2
            at = SLOPES * LANES + l
            w[at] += c * (1.0 + e0)
            w[at + LANES] += c * (1.0 + e1)
            w[at + 2 * LANES] += c * (1.0 + e2)
            if tangent:
                at = SQUARES * LANES + l
                s0, s1, s2 = w[at], w[at + LANES], w[at + 2 * LANES]
                at = QUOTIENTS * LANES + l
                w[at] += part * _quotient(m, s0, s1, l0, l1, e0, e1)
                w[at + LANES] += part * _quotient(m, s1, s2, l1, l2, e1, e2)
                w[at + 2 * LANES] += part * _quotient(m, s0, s2, l0, l2, e0, e2)
    _from_principal(w, tangent)


@njit(cache=True, error_model="numpy")
def _from_principal(w, tangent):
    """As `principal.add_principal`, where tau_i depends on its own stretch alone."""
    for l in range(LANES):  # S_i and the normal block's factors in place of tau and slopes
        sound = w[J * LANES + l] > 0.0
        for i in range(3):
            square, tau = w[(SQUARES + i) * LANES + l], w[(TAU + i) * LANES + l]
            per = 1.0 / square if sound else 0.0
            w[(TAU + i) * LANES + l] = tau * per
            w[(SLOPES + i) * LANES + l] = (w[(SLOPES + i) * LANES + l] - 2.0 * tau) * per * per
    for l in range(LANES):  # and the shear terms' in place of the quotients
        sound = w[J * LANES + l] > 0.0
        for pair in range(3):
            i, j = (1 if pair == 1 else 0), (1 if pair == 0 else 2)
            square, at = w[(SQUARES + j) * LANES + l], (QUOTIENTS + pair) * LANES + l
            w[at] = (w[at] - w[(TAU + i) * LANES + l]) / square if sound else 0.0
    w[P * LANES : (P + 18) * LANES] = 0.0
    for i in range(3):
        for p in range(6):
            add_product(w, P + 6 * i + p, VECTORS + 3 * FIRST[p] + i, VECTORS + 3 * SECOND[p] + i)
            add_product(w, S + p, TAU + i, P + 6 * i + p)
    if not tangent:
        return
    for i in range(3):
        _add_outer(w, SLOPES + i, P + 6 * i)
    for pair in range(3):
        i, j = (1 if pair == 1 else 0), (1 if pair == 0 else 2)
        w[P * LANES : (P + 6) * LANES] = 0.0
        for p in range(6):
            k, n = FIRST[p], SECOND[p]
            add_product(w, P + p, VECTORS + 3 * k + i, VECTORS + 3 * n + j)
            add_product(w, P + p, VECTORS + 3 * n + i, VECTORS + 3 * k + j)
        _add_outer(w, QUOTIENTS + pair, P)


@njit(cache=True, error_model="numpy", inline="always")
def _add_outer(w, factor, a):
    """CC += factor a (x) a."""
    w[H * LANES : (H + 6) * LANES] = 0.0
    for p in range(6):
        add_product(w, H + p, factor, a + p)
    k = CC
    for p in range(6):
        for q in range(p, 6):
            add_product(w, k, H + p, a + q)
            k += 1


@njit(cache=True, error_model="numpy")
def finish(w, tangent):
    """Pressures taken in, with SHIFT more; S and, if wanted, CC are then complete."""
    for l in range(LANES):
        shift = w[SHIFT * LANES + l] * w[J * LANES + l]
        w[ALPHA * LANES + l] += shift
        w[BETA * LANES + l] += shift
        half = 0.5 * w[BETA * LANES + l]
        w[H * LANES + l] = -half
    for p in range(6):
        add_product(w, S + p, BETA, D + p)
        add_product(w, X + p, H, D + p)
    if not tangent:
        return
    w[P * LANES : (P + 6) * LANES] = 0.0
    for p in range(6):
        add_product(w, P + p, ALPHA, D + p)
    k = CC
    for p in range(6):
        i, j = FIRST[p], SECOND[p]
        for q in range(p, 6):
            m, n = FIRST[q], SECOND[q]
            im, jn, i_n, jm = VOIGT[i, m], VOIGT[j, n], VOIGT[i, n], VOIGT[j, m]
            add_three(w, k, P + p, D + q, D + im, X + jn, X + im, D + jn)
            add_product(w, k, D + i_n, X + jm)
            add_product(w, k, X + i_n, D + jm)
            k += 1
