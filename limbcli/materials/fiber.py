"""Fibres along a0: the exponential-power law.

`fiber-exp-pow` (tension only, I4 = a0.C.a0 > lam0^2):
    W = ksi/(alpha beta) (exp(alpha x^beta) - 1) + mu/4 a0.(C - 1)^2.a0,  x = I4 - lam0^2
(alpha = 0: ksi/beta x^beta). For I4 <= lam0^2 both the fibre and the shear term vanish.

When a sheared fibre begins to be stretched, the stress of the shear term jumps. A cell whose equilibrium
would lie on the jump has none, so the term is ramped up linearly from I4 = lam0^2 to lam0^2 + JUMP (or the
parameter `band`, which FEBio does not have; a wider band converges faster).
The slope of this ramp does not derive from an energy: its tangent is not symmetric, and is added on request.

Source: FEBio User Manual 4.0, "Fiber with Exponential-Power Law".
"""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.materials.kernel import Deformation, Kernel
from limbcli.materials.law import FebioNames, Law
from limbcli.materials.tensors import FIRST, SECOND, VOIGT, add_outer
from limbcli.numbers.compiled import njit

JUMP = 1e-3
KSI, ALPHA, BETA, MU, LAM0, BAND, A0 = 0, 1, 2, 3, 4, 5, 6


@njit
def fibre_dyad(par, off, A):
    """A = a0 a0 (6) from the direction at par[off:off+3]."""
    for p in range(6):
        A[p] = par[off + FIRST[p]] * par[off + SECOND[p]]


@njit
def fibre_square(A, C):
    """I4 = a0.C.a0."""
    return A[0] * C[0] + A[1] * C[1] + A[2] * C[2] + 2.0 * (A[3] * C[3] + A[4] * C[4] + A[5] * C[5])


@njit
def symmetric_product(A, C, p):
    """Component p of sym(A C)."""
    i, j = FIRST[p], SECOND[p]
    total = 0.0
    for k in range(3):
        total += A[VOIGT[i, k]] * C[VOIGT[k, j]] + A[VOIGT[j, k]] * C[VOIGT[k, i]]
    return 0.5 * total


@njit
def add_fiber(par, off, sloped, J, work, S, CC, tangent):
    """Add the law's stress. sloped : include the slope of the shear term's ramp in the tangent"""
    C, A = work[0][0], work[0][1]
    ksi, alpha, beta, mu = par[off], par[off + ALPHA], par[off + BETA], par[off + MU]
    fibre_dyad(par, off + A0, A)
    I4 = fibre_square(A, C)
    if par[off + LAM0] ** 2 >= I4:
        return
    x = I4 - par[off + LAM0] ** 2
    band = par[off + BAND]
    part = min(x / band, 1.0)
    e = np.exp(alpha * x**beta)
    slope = ksi * x ** (beta - 1.0) * e
    curve = 0.0
    if tangent:
        curve = ksi * e * (alpha * beta * x ** (2.0 * beta - 2.0))
        if beta == 2.0:
            curve += ksi * e
        else:
            curve += ksi * e * (beta - 1.0) * x ** (beta - 2.0)
    for p in range(6):
        shear = mu * (symmetric_product(A, C, p) - A[p])
        S[p] += 2.0 * slope * A[p] + part * shear
        if tangent and sloped and x < band:
            for q in range(6):
                CC[p, q] += 2.0 * shear / band * A[q]
    if not tangent:
        return
    mu *= part
    add_outer(CC, 4.0 * curve, A, A)
    for p in range(6):  # 2 mu d sym(A C)/dC
        i, j = FIRST[p], SECOND[p]
        for q in range(6):
            k, l = FIRST[q], SECOND[q]
            value = 0.0
            if j == l:
                value += A[VOIGT[i, k]]
            if j == k:
                value += A[VOIGT[i, l]]
            if i == l:
                value += A[VOIGT[j, k]]
            if i == k:
                value += A[VOIGT[j, l]]
            CC[p, q] += 0.5 * mu * value


@njit
def add_fiber_derivative(par, off, which, J, work, S, CC, tangent):
    """Derivative of S with respect to ALPHA, BETA, LAM0 or BAND."""
    C, A = work[0][0], work[0][1]
    ksi, alpha, beta = par[off], par[off + ALPHA], par[off + BETA]
    lam0, band = par[off + LAM0], par[off + BAND]
    fibre_dyad(par, off + A0, A)
    x = fibre_square(A, C) - lam0 * lam0
    if x <= 0.0:
        return
    power = x**beta
    slope = ksi * x ** (beta - 1.0) * np.exp(alpha * power)
    change, part = 0.0, 0.0
    if which == ALPHA:
        change = slope * power
    elif which == BETA:
        change = slope * np.log(x) * (1.0 + alpha * power)
    elif which == LAM0:
        change = -2.0 * lam0 * slope * (beta - 1.0 + alpha * beta * power) / x
        part = -2.0 * lam0 / band if x < band else 0.0
    elif x < band:
        part = -x / (band * band)
    for p in range(6):
        S[p] += 2.0 * change * A[p]
        if part != 0.0:
            S[p] += part * par[off + MU] * (symmetric_product(A, C, p) - A[p])


def stretch_square(p: Any, first: int, C: Any) -> tuple[Any, Any]:
    """The direction at p[:, first:] (n_cells, n_gauss, 3), and I4 along it (n_cells, n_gauss)."""
    a = np.broadcast_to(p[:, first : first + 3, 0][:, None, :], (*C.shape[:2], 3))
    return a, np.einsum("egi,egij,egj->eg", a, C, a)


def energy(p: Any, extra: int, at: Deformation) -> Any:
    """W (n_cells, n_gauss) MPa; p (n_cells, 9, 1)."""
    a, I4 = stretch_square(p, A0, at.C)
    x = I4 - p[:, LAM0] ** 2
    stretched = np.real(x) > 0.0
    alpha, beta = p[:, ALPHA], p[:, BETA]
    small = np.abs(alpha) < 1e-12
    safe = np.where(small, 1.0, alpha)
    power = np.where(stretched, x, 1.0) ** beta
    stretch = np.where(small, power * (1 + 0.5 * alpha * power), np.expm1(alpha * power) / safe) / beta
    D = np.einsum("egij,egj->egi", at.C - np.eye(3), a)
    return np.where(stretched, p[:, KSI] * stretch + 0.25 * p[:, MU] * (D**2).sum(-1), 0.0)


_DERIVATIVE = Kernel(add_fiber_derivative)
LAW = Law(
    "fiber_exp_pow",
    Kernel(add_fiber, energy, jump=MU),
    {"ksi": None, "alpha": 0.0, "beta": 2.0, "mu": 0.0, "lam0": 1.0, "band": JUMP},
    lambda v: [v["ksi"], v["alpha"], v["beta"], v["mu"], v["lam0"], v["band"]],
    {k: (_DERIVATIVE, k) for k in (ALPHA, BETA, LAM0, BAND)},
    fiber=True,
    febio=FebioNames("fiber-exp-pow", tuple((each, each) for each in ("ksi", "alpha", "beta", "mu", "lam0"))),
)
