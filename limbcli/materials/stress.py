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
from limbcli.model import Array, Material
from limbcli.numbers.compiled import njit


@njit
def _evaluate(F, ops, par, S, CC, tangent):
    work = workspace()
    J = np.empty(F.shape[0])
    for k in range(F.shape[0]):
        row = k if par.shape[0] > 1 else 0
        J[k] = second_piola(F[k], ops, par[row], S[k], CC[k], tangent, work)
    return J


def tangents_at_rest(program: Program) -> Array:
    """dS/dE at F = 1, Voigt (n, 6, 6) MPa; n is 1 if all cells have the same numbers."""
    n = len(program.par)
    F = np.repeat(np.eye(3)[None], n, axis=0)
    S, CC = np.zeros((n, 6)), np.zeros((n, 6, 6))
    _evaluate(F, program.ops, program.par, S, CC, True)
    return CC


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
