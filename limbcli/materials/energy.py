"""Strain energy densities of programs, for records and tests (not needed by the solver)."""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.errors import SolveError
from limbcli.materials.kernel import Deformation, kernel_of
from limbcli.materials.program import Program
from limbcli.materials.stress import program_stress
from limbcli.model import Array, IntArray

_MOST = 60  # iterations for the exponent of a series spring
_EXACT = 1e-12  # change of the exponent below which it has been found
_LEAST_EXPONENT = 1e-3  # FEBio takes a smaller one as 0


def energy_density(operands: Any, F: Array) -> Array:
    """Stored energy density (MPa) at the mesh's F (n_cells, n_gauss, 3, 3) for a group's operands.

    The law's deformation gradient is F times the prestrain gradient in `operands.base`.
    """
    return program_energy(stored(operands.ops), operands.par, F @ operands.base)


def viscoelastic_energy(
    operands: Any, F: Array, prony: tuple[float, tuple[tuple[float, float], ...]], viscous: Array
) -> Array:
    """Energy density (n_cells, n_gauss) that FEBio logs for a viscoelastic law: g0 W(U) + sum g_i W(U^a_i).

    U^a_i is the stretch of the elastic spring of term i, whose dashpot takes the rest: a_i in [0, 1] solves
    g_i S(U^a_i) : U = viscous : U. As in FEBio, every term is given the whole viscous stress, and the
    stretch of term i is that of term i - 1 to the power a_i.

    F, viscous (n_cells, n_gauss, 3, 3) : deformation gradient; S minus the elastic base's S (MPa)

    Source: FEBio 4.11, FEViscoElasticMaterial::StrainEnergyDensity and SeriesStretchExponent.
    """
    g0, terms = prony
    total = g0 * energy_density(operands, F)
    squares, axes = np.linalg.eigh(np.swapaxes(F, -1, -2) @ F)
    logs = 0.5 * np.log(np.maximum(squares, 1e-300))
    exponent = np.ones(F.shape[:2])
    for g, _ in terms:
        if g > 0:
            exponent = exponent * _spring_exponent(operands, axes, logs, viscous / g)
            total += g * energy_density(operands, _power(axes, logs, exponent))
    return total


def _power(axes: Array, logs: Array, exponent: Array) -> Array:
    """U^exponent, from the axes and the logarithms of the stretches."""
    return np.einsum("...ia,...a,...ja->...ij", axes, np.exp(exponent[..., None] * logs), axes)


def _spring_exponent(operands: Any, axes: Array, logs: Array, viscous: Array) -> Array:
    """The exponent a (n_cells, n_gauss) with S(U^a) : U = viscous : U, by Newton's method in [0, 1]."""
    shape = logs.shape[:-1]
    U = _power(axes, logs, np.ones(shape)).reshape(-1, 3, 3)
    axes, logs, aim = axes.reshape(-1, 3, 3), logs.reshape(-1, 3), (viscous.reshape(-1, 3, 3) * U).sum((1, 2))
    par = np.repeat(operands.par, shape[1], axis=0) if len(operands.par) > 1 else operands.par
    low, high, a = np.zeros(len(U)), np.ones(len(U)), np.ones(len(U))
    for _ in range(_MOST):
        S, CC = program_stress(Program(operands.ops, par), _power(axes, logs, a))
        excess = (S * U).sum((1, 2)) - aim
        growth = np.einsum("nia,na,nja->nij", axes, np.exp(2 * a[:, None] * logs) * logs, axes)
        slope = np.einsum("nij,nijkl,nkl->n", U, CC, growth)
        # in compression S : U falls with the exponent
        above = excess * np.sign(slope) > 0
        low, high = np.where(above, low, a), np.where(above, a, high)
        step = np.divide(excess, slope, out=np.zeros_like(a), where=slope != 0)
        trial = np.clip(a - step, 0.0, 1.0)
        inside = (trial >= low) & (trial <= high)
        new = np.where(inside, trial, 0.5 * (low + high))
        if np.abs(new - a).max(initial=0.0) < _EXACT:
            break
        a = new
    return np.where(a < _LEAST_EXPONENT, 0.0, a).reshape(shape)


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
