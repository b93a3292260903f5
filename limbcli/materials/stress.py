"""Stresses of a law at given deformation gradients, outside a simulation.

For tests, plots, wave speeds and derivatives, evaluated by `dispatch.second_piola` point by point. The
internal force and tangent of a simulation use `simd_laws`, which has a second, vectorised implementation of
Ogden's law and calls `second_piola` for all others; tests/materials/test_simd.py checks that both agree.
"""

from __future__ import annotations

import numpy as np

from limbcli.materials.dispatch import second_piola, workspace
from limbcli.materials.program import Program, compile_material
from limbcli.materials.tensors import VOIGT
from limbcli.model import Array, IntArray, Material
from limbcli.numbers.compiled import njit


@njit
def _evaluate(F, ops, par, S, CC, tangent):
    work = workspace()
    J = np.empty(F.shape[0])
    for k in range(F.shape[0]):
        row = k if par.shape[0] > 1 else 0
        J[k] = second_piola(F[k], ops, par[row], S[k], CC[k], tangent, work)
    return J


def tangents(ops: IntArray, par: Array, F: Array) -> Array:
    """dS/dE (n, 6, 6), Voigt order, MPa, at F (n, 3, 3); ops, par (n or 1, n_numbers) : of a program"""
    S, CC = np.zeros((len(F), 6)), np.zeros((len(F), 6, 6))
    _evaluate(F, ops, par, S, CC, True)
    return CC


def tangents_at_rest(program: Program, cells: IntArray | None = None) -> Array:
    """The same at F = 1, of these cells, or of all (n is 1 if all have the same numbers)."""
    par = program.par if cells is None or len(program.par) == 1 else program.par[cells]
    n = len(program.par) if cells is None else len(cells)
    return tangents(program.ops, par, np.repeat(np.eye(3)[None], n, axis=0))


def second_piola_kirchhoff(material: Material, F: Array) -> tuple[Array, Array]:
    """S (n, 3, 3) MPa and its tangent CC = dS/dE (n, 3, 3, 3, 3) of an elastic law at F (n, 3, 3).

    Load curves are taken as 1. Where det F <= 0 both are zero.
    """
    program = compile_material(material, material.law).program(len(F), lambda name: 1.0)
    return program_stress(program, F)


def program_stress(program: Program, F: Array) -> tuple[Array, Array]:
    """As `second_piola_kirchhoff`, for a program with one row of numbers, or one per deformation gradient."""
    F = np.ascontiguousarray(F, dtype=float)
    S, CC = np.zeros((len(F), 6)), np.zeros((len(F), 6, 6))
    _evaluate(F, program.ops, program.par, S, CC, True)
    return S[:, VOIGT], CC[:, VOIGT][:, :, :, VOIGT]


def cauchy_stress(material: Material, F: Array) -> Array:
    """Cauchy stress F S F' / J (n, 3, 3) in MPa at F (n, 3, 3).

    >>> from limbcli.materials import ogden_type
    >>> F = np.diag([1.0, 1.0, 0.9])[None]
    >>> bool(abs(cauchy_stress(ogden_type(c=0.005, f_kappa=1.0, m=2.0), F)[0, 2, 2] + 0.0010897) < 1e-7)
    True
    """
    F = np.asarray(F, dtype=float)
    S, _ = second_piola_kirchhoff(material, F)
    return F @ S @ np.swapaxes(F, 1, 2) / np.linalg.det(F)[:, None, None]


def penalty_modulus(C: Array, normals: Array) -> Array:
    """Stiffness along `normals` (n, 3) used by FEBio's automatic contact penalty, MPa.

    1 / (nn : S : nn), with S the inverse of the tangents C (n, 6, 6), Voigt, at F = 1. FEBio uses the entries
    of the 6x6 inverse, whose shears are engineering compliances, as tensor components; hence the factor 2 on
    the shear products. For normals along a coordinate axis this is Young's modulus; otherwise it is lower, in
    nearly incompressible tissue by 1 % at 2 degrees, and 0.3 of it at 45 degrees. Identified by comparing
    nodal forces with those of FEBio 4.11.
    """
    n = normals
    products = np.stack(
        [
            n[:, 0] ** 2,
            n[:, 1] ** 2,
            n[:, 2] ** 2,
            2 * n[:, 0] * n[:, 1],
            2 * n[:, 1] * n[:, 2],
            2 * n[:, 0] * n[:, 2],
        ],
        axis=1,
    )
    return 1.0 / np.einsum("np,npq,nq->n", products, np.linalg.inv(C), products)


_STEP = 6e-6


def tangent_change(ops: IntArray, par: Array, F: Array, dF: Array, dpar: Array) -> Array:
    """Derivative (n, 6, 6) of CC = dS/dE, Voigt order, along dF (n, 3, 3) and dpar (n or 1, n_numbers).

    It is a third derivative of the energy, which the kernels do not provide. The law itself is cheap and
    smooth: with a step of 6e-6 (the cube root of round-off) in F and in its numbers, central differences have
    about nine correct digits, six with exponents of a hundred.

    par, dpar (n or 1, n_numbers) : numbers of a program and their change; F (n, 3, 3)

    The step is chosen for each point such that F changes by at most 6e-6 and every number by at most 6e-6 of
    itself. Where a fibre is exactly at the onset of its stretch the tangent is discontinuous and the result
    is meaningless.
    """
    sizes = np.where(par == 0.0, 1.0, abs(par))
    fastest = np.maximum(abs(dF).max(axis=(1, 2)), (abs(dpar) / sizes).max(axis=1, initial=0.0))
    step = np.where(fastest > 0.0, _STEP / np.where(fastest > 0.0, fastest, 1.0), 0.0)
    ends = []
    for h in (step, -step):
        moved = np.ascontiguousarray(F + h[:, None, None] * dF)
        ends.append(tangents(ops, np.ascontiguousarray(par + h[:, None] * dpar), moved))
    width = np.where(step > 0.0, 2 * step, 1.0)
    return np.asarray((ends[0] - ends[1]) / width[:, None, None])
