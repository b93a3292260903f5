"""Derivatives of deformation, stress, energy and tangent at the integration points of a group.

With v = du/dtheta, the mesh's F = 1 + grad u changes by grad v. In addition, at fixed u, a change of the
prestrain G changes F G, the deformation gradient passed to the law, and a change of a law parameter changes
the stress, as given by its derivative programs.

Then dS = CC : sym(F' dF) + dS/dtheta, and so on by the chain rule. All derivatives are exact except that of
the tangent, see `materials.tangent_change`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem.derivatives.parameters import (
    LawParameter,
    Parameter,
    Prestrain,
    prestrain_change,
    programs,
)
from limbcli.fem.elements.element_loops import states_at_points
from limbcli.fem.elements.groups import Group, Operands
from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.materials.energy import program_energy_change, stored
from limbcli.materials.program import Compiled
from limbcli.materials.stress import tangent_change
from limbcli.materials.tensors import VOIGT
from limbcli.model import Array


@dataclass(frozen=True, eq=False)
class PointChanges:
    """Values and derivatives at the integration points of a group, (n_cells, n_gauss, 3, 3) unless stated.

    F : deformation gradient of the mesh; law_F : that passed to the law (F times the prestrain)
    S : second Piola-Kirchhoff stress, MPa; CC (n_cells, n_gauss, 6, 6) : dS/dE; stress : Cauchy stress, MPa
    dpar (1 or n_cells, n_numbers) : derivative of the law's numbers
    """

    material: Compiled
    operands: Operands
    F: Array
    dF: Array
    law_F: Array
    law_dF: Array
    S: Array
    dS: Array
    CC: Array
    dpar: Array

    @property
    def stress(self) -> Array:
        return np.asarray(self.law_F @ self.S @ _t(self.law_F) / np.linalg.det(self.law_F)[..., None, None])

    @property
    def d_stress(self) -> Array:
        F, dF = self.law_F, self.law_dF
        half = dF @ self.S @ _t(F)
        J = np.linalg.det(F)[..., None, None]
        growth = np.trace(np.linalg.solve(F, dF), axis1=-2, axis2=-1)[..., None, None]
        return np.asarray((half + _t(half) + F @ self.dS @ _t(F)) / J - growth * self.stress)

    @property
    def d_volume(self) -> Array:
        """Derivative (n_cells, n_gauss) of det F of the mesh."""
        return np.asarray(
            np.linalg.det(self.F) * np.trace(np.linalg.solve(self.F, self.dF), axis1=-2, axis2=-1)
        )

    @property
    def d_strain(self) -> Array:
        half = _t(self.dF) @ self.F
        return np.asarray(0.5 * (half + _t(half)))

    @property
    def d_energy(self) -> Array:
        """Derivative (n_cells, n_gauss) of the logged strain energy density, which is 0 with a prestrain."""
        o = self.operands
        if self.material.prestrain is not None:
            return np.zeros(o.weight.shape)
        if self.material.prony is not None:
            raise SolveError(
                "the logged energy of a viscoelastic law has no derivative here",
                where=f"material {self.material.name!r}, record 'sed'",
                fix="do not log sed, or difference whole solves",
            )
        return program_energy_change(stored(o.ops), o.par, self.law_F, self.law_dF, self.dpar)

    @property
    def d_tangent(self) -> Array:
        """Derivative (n_cells, n_gauss, 6, 6) of CC = dS/dE."""
        o, (n_cells, n_gauss) = self.operands, self.operands.weight.shape
        par, dpar = (np.repeat(p, n_gauss, axis=0) if len(p) > 1 else p for p in (o.par, self.dpar))
        F, dF = (each.reshape(-1, 3, 3) for each in (self.law_F, self.law_dF))
        change = tangent_change(o.ops, par, F, dF, dpar)
        return np.asarray(o.scale * change.reshape(n_cells, n_gauss, 6, 6))


def point_changes(
    system: System, state: State, number: int, parameter: Parameter, v: Array, *, tangent: bool = False
) -> PointChanges:
    """Derivatives at the points of a group at a converged state, for du/dtheta = v (n_points, 3).

    tangent : whether `CC` and `d_tangent` will be used
    """
    group, o = system.groups[number], system.operands[number]
    law_F, S, CC = states_at_points(system.threads, o.sloped(), state.u, tangent=True)
    F = law_F @ np.linalg.inv(o.base)
    dF = _gradient(group, v)
    law_dF = dF @ o.base
    if isinstance(parameter, Prestrain) and group.material.name == parameter.material:
        law_dF += F @ prestrain_change(group, parameter, system.curve)
    half = _t(law_F) @ law_dF
    E = 0.5 * (half + _t(half))[..., [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]] * [1, 1, 1, 2, 2, 2]
    dS = np.einsum("egpq,egq->egp", CC, E)
    direct, dpar = _of_the_law(system, state, number, parameter)
    if tangent and o.jumps:
        law_F, S, CC = states_at_points(system.threads, o, state.u, tangent=True)
    stresses = S[..., VOIGT], (dS + direct)[..., VOIGT]
    return PointChanges(group.material, o, F, dF, law_F, law_dF, *stresses, CC, dpar)


def _of_the_law(system: System, state: State, number: int, parameter: Parameter) -> tuple[Array, Array]:
    """Derivatives of S (n_cells, n_gauss, 6) at fixed deformation, and of the law's numbers."""
    group, o = system.groups[number], system.operands[number]
    dS, dpar = np.zeros((*o.weight.shape, 6)), np.zeros((1, o.par.shape[1]))
    if not isinstance(parameter, LawParameter) or number not in (found := programs(system, parameter)):
        return dS, dpar
    rates, weights = parameter.rates, parameter.weights
    dpar = dpar + group.material.change(rates, len(group.cells), system.curve, weights=weights)
    for program in found[number]:
        _, S, _ = states_at_points(system.threads, o.with_program(program), state.u)
        dS += S if program.factor is None else S * program.factor[:, None, None]
    return dS, dpar


def _gradient(group: Group, v: Array) -> Array:
    return np.einsum("eai,egaj->egij", v[group.cells], group.grad, optimize=True)


def _t(A: Array) -> Array:
    return np.swapaxes(A, -1, -2)
