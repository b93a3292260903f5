"""Strain energy densities of programs, for records and tests (not needed by the solver)."""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.errors import SolveError
from limbcli.materials.kernel import Deformation, kernel_of
from limbcli.model import Array, IntArray


def energy_density(operands: Any, F: Array) -> Array:
    """Stored energy density (MPa) at the mesh's F (n_cells, n_gauss, 3, 3) for a group's operands.

    The law's deformation gradient is F times the prestrain gradient in `operands.base`.
    """
    return program_energy(stored(operands.ops), operands.par, F @ operands.base)


def stored(ops: IntArray) -> IntArray:
    """The rows of `ops` that store energy; as in FEBio's log, work done by muscles is excluded."""
    return ops[[not kernel_of(number).works for number in ops[:, 0]]]


def program_energy(ops: IntArray, par: Array, F: Array) -> Array:
    """Energy density (n_cells, n_gauss) of a program; par (1 or n_cells, n), F (n_cells, n_gauss, 3, 3)."""
    return energy_at(ops, par, deformation_of(F))


def deformation_of(F: Array) -> Deformation:
    """The arguments of the energy functions at F (n_cells, n_gauss, 3, 3)."""
    C = np.swapaxes(F, -1, -2) @ F
    return Deformation(C, np.maximum(np.linalg.eigvalsh(C), 1e-300), np.linalg.det(F))


def program_energy_change(ops: IntArray, par: Array, F: Array, dF: Array, dpar: Array | None = None) -> Array:
    """Directional derivative of `program_energy` along dF (as F) and dpar (as par), exact to round-off.

    By a complex step; principal values change by r_i.dC r_i, for any choice of directions r_i of equal ones.

    >>> from limbcli.materials.neo_hooke import KERNEL
    >>> ops, par = np.array([[KERNEL.number, 0, 0]]), np.array([[2.0, 5.0]])
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
    energy = energy_at(ops, moved, Deformation(C + h * dC, squares, J + h * dJ))
    return np.asarray(np.imag(energy) / abs(h))


def energy_at(ops: IntArray, par: Any, at: Deformation) -> Array:
    """Energy density (n_cells, n_gauss) of a program; par (1 or n_cells, n); complex for a complex step."""
    total = np.zeros(at.J.shape, dtype=at.J.dtype)
    for number, off, extra in ops:
        energy = kernel_of(number).energy
        if energy is None:
            raise SolveError("no energy for this law", where="record 'sed'", fix="do not log sed")
        total += energy(par[:, off:, None], int(extra), at)
    return total
