"""Holmes-Mow solid: W = c/2 (e^Q - 1), c = (lambda + 2 mu) / (2 beta),

    Q = beta / (lambda + 2 mu) [(2 mu - lambda)(I1 - 3) + lambda (I2 - 3) - (lambda + 2 mu) ln J^2].

Parameters: mu, lambda (MPa) and beta. Source: Holmes & Mow 1990, J Biomech 23:1145;
FEBio User Manual 4.0, "Holmes-Mow".
"""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.materials.kernel import Deformation, Kernel
from limbcli.materials.law import FebioNames, Law
from limbcli.materials.tensors import add_outer, add_square, inverse6
from limbcli.numbers.compiled import njit


@njit
def invariants(C):
    """I1, I2 of a symmetric tensor of six numbers."""
    I1 = C[0] + C[1] + C[2]
    square = C[0] ** 2 + C[1] ** 2 + C[2] ** 2 + 2.0 * (C[3] ** 2 + C[4] ** 2 + C[5] ** 2)
    return I1, 0.5 * (I1 * I1 - square)


@njit
def add_holmes_mow(par, off, extra, J, work, S, CC, tangent):
    """S = e^Q/2 B, B = (2 mu - lambda) I + lambda (I1 I - C) - (lambda + 2 mu) C^-1."""
    C, inverse, B = work[0][0], work[0][1], work[0][2]
    mu, lam, beta = par[off], par[off + 1], par[off + 2]
    Ha = lam + 2.0 * mu
    inverse6(C, inverse)
    I1, I2 = invariants(C)
    Q = beta * (((2.0 * mu - lam) * (I1 - 3.0) + lam * (I2 - 3.0)) / Ha - 2.0 * np.log(J))
    e = 0.5 * np.exp(Q)
    for p in range(6):
        B[p] = -lam * C[p] - Ha * inverse[p]
        if p < 3:
            B[p] += 2.0 * mu - lam + lam * I1
        S[p] += e * B[p]
    if not tangent:
        return
    add_outer(CC, 2.0 * e * beta / Ha, B, B)  # dQ/dE = 2 beta/Ha B
    for p in range(3):
        for q in range(3):
            CC[p, q] += 2.0 * e * lam
    for p in range(6):
        CC[p, p] -= 2.0 * e * lam * (1.0 if p < 3 else 0.5)
    add_square(CC, 2.0 * e * Ha, inverse)


@njit
def add_holmes_mow_derivative(par, off, which, J, work, S, CC, tangent):
    """Derivative of S with respect to mu (which = 0), lambda (1) or beta (2)."""
    C, inverse = work[0][0], work[0][1]
    mu, lam, beta = par[off], par[off + 1], par[off + 2]
    Ha = lam + 2.0 * mu
    inverse6(C, inverse)
    I1, I2 = invariants(C)
    bracket = (2.0 * mu - lam) * (I1 - 3.0) + lam * (I2 - 3.0)
    Q = beta * (bracket / Ha - 2.0 * np.log(J))
    e = 0.5 * np.exp(Q)
    dmu = 1.0 if which == 0 else 0.0
    dlam = 1.0 if which == 1 else 0.0
    dHa = dlam + 2.0 * dmu
    if which == 2:
        dQ = Q / beta
    else:
        dbracket = (2.0 * dmu - dlam) * (I1 - 3.0) + dlam * (I2 - 3.0)
        dQ = beta * (dbracket / Ha - bracket * dHa / (Ha * Ha))
    for p in range(6):
        value = -lam * C[p] - Ha * inverse[p]
        change = -dlam * C[p] - dHa * inverse[p]
        if p < 3:
            value += 2.0 * mu - lam + lam * I1
            change += 2.0 * dmu - dlam + dlam * I1
        S[p] += e * (dQ * value + change)


def energy(p: Any, extra: int, at: Deformation) -> Any:
    """W (n_cells, n_gauss) MPa; p (n_cells, 3, 1)."""
    mu, lam, beta = p[:, 0], p[:, 1], p[:, 2]
    I1 = at.squares.sum(-1)
    I2 = 0.5 * (I1**2 - (at.squares**2).sum(-1))
    Ha = lam + 2 * mu
    Q = beta * (((2 * mu - lam) * (I1 - 3) + lam * (I2 - 3)) / Ha - 2 * np.log(at.J))
    return Ha / (4 * beta) * np.expm1(Q)


_DERIVATIVE = Kernel(add_holmes_mow_derivative)
LAW = Law(
    "holmes_mow",
    Kernel(add_holmes_mow, energy),
    {"mu": None, "lambda": None, "beta": None},
    lambda v: [v["mu"], v["lambda"], v["beta"]],
    {k: (_DERIVATIVE, k) for k in range(3)},
    positive=("mu",),
    febio=FebioNames("Holmes-Mow", (("beta", "beta"),), elastic_constants=True),
)
