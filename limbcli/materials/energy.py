"""Strain energy densities of the laws, for records and tests (not needed to solve)."""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.errors import SolveError
from limbcli.materials import dispatch
from limbcli.materials.fiber import A0
from limbcli.model import Array


def energy_density(operands: Any, F: Array) -> Array:
    """Energy per reference volume (MPa) at F (n_cells, n_gauss, 3, 3) of the mesh, for the program
    in `operands` (ops, par, base); a prestrain gradient in `base` comes before F."""
    return program_energy(operands.ops, operands.par, F @ operands.base)


def program_energy(ops: Array, par: Array, F: Array) -> Array:
    """Sum over the leaves of a program; par (1 or n_cells, n), F (n_cells, n_gauss, 3, 3)."""
    C = np.swapaxes(F, -1, -2) @ F
    squares = np.maximum(np.linalg.eigvalsh(C), 1e-300)
    J = np.linalg.det(F)
    total = np.zeros(J.shape)
    for law, off, extra in ops:
        p = par[:, off:, None]
        if law in (dispatch.OGDEN, dispatch.UNCOUPLED):
            total += _ogden(p, int(extra), squares, J, uncoupled=law == dispatch.UNCOUPLED)
        elif law == dispatch.NEO_HOOKE:
            lnJ = np.log(J)
            total += 0.5 * p[:, 0] * (squares.sum(-1) - 3 - 2 * lnJ) + 0.5 * p[:, 1] * lnJ**2
        elif law == dispatch.HOLMES_MOW:
            total += _holmes_mow(p, squares, J)
        elif law == dispatch.FIBER:
            total += _fiber(p, C)
        elif law == dispatch.CONTRACTION:
            total += 0.5 * p[:, 0] * (_I4(p, 1, C) - 1)
        else:
            raise SolveError("no energy for this law", where="record 'sed'", fix="do not log sed")
    return total


def _ogden(p: Array, n_terms: int, squares: Array, J: Array, *, uncoupled: bool) -> Array:
    lnJ = np.log(J)
    total = 0.5 * p[:, 0] * (lnJ**2 if uncoupled else (J - 1) ** 2)
    if uncoupled:
        squares = squares * (J ** (-2 / 3))[..., None]
    for k in range(n_terms):
        c, m = p[:, 1 + 2 * k], p[:, 2 + 2 * k]
        powers = (squares ** (0.5 * m[..., None])).sum(-1) - 3
        total += c / m**2 * (powers - (0.0 if uncoupled else m * lnJ))
    return total


def _holmes_mow(p: Array, squares: Array, J: Array) -> Array:
    mu, lam, beta = p[:, 0], p[:, 1], p[:, 2]
    I1 = squares.sum(-1)
    I2 = 0.5 * (I1**2 - (squares**2).sum(-1))
    Ha = lam + 2 * mu
    Q = beta * (((2 * mu - lam) * (I1 - 3) + lam * (I2 - 3)) / Ha - 2 * np.log(J))
    return Ha / (4 * beta) * np.expm1(Q)


def _direction(p: Array, at: int, C: Array) -> Array:
    return np.broadcast_to(p[:, at : at + 3, 0][:, None, :], (*C.shape[:2], 3))


def _I4(p: Array, at: int, C: Array) -> Array:
    a = _direction(p, at, C)
    return np.einsum("egi,egij,egj->eg", a, C, a)


def _fiber(p: Array, C: Array) -> Array:
    a = _direction(p, A0, C)
    I4 = _I4(p, A0, C)
    x = np.maximum(I4 - p[:, 4] ** 2, 0.0)
    alpha, beta = p[:, 1], p[:, 2]
    small = np.abs(alpha) < 1e-12
    safe = np.where(small, 1.0, alpha)
    stretch = np.where(small, x**beta / beta, np.expm1(alpha * x**beta) / (safe * beta))
    D = np.einsum("egij,egj->egi", C - np.eye(3), a)
    return np.where(p[:, 4] ** 2 < I4, p[:, 0] * stretch + 0.25 * p[:, 3] * (D**2).sum(-1), 0.0)
