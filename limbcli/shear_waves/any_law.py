"""Small-amplitude plane waves in deformed tissue of any law, from the law's own tangent.

A wave along n (unit, in the deformed tissue) with polarisation a adds a (x) N, N = F'n, to the deformation
gradient F. With P = F S, where S is the second Piola-Kirchhoff stress,

    rho0 v^2 = a.Q a,   Q_ik = N_J N_L dP_iJ/dF_kL = delta_ik N.S N + F_iM (N.CC.N)_MP F_kP

and CC = dS/dE. No finite differences are used, so mixtures, maps and exponential laws are as exact as their
tangent.

Source: Ogden 1984, Non-Linear Elastic Deformations, section 6.4.
"""

from __future__ import annotations

import numpy as np

from limbcli.materials.fiber import A0, BAND, JUMP, LAM0
from limbcli.materials.program import Compiled, Program, compile_material
from limbcli.materials.stress import program_stress
from limbcli.model import Array, Curved, IntArray, Material, Value


def acoustic_tensor(
    material: Material, deformation_gradient: Array, direction: Array, *, cells: IntArray | None = None,
    n_cells: int = 1, viscous: bool = True,
) -> Array:  # fmt: skip
    """Q = J (c_ijkl + sigma_jl delta_ik) n_j n_l; its eigenvalues are rho0 v^2.

    Load curves are taken as 1. A viscoelastic law responds instantaneously (with the sum of its g_i), a
    prestrained one with the fraction r of its prestrain given by its ramp. Fibres at the onset of stretch
    count as stretched, however wide the transition over which a solver engages them: a wave along them
    stretches them in any case.

    deformation_gradient : (n, 3, 3), det > 0
    direction : (3,) unit, in the deformed tissue
    cells : (n,) cell numbers within the material's block of `n_cells`, used if a parameter is a map
    viscous : the instantaneous response of a viscoelastic law; if False, that of the elastic law it wraps

    Returns (n, 3, 3) MPa

    >>> soft = Material("neo_hooke", {"mu": 0.004, "lambda": 0.4})
    >>> Q = acoustic_tensor(soft, np.eye(3)[None], np.array([1.0, 0.0, 0.0]))
    >>> np.diag(Q[0]).round(6)
    array([0.408, 0.004, 0.004])
    """
    F = np.asarray(deformation_gradient, dtype=float)
    J = np.linalg.det(F)
    compiled = compile_material(material, material.law)
    whole = compiled.program(n_cells, lambda name: 1.0)
    par = whole.par if len(whole.par) == 1 or cells is None else whole.par[cells]
    if compiled.prestrain is not None:
        F = F @ _prestrain(*compiled.prestrain)
    factor = J / np.linalg.det(F)
    par, F = _past_the_jump(compiled, par, F)
    S, CC = program_stress(Program(whole.ops, np.ascontiguousarray(par)), F)
    n = np.asarray(direction, dtype=float)
    N = np.einsum("nji,j->ni", F, n)
    Q = np.einsum("nj,njl,nl->n", N, S, N)[:, None, None] * np.eye(3)
    Q += F @ np.einsum("nmjpl,nj,nl->nmp", CC, N, N) @ np.swapaxes(F, 1, 2)
    if compiled.prony is not None and viscous:
        factor = factor * (compiled.prony[0] + sum(g for g, _ in compiled.prony[1]))
    return np.asarray(Q * factor[:, None, None])


def _prestrain(F0: Array, ramp: Value) -> Array:
    """(1 - r) 1 + r F0, with its load curve taken as 1.

    >>> _prestrain(np.diag([1.2, 1.0, 0.8]), 0.5).diagonal().round(6)
    array([1.1, 1. , 0.9])
    """
    r = ramp.value if isinstance(ramp, Curved) else float(ramp)  # type: ignore[arg-type]
    return np.asarray((1.0 - r) * np.eye(3) + r * F0)


def _past_the_jump(compiled: Compiled, par: Array, F: Array) -> tuple[Array, Array]:
    """Law parameters with the narrowest fibre transition, and F moved off the onset of fibre stretch.

    Where a fibre is exactly at the onset, F is scaled by 1.0005.
    """
    par, on = par.copy(), np.zeros(len(F), dtype=bool)
    offset = 0
    for leaf in compiled.leaves:
        if leaf.name == "fiber_exp_pow":
            par[:, offset + BAND] = JUMP
            direction = par[:, offset + A0 : offset + A0 + 3]
            least = par[:, offset + LAM0] ** 2
            square = np.sum(np.einsum("nij,nj->ni", F, np.broadcast_to(direction, (len(F), 3))) ** 2, axis=1)
            on |= (square >= least * (1 - 1e-9)) & (square <= least + JUMP)
        offset += leaf.n_slots
    return par, np.asarray(np.where(on[:, None, None], np.sqrt(1 + 1.01 * JUMP) * F, F))
