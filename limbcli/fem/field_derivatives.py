"""Derivatives of logged cell and node fields by a parameter, from a sensitivity.

A field is a function of displacements, of the law's numbers, of places and prestrain. Its change along
du/dtheta is a central difference of the field alone (no solve; about eight digits), as is its
direct dependence on places and prestrain; that on a law's number is exact.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem import kernels
from limbcli.fem.fields import _STRESS, NODE_FIELDS, cell_fields
from limbcli.fem.parameters import (
    LawParameter,
    Parameter,
    Prestrain,
    Shape,
    Tied,
    moved_system,
    nudged,
    programs,
)
from limbcli.fem.sensitivity import Sensitivity
from limbcli.fem.state import State
from limbcli.fem.system import System
from limbcli.materials import Program
from limbcli.materials.tensors import VOIGT
from limbcli.model import Array

_STEP_MM = 1e-4


def cell_field_derivatives(
    system: System,
    state: State,
    number: int,
    fields: tuple[str, ...],
    parameter: Parameter,
    sensitivity: Sensitivity,
) -> Array:
    """d(field)/d(theta) (n_cells, n_fields) of a group's cells: J, F, E, stress components, places."""
    for name in fields:
        if name in ("sed", "s1", "s2", "s3") or name.startswith("c"):
            raise SolveError(
                f"the derivative of {name!r} is not available",
                where="derivative of a field",
                fix="use J, F, E or stress components, and combine them",
            )
    v = sensitivity.displacement
    h = _STEP_MM / max(float(abs(v).max()), 1e-30)
    up, down = (
        cell_fields(system, replace(state, u=state.u + sign * h * v), number, fields) for sign in (1.0, -1.0)
    )
    return (up - down) / (2 * h) + _direct(system, state, number, fields, parameter)


def _direct(
    system: System, state: State, number: int, fields: tuple[str, ...], parameter: Parameter
) -> Array:
    """The change (n_cells, n_fields) of the fields at held displacements."""
    out = np.zeros((len(system.groups[number].cells), len(fields)))
    if isinstance(parameter, Shape):
        ends = []
        for sign in (1.0, -1.0):
            moved = moved_system(system, parameter, sign)
            moved.at(state.time)
            ends.append(cell_fields(moved, state, number, fields))
        return (ends[0] - ends[1]) / (2 * parameter.step)
    if isinstance(parameter, Prestrain):
        if system.groups[number].material.name != parameter.material:
            return out
        ends = []
        for sign in (1.0, -1.0):
            operands = nudged(system, number, parameter, sign * parameter.step)
            with system.standing_in(number, operands):
                ends.append(cell_fields(system, state, number, fields))
        return (ends[0] - ends[1]) / (2 * parameter.step)
    parts = parameter.parts if isinstance(parameter, Tied) else ()
    parts = ((parameter, 1.0),) if isinstance(parameter, LawParameter) else parts
    for part, rate in parts:
        found = programs(system, part).get(number, [])
        direct = sum((_stress_change(system, state, number, each) for each in found), np.zeros(()))
        for k, name in enumerate(fields):
            if name in _STRESS and direct.ndim:
                i, j = np.argwhere(_STRESS[name] == VOIGT)[0]
                out[:, k] += rate * direct[:, :, i, j].mean(axis=1)
    return out


def _stress_change(system: System, state: State, number: int, program: Program) -> Array:
    """Cauchy stress (n_cells, n_gauss, 3, 3) of a derivative program at held displacements."""
    o = system.operands[number].with_program(program)
    F, S = np.empty((*o.weight.shape, 3, 3)), np.empty((*o.weight.shape, 6))
    kernels.stress_state(0, len(o.cells), state.u, *o.arguments(), F, S, np.zeros((0, 1, 6, 6)))
    if program.factor is not None:
        S *= program.factor[:, None, None]
    return np.asarray(F @ S[..., VOIGT] @ np.swapaxes(F, -1, -2) / np.linalg.det(F)[..., None, None])


def node_field_derivatives(fields: tuple[str, ...], sensitivity: Sensitivity) -> Array:
    """d(field)/d(theta) (n_points, n_fields) of node places and displacements."""
    out = np.empty((len(sensitivity.displacement), len(fields)))
    for k, name in enumerate(fields):
        if name not in NODE_FIELDS[:6]:
            raise SolveError(
                f"the derivative of {name!r} is not available", where="derivative of a field", fix="use x..uz"
            )
        out[:, k] = sensitivity.displacement[:, NODE_FIELDS.index(name) % 3]
    return out
