"""A law from outside the package: an exponential one for soft tissue, made compressible.

    W = mu/(2 b) (exp(b (I1 - 3)) - 1) - mu ln J + lambda/2 (ln J)^2

Source: Demiray 1972, J Biomech 5:309, with the volume terms of the compressible neo-Hookean solid.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from limbcli.materials.kernel import Kernel
from limbcli.materials.law import FebioNames, Law
from limbcli.materials.tensors import add_outer, add_square, inverse6


@njit
def add_demiray(par, off, extra, J, work, S, CC, tangent):
    C, inverse = work[0][0], work[0][1]
    mu, lam, b = par[off], par[off + 1], par[off + 2]
    inverse6(C, inverse)
    e = mu * np.exp(b * (C[0] + C[1] + C[2] - 3.0))
    pressure = lam * np.log(J) - mu
    for p in range(6):
        S[p] += pressure * inverse[p]
        if p < 3:
            S[p] += e
    if tangent:
        for p in range(3):
            for q in range(3):
                CC[p, q] += 2.0 * b * e
        add_outer(CC, lam, inverse, inverse)
        add_square(CC, -2.0 * pressure, inverse)


@njit
def add_derivative_by_b(par, off, extra, J, work, S, CC, tangent):
    C = work[0][0]
    x = C[0] + C[1] + C[2] - 3.0
    for p in range(3):
        S[p] += par[off] * x * np.exp(par[off + 2] * x)


def energy(p, extra, at):
    mu, lam, b = p[:, 0], p[:, 1], p[:, 2]
    lnJ = np.log(at.J)
    return mu / (2 * b) * np.expm1(b * (at.squares.sum(-1) - 3)) - mu * lnJ + 0.5 * lam * lnJ**2


LAW = Law(
    "demiray",
    Kernel(add_demiray, energy),
    {"mu": None, "lambda": None, "b": 0.5},
    lambda v: [v["mu"], v["lambda"], v["b"]],
    {2: (Kernel(add_derivative_by_b), 0)},
    positive=("mu", "b"),
    febio=FebioNames("demiray plug-in", (("mu", "mu"), ("lambda", "lambda"), ("b", "b"))),
)
