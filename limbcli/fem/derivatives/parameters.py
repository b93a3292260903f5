"""Parameters by which the response can be differentiated, and the derivative of the residual.

`partial` gives dR/dtheta at fixed displacements: nodal forces (n_points, 3), and forces and moments on the
bodies (n_bodies, 6).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem.contacts import contact_kernels
from limbcli.fem.contacts.contact_state import ContactState
from limbcli.fem.contacts.penalty import penalty_derivative
from limbcli.fem.elements import simd_kernels
from limbcli.fem.elements.groups import Group, Operands
from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.materials import Program
from limbcli.materials.program import CurveAt
from limbcli.model import Array, Curved

_STEP = 1e-5  # of a prestrain, in central differences


@dataclass(frozen=True, eq=False)
class LawParameter:
    """Parameters of a material law, each of which changes by its rate times theta: {"c1": 1.0} of "tissue",
    {"0.mu": 1.0} for the first part of a mixture.

    weights (n_cells,) : if given, the value of cell e changes by weights[e] theta (coefficient of an element
        map)
    """

    material: str
    rates: Mapping[str, float]
    weights: Array | None = None


@dataclass(frozen=True, eq=False)
class Prestrain:
    """Prestrain of a material: F0 changes by `direction` (3, 3) per unit theta; without a direction, the ramp
    changes by one (its factor, if it follows a load curve).

    The residual is differentiated by central differences; the derivative of the response for a given
    derivative of the residual is exact."""

    material: str
    direction: Array | None = None


Parameter = LawParameter | Prestrain


def partial(system: System, contact: ContactState, parameter: Parameter) -> tuple[Array, Array]:
    """dR/dtheta at fixed displacements: nodal (n_points, 3), bodies (n_bodies, 6)."""
    if isinstance(parameter, Prestrain):
        return _prestrain(system, contact.state, parameter)
    return _law(system, contact, parameter)


def programs(system: System, parameter: LawParameter) -> dict[int, list[Program]]:
    """Derivative programs by group number; raises SolveError if no region has the material."""
    where = f"derivative with respect to {parameter.material}.{next(iter(parameter.rates))}"
    found = {}
    for number, group in enumerate(system.groups):
        if group.material.name != parameter.material:
            continue
        n, weights = len(group.cells), parameter.weights
        if weights is not None and len(weights) != n:
            raise SolveError(
                f"{len(weights)} weights for the {n} cells of block {group.block!r}",
                where=where,
                fix="give a weight to each cell",
            )
        found[number] = group.material.derivative(parameter.rates, n, system.curve, weights=weights)
    if not found:
        raise SolveError(
            f"no region is made of {parameter.material!r}",
            where=where,
            fix=f"use one of {sorted({g.material.name for g in system.groups})}",
        )
    return found


def _law(system: System, contact: ContactState, parameter: LawParameter) -> tuple[Array, Array]:
    state, rates = contact.state, parameter.rates
    nodal, bodies = np.zeros_like(system.X), np.zeros((len(system.bodies), 6))
    dt = system.model.steps[0].step_size
    at_first = system.curve_at_first
    for number, found in programs(system, parameter).items():
        _add_internal(system, state, number, found, nodal)
        group = system.groups[number]
        change = group.material.change(rates, len(group.cells), at_first, weights=parameter.weights)
        for pair, found_points in zip(system.pairs, contact.points, strict=True):
            for patch, points in zip(pair.patches, found_points, strict=True):
                deps = pair.factor * penalty_derivative(
                    pair.contact, patch, system.groups, number, at_first, change, dt
                )
                if not deps.any():
                    continue
                contact_kernels.scaled_force(
                    patch.facets, patch.N, patch.weights, points, deps, pair.facets2, nodal
                )
    system.gather_touched(state, nodal, bodies)
    system.gather_tied(state, nodal, bodies)
    return nodal, bodies


def _add_internal(system: System, state: State, number: int, found: list[Program], out: Array) -> None:
    operands = system.operands[number]
    for program in found:
        args = operands.with_program(program).arguments()
        parts = [np.zeros_like(out) for _ in range(system.threads.n)]

        def task(worker: int, start: int, stop: int, args: Any = args, parts: Any = parts) -> None:
            simd_kernels.internal_force(start, stop, state.u, *args, parts[worker])

        system.threads.run(task, len(operands.cells))
        for each in parts:
            out += each


def _prestrain(system: System, state: State, parameter: Prestrain) -> tuple[Array, Array]:
    mine = [
        k
        for k, group in enumerate(system.groups)
        if group.material.name == parameter.material and group.material.prestrain is not None
    ]
    if not mine:
        raise SolveError(
            f"no region of {parameter.material!r} has a prestrain",
            where="derivative with respect to a prestrain",
            fix=f"use one of {sorted({g.material.name for g in system.groups if g.material.prestrain})}",
        )
    nodal, bodies = np.zeros_like(system.X), np.zeros((len(system.bodies), 6))
    for k in mine:
        for sign in (1.0, -1.0):
            o = nudged(system, k, parameter, sign * _STEP)
            part = np.zeros_like(nodal)
            simd_kernels.internal_force(0, len(o.cells), state.u, *o.arguments(), part)
            nodal += sign * part / (2.0 * _STEP)
    system.gather_tied(state, nodal, bodies)
    return nodal, bodies


def prestrain_change(group: Group, parameter: Prestrain, curve: CurveAt) -> Array:
    """Derivative (3, 3) of a group's prestrain gradient (1 - r) 1 + r F0 with respect to the parameter."""
    assert group.material.prestrain is not None
    F0, ramp = group.material.prestrain
    on_curve = curve(ramp.curve) if isinstance(ramp, Curved) else 1.0
    if parameter.direction is None:
        return np.asarray(on_curve * (F0 - np.eye(3)))
    r = ramp.value * on_curve if isinstance(ramp, Curved) else float(ramp)  # type: ignore[arg-type]
    return np.asarray(r * np.asarray(parameter.direction, dtype=float))


def nudged(system: System, number: int, parameter: Prestrain, change: float) -> Operands:
    """A group's operands with its prestrain parameter changed by `change`."""
    group = system.groups[number]
    assert group.material.prestrain is not None
    F0, ramp = group.material.prestrain
    if parameter.direction is not None:
        F0 = F0 + change * np.asarray(parameter.direction, dtype=float)
    elif isinstance(ramp, Curved):
        ramp = replace(ramp, value=ramp.value + change)
    else:
        ramp = float(ramp) + change  # type: ignore[arg-type]
    moved = group.with_material(replace(group.material, prestrain=(F0, ramp)))
    return moved.at(system.curve, scale=system.scales[number], history=system.histories[number])
