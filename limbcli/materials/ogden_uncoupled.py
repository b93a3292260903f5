"""Ogden's law, uncoupled (FEBio "Ogden"), up to six terms:

    W = sum_k c_k/m_k^2 (sum lt^m_k - 3) + k/2 (ln J)^2 with lt = J^(-1/3) l.

Source: FEBio User Manual 4.0, "Ogden".
"""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.materials.kernel import Deformation, Kernel
from limbcli.materials.law import FebioNames, Law
from limbcli.materials.ogden import (
    FEBIO_TERMS,
    PARAMETERS,
    check_terms,
    exponents,
    n_terms,
    power_quotient,
    slots,
    with_terms,
)
from limbcli.materials.principal import add_principal, principal_axes
from limbcli.numbers.compiled import njit


@njit
def add_uncoupled(par, off, n_terms, J, work, S, CC, tangent):
    """Kirchhoff stress: deviator of sum c_k/m_k lt^m_k plus k ln J; par[off:] = k, c1, m1, c2, m2, ..."""
    principal_axes(work)
    squares, logs, tau, d = work[1][0], work[1][1], work[1][2], work[1][3]
    a = work[3]
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
    add_principal(squares, work[2], tau, a, d, S, CC, tangent)


@njit
def add_uncoupled_exponent_derivative(par, off, term, J, work, S, CC, tangent):
    """Derivative of S with respect to the exponent m of one term."""
    principal_axes(work)
    squares, logs, tau, d = work[1][0], work[1][1], work[1][2], work[1][3]
    c, m = par[off + 1 + 2 * term], par[off + 2 + 2 * term]
    third = np.log(J) / 3.0
    mean = 0.0
    for i in range(3):
        x = logs[i] - third
        tau[i] = c * (np.exp(m * x) * x / m - np.expm1(m * x) / (m * m))
        mean += tau[i] / 3.0
    for i in range(3):
        tau[i] -= mean
    add_principal(squares, work[2], tau, work[3], d, S, CC, False)


def energy(p: Any, extra: int, at: Deformation) -> Any:
    """W (n_cells, n_gauss) MPa; p (n_cells, 1 + 2 n_terms, 1)."""
    isochoric = at.squares * (at.J ** (-2 / 3))[..., None]
    return with_terms(0.5 * p[:, 0] * np.log(at.J) ** 2, p, extra, isochoric, 0.0)


KERNEL = Kernel(add_uncoupled, energy)
LAW = Law(
    "ogden_uncoupled",
    KERNEL,
    PARAMETERS,
    slots,
    exponents(Kernel(add_uncoupled_exponent_derivative)),
    n_terms,
    positive=("kappa",),
    check=check_terms,
    terms=True,
    uncoupled=True,
    febio=FebioNames("Ogden", (("k", "kappa"), *FEBIO_TERMS)),
)
