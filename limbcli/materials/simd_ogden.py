"""Ogden's law (see `ogden`) at sixteen points at once.

Terms with exponents 2 and -2 have a closed form; all others are evaluated in principal axes. Squared
stretches and their directions are computed by Jacobi's method, with the same sequence of rotations for all
points.
"""

from __future__ import annotations

import numpy as np

from limbcli.materials.simd import (
    ALPHA,
    BETA,
    CC,
    KAPPA,
    LANES,
    LOGS,
    MINUS,
    PLUS,
    QUOTIENTS,
    SLOPES,
    SQUARES,
    TAU,
    VECTORS,
    C,
    D,
    H,
    J,
    P,
    S,
    X,
    add_product,
    expm1,
    log,
    series_log,
)  # fmt: skip
from limbcli.materials.tensors import FIRST, SECOND
from limbcli.numbers.compiled import njit

_SWEEPS = 5  # number of Jacobi sweeps, enough for round-off accuracy
_NEAR = 1e-2  # relative difference of squared stretches up to which quotients use a cancellation-free form


@njit(forceinline=True)
def _turn(app, aqq, apq):
    """tan, cos and sin of the rotation that makes apq vanish."""
    away = abs(apq) > 1e-300
    theta = 0.5 * (aqq - app) / (apq if away else 1.0)
    t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
    t = -t if theta < 0.0 else t
    t = t if away else 0.0
    c = 1.0 / np.sqrt(t * t + 1.0)
    return t, c, t * c


@njit
def principal_stretches(w):
    """Squared principal stretches, logarithms of the stretches, and directions, by Jacobi's method."""
    for k in range(3 * LANES):
        w[SQUARES * LANES + k], w[P * LANES + k] = w[C * LANES + k], w[(C + 3) * LANES + k]
    w[VECTORS * LANES : (VECTORS + 9) * LANES] = 0.0
    for k in (VECTORS, VECTORS + 4, VECTORS + 8):
        w[k * LANES : (k + 1) * LANES] = 1.0
    for _ in range(_SWEEPS):
        _sweep(w)
    for k in range(3 * LANES):
        square = w[SQUARES * LANES + k]
        w[LOGS * LANES + k] = 0.5 * log(square if square > 0.0 else 1.0)


@njit
def _sweep(w):
    """One sweep: eliminate each off-diagonal entry, stored at P, once."""
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


@njit(forceinline=True)
def _quotient(m, si, sj, li, lj, ei, ej):
    """(l_j^m - l_i^m) / (l_j^2 - l_i^2); s squares, l logarithms, e powers less 1."""
    x = (sj - si) / si
    near = abs(x) <= _NEAR
    apart = (ej - ei) / (1.0 if near else sj - si)
    x = x if near and abs(x) > 1e-30 else 1e-30
    s = x / (2.0 + x)
    return (1.0 + ei) * expm1(0.5 * m * (s * series_log(s))) / (x * si) if near else apart


@njit
def add_powers(w, par, rows, off, n_terms, tangent):
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
            at = H * LANES + l
            w[at], w[at + LANES], w[at + 2 * LANES] = e0, e1, e2
        if not tangent:
            continue
        for l in range(LANES):
            c, m = w[PLUS * LANES + l], w[MINUS * LANES + l]
            at = LOGS * LANES + l
            l0, l1, l2 = w[at], w[at + LANES], w[at + 2 * LANES]
            at = H * LANES + l
            e0, e1, e2 = w[at], w[at + LANES], w[at + 2 * LANES]
            at = SQUARES * LANES + l
            s0, s1, s2 = w[at], w[at + LANES], w[at + 2 * LANES]
            at = QUOTIENTS * LANES + l
            part = c / m
            w[at] += part * _quotient(m, s0, s1, l0, l1, e0, e1)
            w[at + LANES] += part * _quotient(m, s1, s2, l1, l2, e1, e2)
            w[at + 2 * LANES] += part * _quotient(m, s0, s2, l0, l2, e0, e2)
    _from_principal(w, tangent)


@njit
def _from_principal(w, tangent):
    """As `principal.add_principal`, for tau_i that depends only on its own stretch."""
    for l in range(LANES):  # overwrite tau and slopes with S_i and the factors of the normal block
        sound = w[J * LANES + l] > 0.0
        for i in range(3):
            square, tau = w[(SQUARES + i) * LANES + l], w[(TAU + i) * LANES + l]
            per = 1.0 / square if sound else 0.0
            w[(TAU + i) * LANES + l] = tau * per
            w[(SLOPES + i) * LANES + l] = (w[(SLOPES + i) * LANES + l] - 2.0 * tau) * per * per
    for l in range(LANES):  # and the quotients with the factors of the shear terms
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


@njit(forceinline=True)
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


@njit
def add_pressure(w):
    """kappa (J - 1) as a Cauchy pressure."""
    for l in range(LANES):
        kappa, jac = w[KAPPA * LANES + l], w[J * LANES + l]
        w[BETA * LANES + l] += kappa * (jac - 1.0) * jac
        w[ALPHA * LANES + l] += kappa * (2.0 * jac - 1.0) * jac


@njit
def add_squares(w, par, rows, off, n_terms):
    """Terms with exponents 2 and -2: c+/2 (1 - D) + c-/2 (D - D^2); c+, c-: sums of c_k with either sign of
    exponent."""
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
