"""Strain energy densities of the laws, for records and tests (not needed to solve)."""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.errors import SolveError
from limbcli.materials import dispatch
from limbcli.materials.fiber import A0
from limbcli.model import Array, IntArray


def energy_density(operands: Any, F: Array) -> Array:
    """Energy per reference volume (MPa) at F (n_cells, n_gauss, 3, 3) of the mesh, for the program
    in `operands` (ops, par, base); a prestrain gradient in `base` comes before F."""
    return program_energy(operands.ops, operands.par, F @ operands.base)


def program_energy(ops: IntArray, par: Array, F: Array) -> Array:
    """Sum over the leaves of a program; par (1 or n_cells, n), F (n_cells, n_gauss, 3, 3)."""
    C = np.swapaxes(F, -1, -2) @ F
    squares = np.maximum(np.linalg.eigvalsh(C), 1e-300)
    return _energy(ops, par, C, squares, np.linalg.det(F))


def program_energy_change(ops: IntArray, par: Array, F: Array, dF: Array, dpar: Array | None = None) -> Array:
    """Change of `program_energy` along dF (as F) and dpar (as par), to round-off.

    A complex step; principal squares move by r_i.dC r_i, whatever directions r_i belong to equal ones.

    >>> ops, par = np.array([[3, 0, 0]]), np.array([[2.0, 5.0]])  # neo-Hookean
    >>> program_energy_change(ops, par, np.eye(3)[None, None] * 1.1, np.eye(3)[None, None]).round(6)
    array([[5.044507]])
    """
    h = 1e-30j
    C = np.swapaxes(F, -1, -2) @ F
    dC = np.swapaxes(F, -1, -2) @ dF
    dC = dC + np.swapaxes(dC, -1, -2)
    values, vectors = np.linalg.eigh(C)
    squares = np.maximum(values, 1e-300) + h * np.einsum("...ji,...jk,...ki->...i", vectors, dC, vectors)
    J = np.linalg.det(F)
    dJ = J * np.trace(np.linalg.solve(F, dF), axis1=-2, axis2=-1)
    moved = par + 0j if dpar is None else par + h * dpar
    return np.asarray(np.imag(_energy(ops, moved, C + h * dC, squares, J + h * dJ)) / abs(h))


def _energy(ops: IntArray, par: Any, C: Any, squares: Any, J: Any) -> Array:
    """Real, or complex for a complex step."""
    total = np.zeros(J.shape, dtype=J.dtype)
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
    x = I4 - p[:, 4] ** 2
    stretched = np.real(x) > 0.0
    alpha, beta = p[:, 1], p[:, 2]
    small = np.abs(alpha) < 1e-12
    safe = np.where(small, 1.0, alpha)
    power = np.where(stretched, x, 1.0) ** beta
    stretch = np.where(small, power * (1 + 0.5 * alpha * power), np.expm1(alpha * power) / safe) / beta
    D = np.einsum("egij,egj->egi", C - np.eye(3), a)
    return np.where(stretched, p[:, 0] * stretch + 0.25 * p[:, 3] * (D**2).sum(-1), 0.0)
