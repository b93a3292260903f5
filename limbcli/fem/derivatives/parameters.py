"""Parameters by which the response can be differentiated, and the derivative of the residual.

`partial` gives dR/dtheta at fixed displacements: nodal forces (n_points, 3), and forces and moments on the
bodies (n_bodies, 6).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
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


@dataclass(frozen=True, eq=False)
class LawParameter:
    """A parameter of a material law: "c1" of "tissue" ("0.mu" for the first part of a mixture).

    block : restrict the change to this block (a region's own stiffness); None: all blocks of the material
    weights (n_cells,) : if given, the value of cell e of the block changes by weights[e] theta (coefficient
        of an element map)
    """

    material: str
    name: str
    block: str | None = None
    weights: Array | None = None


@dataclass(frozen=True, eq=False)
class Tied:
    """Material parameters that change together, each by its rate times theta."""

    parts: tuple[tuple[LawParameter, float], ...]


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """Initial position of a body: `motion` (6) per unit theta, a translation (mm) and a rotation vector about
    its centre (rad). (1, 0, 0, 0, 0, 0) is an offset along x, (0, 0, 0, 0, 1, 0) a tilt about y. Later
    rotations of the body also rotate the tilt; the logged rotation is relative to the initial position."""

    body: str
    motion: tuple[float, float, float, float, float, float]


@dataclass(frozen=True, eq=False)
class ShapeParameter:
    """Shape of the reference configuration: node n moves by directions[n] theta (a layer's thickness).

    The residual is differentiated by central differences of `step` mm; the derivative of the response for a
    given derivative of the residual is exact."""

    directions: Array
    step: float = 1e-4
    _systems: dict[float, tuple[list[Group], System]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Prestrain:
    """Prestrain of a material: F0 changes by `direction` (3, 3) per unit theta; without a direction, the ramp
    changes by one (its factor, if it follows a load curve).

    The residual is differentiated by central differences of `step`; the derivative of the response for a
    given derivative of the residual is exact."""

    material: str
    direction: Array | None = None
    step: float = 1e-5


Parameter = LawParameter | Tied | BodyMotion | ShapeParameter | Prestrain


def partial(system: System, contact: ContactState, parameter: Parameter) -> tuple[Array, Array]:
    """dR/dtheta at fixed displacements: nodal (n_points, 3), bodies (n_bodies, 6)."""
    if isinstance(parameter, LawParameter | Tied):
        found = [_law(system, contact, each, rates) for each, rates in changed_together(parameter)]
        return (
            np.asarray(sum(nodal for nodal, _ in found)),
            np.asarray(sum(bodies for _, bodies in found)),
        )
    if isinstance(parameter, BodyMotion):
        return _motion(system, contact, parameter)
    if isinstance(parameter, Prestrain):
        return _prestrain(system, contact.state, parameter)
    return _shape(system, contact, parameter)


def changed_together(parameter: LawParameter | Tied) -> list[tuple[LawParameter, dict[str, float]]]:
    """The parameters that change, with their rates by name: those of the same cells together."""
    found: dict[tuple[str, str | None, int], tuple[LawParameter, dict[str, float]]] = {}
    for part, rate in parameter.parts if isinstance(parameter, Tied) else ((parameter, 1.0),):
        _, rates = found.setdefault((part.material, part.block, id(part.weights)), (part, {}))
        rates[part.name] = rates.get(part.name, 0.0) + rate
    return list(found.values())


def programs(system: System, parameter: LawParameter, rates: Mapping[str, float]) -> dict[int, list[Program]]:
    """Derivative programs by group number; raises SolveError if no region has the material.

    rates : of the material's parameters that change, by name
    """
    where = f"derivative with respect to {parameter.material}.{parameter.name}"
    found = {}
    for number, group in enumerate(system.groups):
        if group.material.name != parameter.material or parameter.block not in (None, group.block):
            continue
        n, weights = len(group.cells), parameter.weights
        if weights is not None and len(weights) != n:
            raise SolveError(
                f"{len(weights)} weights for the {n} cells of block {group.block!r}",
                where=where,
                fix="give a weight to each cell of one block, and name the block",
            )
        found[number] = group.material.derivative(rates, n, system.curve, weights=weights)
    if not found:
        raise SolveError(
            f"no region is made of {parameter.material!r}",
            where=where,
            fix=f"use one of {sorted({g.material.name for g in system.groups})}",
        )
    return found


def _law(
    system: System, contact: ContactState, parameter: LawParameter, rates: Mapping[str, float]
) -> tuple[Array, Array]:
    state = contact.state
    nodal, bodies = np.zeros_like(system.X), np.zeros((len(system.bodies), 6))
    dt = system.model.steps[0].step_size
    at_first = system.curve_at_first
    for number, found in programs(system, parameter, rates).items():
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


def given_motions(system: System, state: State, parameter: Parameter) -> Array:
    """Motions (n_bodies, 6) per unit theta that a BodyMotion causes at the current position of its body."""
    motions = np.zeros((len(system.bodies), 6))
    if not isinstance(parameter, BodyMotion):
        return motions
    names = [body.name for body in system.bodies]
    if parameter.body not in names:
        raise SolveError(
            f"there is no rigid body {parameter.body!r}", where="derivative", fix=f"use one of {names}"
        )
    b = names.index(parameter.body)
    motions[b, :3] = parameter.motion[:3]
    motions[b, 3:] = state.bodies[b].turn @ np.asarray(parameter.motion[3:], dtype=float)
    return motions


def _motion(system: System, contact: ContactState, parameter: BodyMotion) -> tuple[Array, Array]:
    state = contact.state
    motions = given_motions(system, state, parameter)
    v = system.follow(state, motions)
    nodal, bodies = system.contact_times(contact, v, motions)
    if v.any():
        nodal += system.tangent_times(state, v)
    system.gather_tied(state, nodal, bodies)
    if v.any():
        b = int(np.flatnonzero(motions.any(axis=1))[0])
        bodies[b, 3:] += system.tied_turning(state, _nodal_forces(system, contact), b) @ motions[b, 3:]
    if system.model.springs:
        bodies += (system.spring_stiffness(state) @ motions.ravel()).reshape(-1, 6)
    return nodal, bodies


def _nodal_forces(system: System, contact: ContactState) -> Array:
    """Internal and contact forces less the loads (n_points, 3)."""
    state = contact.state
    nodal, _, _ = system.internal(state)
    return nodal - system.distributed.forces(state.u) + system.contact_forces(contact)[0]


def _shape(system: System, contact: ContactState, parameter: ShapeParameter) -> tuple[Array, Array]:
    sides = []
    for sign in (1.0, -1.0):
        moved = moved_system(system, parameter, sign)
        moved.at(contact.state.time)
        forces = moved.forces(contact.state)
        sides.append((forces.nodal, forces.bodies))
    (n1, b1), (n0, b0) = sides
    return (n1 - n0) / (2 * parameter.step), (b1 - b0) / (2 * parameter.step)


def moved_system(system: System, parameter: ShapeParameter, sign: float) -> System:
    groups, moved = parameter._systems.get(sign, (None, None))
    if moved is None or groups is not system.groups:  # out of date: the laws or the model have changed
        mesh = system.model.mesh
        points = mesh.points + sign * parameter.step * parameter.directions
        model = replace(system.model, mesh=replace(mesh, points=points))
        moved = System(
            model,
            supports=system.supports,
            drives=system.drives,
            loads=system.loads,
            threads=system.threads.n,
        )
        parameter._systems[sign] = (system.groups, moved)
    return moved


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
            o = nudged(system, k, parameter, sign * parameter.step)
            part = np.zeros_like(nodal)
            simd_kernels.internal_force(0, len(o.cells), state.u, *o.arguments(), part)
            nodal += sign * part / (2.0 * parameter.step)
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
