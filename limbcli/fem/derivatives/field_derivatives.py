"""Derivatives of all record fields with respect to a parameter, given the sensitivity of the response.

Cell fields are obtained by the chain rule from the changes at the integration points (`point_changes`), node
and body fields from those of displacements, reactions and motions. Derivatives of the spatial tangent are
finite differences of the law, accurate to about nine digits; all others are exact.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from limbcli.fem.derivatives.parameters import Parameter
from limbcli.fem.derivatives.point_changes import PointChanges, point_changes
from limbcli.fem.derivatives.sensitivity import Sensitivity, reaction_changes
from limbcli.fem.motion.state import State
from limbcli.fem.record_fields import (
    BODY_FIELDS,
    NODE_FIELDS,
    TANGENT_FIELDS,
    check_record,
    columns_of,
    pair_push,
    pushed,
    right_stretch,
)
from limbcli.fem.system import System
from limbcli.model import Array, IntArray, LogRecord

_SAME = 1e-9  # difference at which principal stresses count as equal, relative to the largest


def record_derivatives(
    system: System, state: State, record: LogRecord, parameter: Parameter, sensitivity: Sensitivity
) -> tuple[IntArray, Array]:
    """Item numbers (from 0) and d(field)/d(theta) (n_items, n_fields) of one record at a converged state.

    Raises SolveError if the record has an unsupported field.
    """
    check_record(record)
    if record.kind == "rigid_body":
        b = [body.name for body in system.bodies].index(str(record.items))
        shift, spin = sensitivity.motions[b, :3], sensitivity.motions[b, 3:]
        turn = _vector_change(state.bodies[b].rotation, spin)
        values = np.concatenate([shift, turn, sensitivity.bodies[b]])
        return np.array([b], dtype=np.int64), values[None, [BODY_FIELDS.index(n) for n in record.fields]]
    if record.kind == "node":
        reactions = np.zeros(0)
        if {"Rx", "Ry", "Rz"} & set(record.fields):
            reactions = reaction_changes(system, state, parameter, sensitivity)
        moves = _node_changes(system, state, sensitivity)
        columns = [reactions if name.startswith("R") else moves for name in record.fields]
        places = [NODE_FIELDS.index(name) % 3 for name in record.fields]
        values = np.stack([c[:, k] for c, k in zip(columns, places, strict=True)], axis=1)
    else:
        values = np.zeros((sum(len(b.cells) for b in system.model.mesh.blocks), len(record.fields)))
        for number, group in enumerate(system.groups):
            rows = cell_field_derivatives(system, state, number, record.fields, parameter, sensitivity)
            values[group.first : group.first + len(group.cells)] = rows
    items = np.arange(len(values)) if record.items is None else np.asarray(record.items)
    return items, values[items]


def cell_field_derivatives(
    system: System,
    state: State,
    number: int,
    fields: tuple[str, ...],
    parameter: Parameter,
    sensitivity: Sensitivity,
) -> Array:
    """d(field)/d(theta) (n_cells, n_fields) of a group's cells.

    Where principal values coincide, the derivatives are one-sided, for increasing theta and in the order
    the values then have; for decreasing theta the same values apply in the opposite order.
    """
    group, tangent = system.groups[number], bool(set(TANGENT_FIELDS) & set(fields))
    at = point_changes(system, state, number, parameter, sensitivity.displacement, tangent=tangent)
    C = np.swapaxes(at.F, -1, -2) @ at.F

    tensors: dict[str, tuple[Callable[[], Array], Callable[[], Array]]] = {
        "s": (lambda: at.stress, lambda: at.d_stress),
        "E": (lambda: 0.5 * (C - np.eye(3)), lambda: at.d_strain),
        "U": (lambda: right_stretch(C), lambda: stretch_change(C, 2.0 * at.d_strain)),
    }

    def principal(name: str) -> Array:
        value, change = (each().reshape(-1, 3, 3) for each in tensors[name])
        return principal_changes(value, change).reshape(*C.shape[:2], 3).mean(axis=1, keepdims=True)

    moves = _node_changes(system, state, sensitivity)[group.cells]
    return columns_of(fields, {
        "J": lambda: at.d_volume,
        "sed": lambda: at.d_energy,
        "place": lambda: np.einsum("k,cki->ci", group.shares, moves)[:, None],
        "F": lambda: at.dF,
        "tangent": lambda: _tangent_change(at).mean(axis=1, keepdims=True),
        **{name: change for name, (_, change) in tensors.items()},
        **{f"principal {name}": partial(principal, name) for name in tensors},
    })  # fmt: skip


def stretch_change(C: Array, change: Array) -> Array:
    """Derivative (..., 3, 3) of the right stretch U, U U = C, from that of C: U dU + dU U = dC.

    >>> stretch_change(np.diag([4.0, 1.0, 9.0]), np.diag([4.0, 1.0, 3.0])).diagonal().tolist()
    [1.0, 0.5, 0.5]
    """
    squares, axes = np.linalg.eigh(C)
    stretches = np.sqrt(squares)
    inner = np.swapaxes(axes, -1, -2) @ change @ axes / (stretches[..., :, None] + stretches[..., None, :])
    return np.asarray(axes @ inner @ np.swapaxes(axes, -1, -2))


def principal_changes(stress: Array, change: Array) -> Array:
    """Derivatives (n, 3) of the principal values, largest first, of a tensor (n, 3, 3) along `change`.

    dl_i = n_i . dS n_i. For coincident values: the principal values of dS restricted to their eigenspace,
    largest first, which is the one-sided derivative in the forward direction.

    >>> equal, change = np.diag([1.0, 1.0, -1.0])[None], np.diag([-3.0, 2.0, 0.5])[None]
    >>> principal_changes(equal, change)
    array([[ 2. , -3. ,  0.5]])
    """
    values, n = np.linalg.eigh(stress)
    values, n = values[:, ::-1], n[:, :, ::-1]
    turned = np.swapaxes(n, 1, 2) @ change @ n
    out = np.diagonal(turned, axis1=1, axis2=2).copy()
    near = values[:, :-1] - values[:, 1:] <= _SAME * abs(values).max(axis=1, initial=0.0)[:, None]
    for first, last in ((0, 2), (1, 3), (0, 3)):
        whole = near[:, first : last - 1].all(axis=1)
        block = turned[whole, first:last, first:last]
        out[whole, first:last] = np.linalg.eigvalsh(block)[:, ::-1]
    return out


def _tangent_change(at: PointChanges) -> Array:
    """Change (n_cells, n_gauss, 6, 6) of the spatial tangent."""
    F, dF = at.law_F, at.law_dF
    push, turn = pair_push(F, F), pair_push(dF, F) + pair_push(F, dF)
    J = np.linalg.det(F)[..., None, None]
    growth = np.trace(np.linalg.solve(F, dF), axis1=-2, axis2=-1)[..., None, None]
    half = turn @ at.CC @ np.swapaxes(push, -1, -2)
    whole = half + np.swapaxes(half, -1, -2) + push @ at.d_tangent @ np.swapaxes(push, -1, -2)
    return np.asarray(whole / J - growth * pushed(F, at.CC))


def _node_changes(system: System, state: State, sensitivity: Sensitivity) -> Array:
    """Derivatives (n_points, 3) of the displacements of all nodes, also rigid ones."""
    moves = sensitivity.displacement.copy()
    for b, body in enumerate(system.bodies):
        own = np.setdiff1d(body.points, body.tied)  # tied nodes are already part of the displacements
        turn, arm = state.bodies[b].turn, system.X[own] - body.center
        shift, spin = sensitivity.motions[b, :3], sensitivity.motions[b, 3:]
        moves[own] += shift + np.cross(spin, arm @ turn.T)
    return moves


def _vector_change(vector: Array, spin: Array) -> Array:
    """Change of a body's rotation vector for a further small rotation `spin` (rad) about spatial axes.

    >>> _vector_change(np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 1.0]))
    array([0., 0., 1.])
    """
    angle = float(np.linalg.norm(vector))
    across = np.cross(vector, spin)
    part = 1 / 12 if angle < 1e-3 else (1 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
    return np.asarray(spin - 0.5 * across + part * np.cross(vector, across))
