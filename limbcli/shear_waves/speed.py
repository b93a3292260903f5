"""Shear-wave speed in deformed tissue of any law: small waves on a large deformation.

A wave along n that moves the tissue along a (across n) adds eps a (x) F'n to the
deformation gradient F; the volume does not change, and

    rho0 v^2 = d^2 W(F + eps a (x) F'n) / d eps^2   at eps = 0.

Here by central differences of the energy (relative error 1e-5), so that mixtures with
fibres, maps and contraction need no formula of their own.

Source: Ogden 1984, Non-Linear Elastic Deformations, section 6.4.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli import units
from limbcli.materials import compile_material
from limbcli.materials.energy import program_energy
from limbcli.materials.program import Program
from limbcli.model import Array, IntArray, LimbModel

_STEP = 3e-3


def log_speed(
    model: LimbModel,
    material: str,
    F: Array,
    cells: IntArray,
    *,
    curve_value: float = 1.0,
    density_kg_per_m3: float = 1000.0,
) -> Array:
    """ln of the speed (m/s) of the wave along x moving along z, at `cells` of the material's block.

    Parameters
    ----------
    F : (n, 3, 3), det > 0; cells : (n,) numbers within the block
    curve_value : of load curves that a parameter follows

    Returns
    -------
    (n,), NaN where no wave can run (rho0 v^2 <= 0)
    """  # fmt: skip
    program = _program(model, material, cells, curve_value)
    ops: Any = program.ops
    n, a = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    wave = np.einsum("i,nj->nij", a, np.einsum("nji,j->ni", F, n))
    energies = [
        program_energy(ops, program.par, (F + step * wave)[:, None])[:, 0] for step in (-_STEP, 0.0, _STEP)
    ]
    modulus = (energies[0] - 2 * energies[1] + energies[2]) / _STEP**2
    density = units.tonne_per_mm3_from_kg_per_m3(density_kg_per_m3)
    mm_per_s = np.sqrt(np.where(modulus > 0, modulus, np.nan) / density)
    return np.asarray(np.log(units.m_per_s_from_mm_per_s(mm_per_s)))


def _program(model: LimbModel, material: str, cells: IntArray, curve_value: float) -> Program:
    """The material's numbers at the chosen cells only."""
    compiled = compile_material(model.materials[material], material)
    block = next(each.block for each in model.domains if each.material == material)
    whole = compiled.program(len(model.mesh.block(block).cells), lambda name: curve_value)
    par = whole.par if len(whole.par) == 1 else whole.par[cells]
    return Program(whole.ops, np.ascontiguousarray(par))
