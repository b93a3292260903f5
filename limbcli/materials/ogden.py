"""Ogden's law, unconstrained and uncoupled, in the tissue's parameters.

Unconstrained (FEBio "Ogden unconstrained"), up to six terms:

    W = sum_k c_k/m_k^2 (l1^m_k + l2^m_k + l3^m_k - 3 - m_k ln J) + kappa/2 (J - 1)^2

with ground shear modulus sum(c_k)/2 and kappa Lame's lambda. The tissue law of the
project, Psi = c/(2 m^2) sum(l^m + l^-m - 2) + kappa/2 (J - 1)^2, is c1 = c2 = c/2,
m1 = m, m2 = -m: the logarithms cancel.

Uncoupled (FEBio "Ogden"): W = sum_k c_k/m_k^2 (sum lt^m_k - 3) + k/2 (ln J)^2 with
lt = J^(-1/3) l.

Source: FEBio User Manual 4.0, "Ogden Unconstrained" and "Ogden".
"""

from __future__ import annotations

import numpy as np
from numba import njit

from limbcli.errors import SolveError
from limbcli.materials.principal import add_principal
from limbcli.model import Material

MAX_TERMS = 6


def ogden_type(*, c: float, f_kappa: float, m: float) -> Material:
    """The tissue law: Psi = c/(2 m^2) sum(l^m + l^-m - 2) + f_kappa c/2 (J - 1)^2.

    c : MPa, twice the ground shear modulus; f_kappa, m : without unit. m = 2 is the
    "Mooney-Rivlin type".

    >>> ogden_type(c=0.005, f_kappa=100.0, m=2.0).parameters["kappa"]
    0.5
    """
    if not (np.isfinite([c, f_kappa, m]).all() and c > 0 and f_kappa > 0 and m != 0):
        raise SolveError(
            f"no Ogden law with c = {c}, f_kappa = {f_kappa}, m = {m}",
            where="material parameters",
            fix="c and f_kappa must be positive and m not zero",
            c=c,
            f_kappa=f_kappa,
            m=m,
        )
    return Material("ogden", {"c1": c / 2, "m1": m, "c2": c / 2, "m2": -m, "kappa": f_kappa * c})


@njit(cache=True)
def power_quotient(m, si, sj, pi, pj):
    """(l_j^m - l_i^m) / (l_j^2 - l_i^2) without cancellation; s squares, p powers."""
    x = (sj - si) / si
    if abs(x) > 1e-2:
        return (pj - pi) / (sj - si)
    if x == 0.0:
        return 0.5 * m * pi / si
    return pi * np.expm1(0.5 * m * np.log1p(x)) / (x * si)


@njit(cache=True)
def add_ogden(par, off, n_terms, J, squares, logs, vectors, tau, a, d, S, CC, tangent):
    """par[off:] = kappa, c1, m1, c2, m2, ...; logs = ln l_i."""
    pressure = par[off] * (J - 1.0) * J
    slope = par[off] * (2.0 * J - 1.0) * J
    for i in range(3):
        tau[i] = pressure
        d[i] = 0.0
        for j in range(3):
            a[i, j] = slope
    for k in range(n_terms):
        c = par[off + 1 + 2 * k]
        if c == 0.0:
            continue
        m = par[off + 2 + 2 * k]
        p0, p1, p2 = np.exp(m * logs[0]), np.exp(m * logs[1]), np.exp(m * logs[2])
        tau[0] += c / m * np.expm1(m * logs[0])
        tau[1] += c / m * np.expm1(m * logs[1])
        tau[2] += c / m * np.expm1(m * logs[2])
        if tangent:
            a[0, 0] += c * p0
            a[1, 1] += c * p1
            a[2, 2] += c * p2
            d[0] += c / m * power_quotient(m, squares[0], squares[1], p0, p1)
            d[1] += c / m * power_quotient(m, squares[1], squares[2], p1, p2)
            d[2] += c / m * power_quotient(m, squares[0], squares[2], p0, p2)
    add_principal(squares, vectors, tau, a, d, S, CC, tangent)


@njit(cache=True)
def add_ogden_exponent_derivative(par, off, term, squares, logs, vectors, tau, a, d, S, CC):
    """dS/dm of one term: tau_i = c (l^m ln l / m - (l^m - 1) / m^2)."""
    c, m = par[off + 1 + 2 * term], par[off + 2 + 2 * term]
    for i in range(3):
        tau[i] = c * (np.exp(m * logs[i]) * logs[i] / m - np.expm1(m * logs[i]) / (m * m))
    add_principal(squares, vectors, tau, a, d, S, CC, False)


@njit(cache=True)
def add_uncoupled(par, off, n_terms, J, squares, logs, vectors, tau, a, d, S, CC, tangent):
    """Uncoupled Ogden: the deviator of sum c_k/m_k lt^m_k, plus k ln J."""
    lnJ = np.log(J)
    f0, f1, f2, g0, g1, g2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    d[0] = d[1] = d[2] = 0.0
    for k in range(n_terms):
        c = par[off + 1 + 2 * k]
        if c == 0.0:
            continue
        m = par[off + 2 + 2 * k]
        iso = np.exp(-m * lnJ / 3.0)
        p0, p1, p2 = np.exp(m * logs[0]), np.exp(m * logs[1]), np.exp(m * logs[2])
        f0 += c / m * np.expm1(m * (logs[0] - lnJ / 3.0))
        f1 += c / m * np.expm1(m * (logs[1] - lnJ / 3.0))
        f2 += c / m * np.expm1(m * (logs[2] - lnJ / 3.0))
        g0 += c * p0 * iso
        g1 += c * p1 * iso
        g2 += c * p2 * iso
        if tangent:
            d[0] += c / m * iso * power_quotient(m, squares[0], squares[1], p0, p1)
            d[1] += c / m * iso * power_quotient(m, squares[1], squares[2], p1, p2)
            d[2] += c / m * iso * power_quotient(m, squares[0], squares[2], p0, p2)
    mean = (f0 + f1 + f2) / 3.0
    pressure = par[off] * lnJ
    tau[0], tau[1], tau[2] = f0 - mean + pressure, f1 - mean + pressure, f2 - mean + pressure
    g = (g0, g1, g2)
    third = (g0 + g1 + g2) / 9.0
    for i in range(3):
        for j in range(3):
            a[i, j] = par[off] + third - (g[i] + g[j]) / 3.0
        a[i, i] += g[i]
    add_principal(squares, vectors, tau, a, d, S, CC, tangent)


@njit(cache=True)
def add_uncoupled_exponent_derivative(par, off, term, J, squares, logs, vectors, tau, a, d, S, CC):
    """dS/dm of one term of the uncoupled law."""
    c, m = par[off + 1 + 2 * term], par[off + 2 + 2 * term]
    third = np.log(J) / 3.0
    mean = 0.0
    for i in range(3):
        x = logs[i] - third
        tau[i] = c * (np.exp(m * x) * x / m - np.expm1(m * x) / (m * m))
        mean += tau[i] / 3.0
    for i in range(3):
        tau[i] -= mean
    add_principal(squares, vectors, tau, a, d, S, CC, False)
